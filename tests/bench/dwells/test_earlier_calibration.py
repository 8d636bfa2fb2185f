"""An earlier calibration, at any temperature."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.dwells.earlier_calibration import (
    MAX_EXTRAPOLATION_K,
    EarlierCalibration,
    InterpolatedCurve,
    read_calibration,
)
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.dwells.test_calibration_check import calibrated

UG = 9.80665e-6
PRIOR = PriorKnowledge.from_datasheet(accelerometer_bias_ug=1000.0, accelerometer_misalignment_arcsec=5.0)
GRAVITY_UG = 5.0 * np.pi / 180.0 / 3600.0 * 1e6  # what 5 arcsec let in
SIGMA_DPH, SIGMA_UG = 0.001, 3.0


def triple(values):
    return tuple(float(each) for each in np.broadcast_to(values, 3))


def row(position="z_up", gyro_c=20.0, bias_dph=0.0, accelerometer_ug=0.0, **fields):
    """A dwell; one value stands for all three axes."""
    vertical = POSITIONS[position].up_axis
    sigmas_ug = tuple(1000.0 if axis == vertical else SIGMA_UG for axis in range(3))
    given = {"accelerometer_ug": triple(accelerometer_ug), "accelerometer_sigma_ug": sigmas_ug} | fields
    return calibrated(position, triple(bias_dph), SIGMA_DPH, triple(gyro_c), **given)


def known_ug(rows, position="z_up", gyro_c=20.0):
    known = EarlierCalibration(rows, PRIOR).accelerometers(position, (gyro_c,) * 3)
    return known.bias / UG, known.sigma / UG


def test_errors_that_dwells_of_an_attitude_share_do_not_average_out():
    dwells = [
        replace(
            row("z_up", 20.0, accelerometer_ug=(5.0, 5.0, 5.0), accelerometer_sigma_ug=(5.0, 5.0, 5.0)),
            sigma_dph=(0.005,) * 3,
            common_sigma_dph=(0.004,) * 3,
            accelerometer_common_sigma_ug=(4.0,) * 3,
        )
        for _ in range(9)
    ]
    assert EarlierCalibration(dwells, PRIOR).gyro_dph("z_up", 0, 20.0)[1] == pytest.approx(
        np.hypot(0.001, 0.004)
    )
    assert known_ug(dwells)[1][0] == pytest.approx(np.hypot(1.0, 4.0))


def test_a_gyro_has_its_own_bias_in_each_position_and_temperature():
    rows = [
        row("z_up", 20.0, bias_dph=(0.001, 0.002, 0.003)),
        row("z_up", 40.0, bias_dph=(0.005, 0.006, 0.007)),
        row("z_down", 20.0, bias_dph=(-0.001, -0.002, -0.003)),
    ]
    calibration = EarlierCalibration(rows, PRIOR)
    assert calibration.gyro_dph("z_up", 0, 20.0) == pytest.approx((0.001, SIGMA_DPH))
    assert calibration.gyro_dph("z_up", 2, 30.0)[0] == pytest.approx(0.005)
    assert calibration.gyro_dph("z_down", 1, 20.0)[0] == pytest.approx(-0.002)


def test_a_gyro_that_was_not_measured_near_has_no_calibrated_bias():
    calibration = EarlierCalibration([row("z_up", 20.0)], PRIOR)
    assert calibration.gyro_dph("z_up", 0, 25.0) is None
    assert calibration.gyro_dph("y_up", 0, 20.0) is None
    assert EarlierCalibration([], PRIOR).gyro_dph("z_up", 0, 20.0) is None


def test_each_gyro_is_read_at_its_own_temperature():
    calibration = EarlierCalibration([row(gyro_c=(10.0, 20.0, 30.0))], PRIOR)
    found = [
        [calibration.gyro_dph("z_up", axis, c) is not None for c in (10.0, 20.0, 30.0)] for axis in range(3)
    ]
    assert found == np.eye(3, dtype=bool).tolist()


def test_dwells_with_flags_are_left_out():
    good, bad = row(bias_dph=0.001), row(bias_dph=0.05, accelerometer_ug=9e3, flags=("door opened",))
    assert EarlierCalibration([good, bad], PRIOR).gyro_dph("z_up", 0, 20.0) == pytest.approx(
        (0.001, SIGMA_DPH)
    )
    np.testing.assert_allclose(known_ug([good, bad])[0], 0.0)
    assert EarlierCalibration([bad], PRIOR).gyro_dph("z_up", 0, 20.0) is None


def test_accelerometers_are_known_where_they_were_level():
    bias, sigma = known_ug([row("z_up", accelerometer_ug=(30.0, -20.0, 0.0))])
    np.testing.assert_allclose(bias, [30.0, -20.0, 0.0])
    np.testing.assert_allclose(sigma, [SIGMA_UG, SIGMA_UG, 1000.0])


def test_what_was_measured_in_other_positions_counts_less_by_the_gravity_that_misalignments_let_in():
    others = [row(name, accelerometer_ug=30.0) for name in ("y_up", "y_down", "x_up")]
    bias, sigma = known_ug(others)
    # x was level in two of them, y in one, z in all three.
    np.testing.assert_allclose(bias, 30.0)
    expected = [math.hypot(GRAVITY_UG, math.hypot(SIGMA_UG, GRAVITY_UG) / math.sqrt(n)) for n in (2, 1, 3)]
    np.testing.assert_allclose(sigma, expected)
    bias, sigma = known_ug([*others, row("z_up", accelerometer_ug=10.0)])
    np.testing.assert_allclose(bias[:2], 10.0, atol=0.4)
    np.testing.assert_allclose(sigma[:2], SIGMA_UG, rtol=0.01)


def test_the_prior_knowledge_of_a_vertical_accelerometer_is_no_measurement():
    rows = [
        row("z_up", accelerometer_ug=(30.0, -20.0, 0.0)),
        row("z_down", accelerometer_ug=(30.0, -20.0, 0.0)),
    ]
    bias, sigma = known_ug(rows, position="y_up")
    assert (bias[2], sigma[2]) == (0.0, pytest.approx(1000.0))


def test_accelerometers_follow_the_temperature():
    rows = [row(gyro_c=each, accelerometer_ug=(each, 0.0, 0.0)) for each in (0.0, 20.0, 40.0)]
    assert known_ug(rows, gyro_c=30.0)[0][0] == pytest.approx(30.0)


def test_beyond_the_calibration_they_change_by_the_declared_slope():
    declared = PriorKnowledge.from_datasheet(accelerometer_slope_ug_per_c=40.0)
    known = EarlierCalibration([row()], declared).accelerometers("z_up", (20.0 + MAX_EXTRAPOLATION_K,) * 3)
    np.testing.assert_allclose(known.sigma[:2] / UG, math.hypot(SIGMA_UG, 40.0 * MAX_EXTRAPOLATION_K))


def test_without_a_calibration_near_the_accelerometers_are_as_uncertain_as_beforehand():
    without = replace(row(), accelerometer_ug=(math.nan,) * 3, accelerometer_sigma_ug=(math.nan,) * 3)
    for rows in ([], [row(gyro_c=60.0)], [without]):
        bias, sigma = known_ug(rows)
        np.testing.assert_allclose(bias, 0.0)
        np.testing.assert_allclose(sigma, 1000.0)


SLOPE_SIGMA = 0.001
STRAIGHT = [(-20.0, 0.001, 0.0004), (10.0, 0.004, 0.0003), (30.0, 0.006, 0.0002)]

temperatures = st.floats(-60.0, 90.0)


def curve(points):
    return InterpolatedCurve(points, SLOPE_SIGMA)


def test_at_a_temperature_it_gives_what_was_measured_there():
    assert curve(STRAIGHT).at(10.0) == pytest.approx((0.004, 0.0003))


def test_between_temperatures_it_is_a_straight_line_with_the_noise_of_its_ends():
    value, sigma = curve(STRAIGHT).at(0.0)
    assert value == pytest.approx(0.003)
    assert sigma == pytest.approx(math.hypot(0.0004 / 3.0, 0.0003 * 2.0 / 3.0))


@given(st.floats(-20.0, 70.0), st.floats(-1e-5, 1e-5))
def test_what_a_parabola_bends_in_a_gap_is_in_the_uncertainty(temperature_c, bend):
    points = [(each, bend * each**2, 1e-9) for each in (-20.0, 10.0, 30.0, 70.0)]
    value, sigma = curve(points).at(temperature_c)
    assert sigma == pytest.approx(abs(value - bend * temperature_c**2), rel=1e-3, abs=2e-9)


def test_what_a_knee_adds_is_in_the_uncertainty():
    points = [(each, 3e-4 * max(0.0, 50.0 - each), 5e-4) for each in (-20.0, 3.0, 33.0, 57.0, 72.0)]
    for temperature_c in np.arange(-20.0, 72.0):
        value, sigma = curve(points).at(temperature_c)
        assert abs(value - 3e-4 * max(0.0, 50.0 - temperature_c)) < 2.5 * sigma


def test_with_two_temperatures_the_whole_change_may_be_at_one_end():
    value, sigma = curve([(0.0, 0.0, 1e-9), (40.0, 0.008, 1e-9)]).at(20.0)
    parabola = 0.008 * 0.5**2  # level at 0 degC
    assert value == pytest.approx(0.004)
    assert sigma == pytest.approx(value - parabola)


def test_a_bend_that_noise_explains_adds_nothing():
    noisy = [(-20.0, 0.0, 1e-3), (10.0, 1e-3, 1e-3), (30.0, 0.0, 1e-3), (70.0, 1e-3, 1e-3)]
    _, sigma = curve(noisy).at(20.0)
    assert sigma == pytest.approx(1e-3 / math.sqrt(2.0))


def test_temperatures_close_together_beside_a_gap_make_it_no_less_certain():
    random = np.random.default_rng(3)
    nodes_c = np.array([-23.0, 2.0, 8.0, 32.0, 58.0, 72.0])
    errors, sigmas = [], []
    for _ in range(200):
        values = 1e-5 * nodes_c + 5e-4 * random.standard_normal(6)
        value, sigma = curve([(c, v, 5e-4) for c, v in zip(nodes_c, values, strict=True)]).at(-10.0)
        errors.append(value + 1e-4)
        sigmas.append(sigma)
    assert np.median(sigmas) < 1.5 * 5e-4
    assert np.std(np.array(errors) / np.array(sigmas)) == pytest.approx(0.85, abs=0.2)


def test_values_at_nearly_the_same_temperature_are_averaged():
    value, sigma = curve([(20.0, 0.001, 0.0003), (21.0, 0.0016, 0.0004)]).at(20.36)
    assert value == pytest.approx((0.001 / 9 + 0.0016 / 16) / (1 / 9 + 1 / 16))
    assert sigma == pytest.approx(0.0005 * 0.48)


def test_values_that_scatter_beyond_their_uncertainties_are_less_certain():
    _, sigma = curve([(20.0, 0.001, 0.0001), (20.0, 0.003, 0.0001)]).at(20.0)
    assert sigma == pytest.approx(0.001)  # half their difference


def test_what_was_measured_at_either_end_of_an_average_is_within_reach():
    averaged = curve([(20.0, 0.001, 0.0003), (24.9, 0.001, 0.0003)])
    for temperature_c in (20.0 - MAX_EXTRAPOLATION_K, 24.9 + MAX_EXTRAPOLATION_K):
        assert averaged.at(temperature_c)[0] == pytest.approx(0.001)
    assert averaged.at(24.9 + MAX_EXTRAPOLATION_K + 0.1) is None


def test_beyond_the_outermost_temperature_it_goes_a_little_and_is_less_certain():
    value, sigma = curve(STRAIGHT).at(30.0 + MAX_EXTRAPOLATION_K)
    assert value == pytest.approx(0.006)
    assert sigma == pytest.approx(math.hypot(0.0002, SLOPE_SIGMA * MAX_EXTRAPOLATION_K))
    assert curve(STRAIGHT).at(30.1 + MAX_EXTRAPOLATION_K) is None
    assert curve(STRAIGHT).at(-20.1 - MAX_EXTRAPOLATION_K) is None


def test_a_single_temperature_serves_near_it():
    assert curve([(20.0, 0.001, 0.0003)]).at(19.0) == pytest.approx((0.001, math.hypot(0.0003, 0.001)))
    assert curve([(20.0, 0.001, 0.0003)]).at(25.0) is None


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_what_was_not_measured_is_passed_over(missing):
    point = list(STRAIGHT[1])
    point[missing] = math.nan
    assert curve([tuple(point)]).at(10.0) is None
    assert curve([*STRAIGHT, tuple(point)]).at(10.0) == curve(STRAIGHT).at(10.0)
    assert curve(STRAIGHT).at(math.nan) is None


@given(
    st.lists(st.tuples(temperatures, st.floats(-1.0, 1.0), st.floats(1e-6, 1.0)), max_size=8), temperatures
)
def test_any_points_give_a_certain_value_or_none(points, temperature_c):
    found = curve(points).at(temperature_c)
    if found is not None:
        value, sigma = found
        assert min(value for _, value, _ in points) - 1e-9 <= value <= max(v for _, v, _ in points) + 1e-9
        assert 0.0 < sigma < math.inf


ROWS = [calibrated(dwell=1), calibrated("y_up", dwell=2, flags=("door opened",))]


@pytest.fixture
def table(tmp_path):
    write_dwells(tmp_path / "dwells.csv", ROWS)
    return tmp_path / "dwells.csv"


def test_a_run_folder_and_its_table_give_the_same_dwells(table):
    rows = read_calibration(table)
    assert [(row.dwell, row.position, row.flags) for row in rows] == [
        (1, "z_up", ()),
        (2, "y_up", ("door opened",)),
    ]
    assert rows[0].accelerometer_ug == (60.0, -40.0, 50.0)
    assert repr(read_calibration(table.parent)) == repr(rows)  # NaN does not equal itself


def test_the_table_may_have_another_name(table):
    assert read_calibration(table.rename(table.parent / "unit 7.csv"))[0].unit == "U7"


def test_a_table_without_accelerometers_will_do(table):
    nothing = (math.nan,) * 3
    write_dwells(table, [replace(ROWS[0], accelerometer_ug=nothing, accelerometer_sigma_ug=nothing)])
    assert math.isnan(read_calibration(table)[0].accelerometer_ug[0])


def test_what_is_not_there_is_reported(tmp_path):
    with pytest.raises(DocumentError, match=r"nowhere: does not exist\. Give a run folder"):
        read_calibration(tmp_path / "nowhere")
    with pytest.raises(DocumentError, match=r"holds no dwells\.csv, so it is not a calibration"):
        read_calibration(tmp_path)


def test_a_table_without_a_good_dwell_is_no_calibration(table):
    for rows in ([], ROWS[1:]):
        write_dwells(table, rows)
        with pytest.raises(DocumentError, match=r"dwells\.csv: has no dwell that gave a bias"):
            read_calibration(table.parent)


def test_a_wrong_table_is_reported_with_its_place(table):
    table.write_text(table.read_text().replace("z_up", "Z_UP"))
    with pytest.raises(DocumentError, match=r"dwells\.csv:2: column position"):
        read_calibration(table.parent)
