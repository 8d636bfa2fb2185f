import itertools
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.dwell import BiasEstimate, Dwell, NavigationWindow
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.attitude import UP, rotation_matrix
from gyrobench.bench.navigation.positions import POSITIONS

TIME = np.arange(0.0, 61.0)


def window(time=TIME, C_nb=None, velocity=None):
    attitude = np.eye(3) if C_nb is None else C_nb
    count = len(time)
    return NavigationWindow(
        np.asarray(time, dtype=float),
        np.zeros((count, 3)) if velocity is None else velocity,
        np.broadcast_to(attitude, (count, 3, 3)).copy(),
    )


def half_turned(C_nb):
    return rotation_matrix(UP, np.pi) @ C_nb


def dwell(position="z_up", azimuth_rad=0.0, ins_before=None, table_before=None, after_s=100.0, **fields):
    table = POSITIONS["z_up"].C_nb(azimuth_rad) if table_before is None else table_before
    before = table if ins_before is None else ins_before
    fields = {
        "windows": (window(C_nb=before), window(TIME + after_s, half_turned(table))),
        "C_nb_table": (table, half_turned(table)),
        "turns": (np.array([table, half_turned(table)]),),
    } | fields
    return Dwell(position, azimuth_rad, **fields)


def test_a_good_window_knows_its_duration():
    assert window().duration_s == 60.0


def test_a_few_missing_epochs_are_no_gap():
    assert len(window(np.delete(TIME, [10, 11, 12])).time_s) == 58


@pytest.mark.parametrize(
    ("time", "message"),
    [
        (np.linspace(0.0, 600.0, 29), "only 29 epochs"),
        (np.arange(0.0, 55.0), "lasts 54.0 s"),
        (np.delete(TIME, slice(10, 15)), r"nothing from the INS for 6\.000 s after 9\.000 s"),
        (np.where(TIME == 30.0, 29.0, TIME), r"does not increase after 29\.000 s"),
        (np.where(TIME == 30.0, 12.0, TIME), r"does not increase after 29\.000 s"),
        (np.where(TIME == 30.0, np.nan, TIME), "time of an epoch is not a number"),
    ],
)
def test_refuses_times_that_make_no_window(time, message):
    with pytest.raises(MeasurementError, match=message):
        window(time)


def test_says_where_a_value_is_not_a_number():
    velocity = np.zeros((len(TIME), 3))
    velocity[7:9, 1] = np.nan
    message = r"velocity is not a number in 2 epochs, first at 7\.000 s: not sent.* Check range, byte order"
    with pytest.raises(MeasurementError, match=message):
        window(velocity=velocity)
    with pytest.raises(MeasurementError, match="attitude is not a number in 61 epochs"):
        window(C_nb=np.full((3, 3), np.inf))


def test_refuses_arrays_of_different_lengths():
    with pytest.raises(MeasurementError, match="each epoch needs"):
        window(velocity=np.zeros((5, 3)))


def test_a_thinned_window_keeps_the_first_epoch_of_each_interval():
    time = np.sort(np.append(np.arange(1000.0, 1060.05, 0.1), 1030.95))
    whole = window(time, velocity=np.multiply.outer(time, np.ones(3)))
    thin = whole.thinned(1.0)
    np.testing.assert_allclose(thin.time_s, 1000.0 + TIME)
    np.testing.assert_allclose(thin.velocity_enu_mps[:, 1], thin.time_s)
    assert thin.C_nb.shape == (61, 3, 3)
    assert thin.gyro_c is None


def test_a_thinned_window_keeps_its_temperatures_and_goes_over_missing_epochs():
    time = np.delete(np.arange(0.0, 60.05, 0.1), [300, 301, 302])
    gyro_c = np.multiply.outer(time, np.ones(3))
    thin = replace(window(time), gyro_c=gyro_c, accelerometer_c=time + 1.0).thinned(1.0)
    np.testing.assert_allclose(thin.accelerometer_c, thin.time_s + 1.0)
    np.testing.assert_allclose(thin.time_s, np.where(TIME == 30.0, 30.3, TIME))
    np.testing.assert_allclose(thin.gyro_c[:, 2], thin.time_s)


def test_a_dwell_knows_its_position():
    assert dwell().position is POSITIONS["z_up"]


def test_refuses_an_unknown_position():
    with pytest.raises(MeasurementError, match="no position 'sideways'; the positions are z_up, z_down"):
        dwell("sideways")


def test_refuses_windows_that_overlap():
    with pytest.raises(MeasurementError, match=r"begins at 60\.000 s, before the previous one ends"):
        dwell(after_s=60.0)
    times = (TIME, TIME + 100.0, TIME + 150.0)
    with pytest.raises(MeasurementError, match=r"begins at 150\.000 s"):
        dwell(
            windows=tuple(window(time) for time in times),
            C_nb_table=(np.eye(3),) * 3,
            turns=(np.tile(np.eye(3), (2, 1, 1)),) * 2,
        )


def test_holds_as_many_windows_as_there_are():
    table = [POSITIONS["z_up"].C_nb(azimuth) for azimuth in np.deg2rad([0.0, 90.0, 180.0, 270.0])]
    four = dwell(
        windows=tuple(window(TIME + 100.0 * k, C_nb) for k, C_nb in enumerate(table)),
        C_nb_table=tuple(table),
        turns=tuple(np.array(ends) for ends in itertools.pairwise(table)),
    )
    assert len(four.windows) == 4
    one = dwell(windows=four.windows[:1], C_nb_table=(table[0],), turns=())
    assert one.turns == ()


@pytest.mark.parametrize("field", ["windows", "C_nb_table", "turns"])
def test_refuses_windows_without_their_attitude_or_turn(field):
    whole = dwell()
    with pytest.raises(MeasurementError, match=r"windows with \d attitudes of the table and \d turns"):
        dwell(**{field: getattr(whole, field)[:-1]})


def test_refuses_an_ins_that_sees_another_attitude_than_the_table():
    with pytest.raises(MeasurementError, match=r"INS and table in window 1 disagree by 6\.0 deg"):
        dwell(ins_before=rotation_matrix(UP, np.deg2rad(6.0)))
    with pytest.raises(MeasurementError, match=r"INS and table in window 1 disagree by 180\.0 deg"):
        dwell(ins_before=POSITIONS["z_down"].C_nb())
    with pytest.raises(MeasurementError, match=r"INS and table in window 2 disagree by 180\.0 deg"):
        dwell(C_nb_table=(np.eye(3),) * 2)
    assert dwell(ins_before=rotation_matrix(UP, np.deg2rad(4.0)))


def test_refuses_a_table_that_stands_in_another_position():
    with pytest.raises(
        MeasurementError, match=r"y_up: position and azimuth and table .* disagree by 90\.0 deg"
    ):
        dwell("y_up")


def test_azimuth_belongs_to_the_attitude_of_the_table():
    assert dwell(azimuth_rad=0.5).azimuth_rad == 0.5
    with pytest.raises(MeasurementError, match="position and azimuth"):
        dwell(azimuth_rad=0.5, table_before=np.eye(3))


def test_an_estimate_gives_degrees_per_hour():
    estimate = BiasEstimate(
        np.array([1.0, -2.0, 3.0]) * DPH_TO_RADPS, np.diag([4.0, 9.0, 16.0]) * DPH_TO_RADPS**2
    )
    np.testing.assert_allclose(estimate.bias_dph, [1.0, -2.0, 3.0])
    np.testing.assert_allclose(estimate.sigma_dph, [2.0, 3.0, 4.0])
