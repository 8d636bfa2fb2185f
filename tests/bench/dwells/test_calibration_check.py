"""Rows of a verification from the simulated INS and made-up calibrations."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.dwells.calibration_check import calibration_check_rows
from gyrobench.bench.dwells.measure_dwell import AlignedNavigation, CheckDwell
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.dwells.temperatures import DwellTemperatures
from gyrobench.bench.navigation.attitude import rotation_matrix
from gyrobench.bench.navigation.positions import AXES, POSITIONS
from gyrobench.bench.navigation.table_axes import TwoAxisTable
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.drivers.ins.navigation_data import EpochCounts
from tests.bench.bias.emulated_dwells import EAST, UP, emulate, noise_model, sensors, site

NOISE = noise_model(0.0006)
ALIGN_S = 600.0
BIAS_DPH, ACCELEROMETER_UG = (0.012, -0.02, 0.016), (60.0, -40.0, 50.0)
GYRO_C, ALIGNMENT_C = (20.0, 21.0, 22.0), (19.0, 20.0, 21.0)
SETUP = MeasurementSetup(
    decode=lambda frames: pytest.fail("nothing is to be decoded here"),
    table=TwoAxisTable(EAST, UP, np.eye(3)),
    site=site(),
    noise=NOISE,
    prior=PriorKnowledge.from_datasheet(latitude_arcmin=0.02, accelerometer_drift_ug_per_h=2.0),
    velocity_lsb_mps=1e-4,
    heading_lsb_rad=1e-7,
    resolution=(),
)


def verified(position="z_up", azimuth_deg=0.0, dwell=1, seed=None, flags=(), fails=False, **marks):
    """What the bench takes for verification of an INS with these biases."""
    simulated = None if fails else AlignedNavigation(_simulated(position, azimuth_deg, seed), NOISE)
    return CheckDwell(
        marks=DwellMarks(
            **{
                "unit": "U7",
                "run": "R2",
                "dwell": dwell,
                "cycle": 1,
                "position": position,
                "azimuth_deg": azimuth_deg,
                "log_part": dwell,
                "windows": (),
                "start_s": 0.0,
                "end_s": 600.0,
                "since_power_on_s": 600.0,
                "chamber_set_c": 10.0,
                "chamber_c": 10.0,
                "purpose": DwellPurpose.CALIBRATION_CHECK,
                "align_s": ALIGN_S,
            }
            | marks
        ),
        navigation=simulated,
        temperatures=DwellTemperatures() if fails else DwellTemperatures(gyro_c=GYRO_C),
        alignment_c=(math.nan,) * 3 if fails else ALIGNMENT_C,
        counts=EpochCounts(),
        flags=flags,
    )


@cache
def _simulated(position, azimuth_deg, seed):
    noise, random = (None, None) if seed is None else (NOISE, np.random.default_rng([seed, int(azimuth_deg)]))
    ins = sensors(BIAS_DPH, ACCELEROMETER_UG, noise)
    return emulate(position, ins, noise=noise, random=random, stops_deg=(azimuth_deg,), align_s=ALIGN_S)


def calibrated(position="z_up", bias_dph=BIAS_DPH, sigma_dph=0.0005, gyro_c=GYRO_C, **fields):
    vertical = POSITIONS[position].up_axis
    return DwellRow(
        **{
            "unit": "U7",
            "run": "R1",
            "dwell": 1,
            "cycle": 1,
            "position": position,
            "start_s": 0.0,
            "end_s": 1.0,
            "since_power_on_s": 0.0,
            "gyro_c": gyro_c,
            "gyro_rate_c_per_h": (0.0,) * 3,
            "bias_dph": bias_dph,
            "sigma_dph": (sigma_dph,) * 3,
            "accelerometer_ug": ACCELEROMETER_UG,
            "accelerometer_sigma_ug": tuple(1000.0 if axis == vertical else 2.0 for axis in range(3)),
        }
        | fields
    )


def rows_of(dwells, calibration=()):
    return calibration_check_rows(dwells, calibration, SETUP)


def four_azimuths(position, **fields):
    return [verified(position, 90.0 * i, dwell=i + 1, **fields) for i in range(4)]


@pytest.mark.parametrize("position", POSITIONS)
def test_four_azimuths_show_both_level_gyros_by_both_methods_with_their_own_sign(position):
    rows = rows_of(four_azimuths(position), [calibrated(position)])
    level = [axis for axis in range(3) if axis != POSITIONS[position].up_axis]
    assert [row.method for row in rows].count("velocity") == 4
    assert [row.method for row in rows].count("alignment") == 2
    for method in ("velocity", "alignment"):
        assert {row.gyro for row in rows if row.method == method} == {AXES[axis] for axis in level}
    for row in rows:
        truth_dph = BIAS_DPH[AXES.index(row.gyro)]
        assert row.bias_dph == pytest.approx(truth_dph, abs=1e-4)
        assert row.difference_dph == pytest.approx(0.0, abs=1e-4)
        assert (row.flags, row.unit, row.run) == ((), "U7", "R2")


def test_the_slope_alone_stands_beside_the_velocity():
    for row in rows_of(four_azimuths("z_up"), [calibrated()]):
        if row.method == "velocity":
            assert 2e-4 < abs(row.paper_bias_dph - row.bias_dph) < 0.2 * abs(row.bias_dph)
            assert row.paper_sigma_dph > row.sigma_dph
        else:
            assert math.isnan(row.paper_bias_dph)


def test_an_alignment_has_the_temperature_of_the_alignments_and_names_both_dwells():
    alignment, *velocity = rows_of([verified(dwell=3), verified(azimuth_deg=180.0, dwell=4)])
    assert (alignment.method, alignment.dwell, alignment.turned_dwell) == ("alignment", 3, 4)
    assert (alignment.gyro, alignment.temperature_c) == ("x", ALIGNMENT_C[0])
    assert [(row.dwell, row.turned_dwell, row.gyro, row.temperature_c) for row in velocity] == [
        (3, None, "y", GYRO_C[1]),
        (4, None, "y", GYRO_C[1]),
    ]


def test_differences_from_the_truth_are_as_large_as_their_uncertainties_say():
    random = np.random.default_rng(5)
    p_values = []
    for seed in range(40):
        guess = tuple(np.array(BIAS_DPH) + 0.0005 * random.standard_normal(3))
        dwells = [verified(azimuth_deg=0.0, seed=seed), verified(azimuth_deg=180.0, dwell=2, seed=seed)]
        p_values += [[row.p_value for row in rows_of(dwells, [calibrated(bias_dph=guess)])]]
    pulls = np.array(p_values)
    for column in pulls.T:
        # Of 40 chances of a half, 9 to 31 come true in 999 of 1000 cases.
        assert 9 <= np.count_nonzero(column < 0.5) <= 31
    assert pulls.min() > 1e-5


def test_a_bias_that_changed_since_the_calibration_shows():
    rows = rows_of(four_azimuths("z_up"), [calibrated(bias_dph=(0.002, -0.02, 0.016))])
    changed = [row for row in rows if row.gyro == "x"]
    assert {row.method for row in changed} == {"alignment", "velocity"}
    for row in changed:
        assert row.difference_dph == pytest.approx(0.010, abs=1e-4)
        assert row.difference_sigma_dph == pytest.approx(math.hypot(row.sigma_dph, row.calibrated_sigma_dph))
        assert row.p_value < 1e-6
    assert min(row.p_value for row in rows if row.gyro == "y") > 0.9


def test_accelerometers_of_the_calibration_are_taken_into_account():
    with_calibration = rows_of([verified()], [calibrated()])[-1]
    without = rows_of([verified()])[-1]
    assert (with_calibration.accelerometer_ug, with_calibration.accelerometer_sigma_ug) == pytest.approx(
        (-40.0, 2.0)
    )
    assert (without.accelerometer_ug, without.accelerometer_sigma_ug) == pytest.approx((0.0, 1000.0))
    assert with_calibration.sigma_dph < 0.0017
    assert without.sigma_dph == pytest.approx(0.9e-3 * 1000.0 / 100.0, rel=0.1)
    assert without.bias_dph - with_calibration.bias_dph == pytest.approx(0.9e-3 * 0.4, rel=0.1)


def test_between_two_temperatures_the_calibration_is_interpolated():
    cold = calibrated(bias_dph=(0.0, -0.03, 0.0), gyro_c=(0.0,) * 3)
    warm = calibrated(bias_dph=(0.0, -0.01, 0.0), gyro_c=(42.0,) * 3, dwell=2)
    (row,) = (row for row in rows_of([verified()], [cold, warm]) if row.method == "velocity")
    assert row.calibrated_dph == pytest.approx(-0.02)
    assert row.calibrated_sigma_dph > 0.004  # two temperatures do not show how the curve bends


@pytest.mark.parametrize(
    "calibration",
    [
        (),
        (calibrated("y_up"),),
        (calibrated(gyro_c=(50.0,) * 3),),
        (calibrated(unit="U8"),),
        (calibrated(flags=("door opened",)),),
    ],
    ids=["none", "another position", "another temperature", "another unit", "flagged"],
)
def test_what_was_not_calibrated_is_shown_without_comparison(calibration):
    for row in rows_of([verified(), verified(azimuth_deg=180.0, dwell=2)], calibration):
        assert row.flags == ()
        assert not math.isnan(row.bias_dph)
        assert math.isnan(row.calibrated_dph)
        assert not row.is_compared


@pytest.mark.parametrize(
    "other",
    [
        verified(azimuth_deg=90.0, dwell=2),
        verified("y_up", azimuth_deg=180.0, dwell=2),
        verified(azimuth_deg=180.0, dwell=2, chamber_set_c=40.0),
        verified(azimuth_deg=180.0, dwell=2, cycle=2),
        verified(azimuth_deg=180.0, dwell=2, run="R3"),
        replace(verified(azimuth_deg=180.0, dwell=2), alignment_c=(40.0, 41.0, 42.0)),
    ],
    ids=["quarter turn", "position", "stop", "cycle", "power-on", "temperature"],
)
def test_an_alignment_without_its_half_turn_is_reported(other):
    alone = [row for row in rows_of([verified(), other], [calibrated()]) if row.method == "alignment"]
    assert [row.dwell for row in alone] == [1, 2]
    assert "no alignment at azimuth 180 deg" in str(alone[0].flags)
    assert all(math.isnan(row.bias_dph) and not row.is_compared for row in alone)


def test_pairs_are_made_in_the_order_of_time_in_any_order_of_the_dwells():
    dwells = [verified(azimuth_deg=180.0 * (i % 2), dwell=i + 1) for i in range(4)]
    for order in (dwells, dwells[::-1]):
        pairs = [(row.dwell, row.turned_dwell) for row in rows_of(order) if row.method == "alignment"]
        assert pairs == [(1, 2), (3, 4)]


def test_azimuths_that_differ_by_a_full_circle_are_the_same():
    rows = rows_of([verified(azimuth_deg=-90.0), verified(azimuth_deg=90.0, dwell=2)])
    assert [row.flags for row in rows if row.method == "alignment"] == [()]


def test_a_dwell_that_gave_nothing_is_reported_in_both_rows_that_miss_it():
    failed = verified(azimuth_deg=180.0, dwell=2, fails=True, flags=("the INS left navigation",))
    alignment, velocity, missing = rows_of([verified(), failed], [calibrated()])
    assert alignment.flags == ("dwell 2: the INS left navigation",)
    assert missing.flags == ("the INS left navigation",)
    assert math.isnan(alignment.bias_dph)
    assert math.isnan(missing.bias_dph)
    assert velocity.is_compared


def test_a_disturbed_dwell_is_shown_and_not_judged():
    rows = rows_of([verified(flags=("door opened",)), verified(azimuth_deg=180.0, dwell=2)], [calibrated()])
    assert [row.flags for row in rows] == [("dwell 1: door opened",), ("door opened",), ()]
    for row in rows[:2]:
        assert row.bias_dph == pytest.approx(BIAS_DPH[AXES.index(row.gyro)], abs=1e-4)
        assert row.calibrated_dph == pytest.approx(BIAS_DPH[AXES.index(row.gyro)])
        assert math.isnan(row.difference_dph)
        assert not row.is_compared
    assert rows[2].is_compared


def test_at_an_oblique_azimuth_no_gyro_is_reported():
    for row in rows_of([verified(azimuth_deg=30.0), verified(azimuth_deg=210.0, dwell=2)], [calibrated()]):
        assert "30 deg off: check at azimuth 0, 90, 180 or 270 deg" in str(row.flags)
        assert math.isnan(row.bias_dph)
        assert not row.is_compared


def test_without_temperatures_there_are_biases_and_no_comparison():
    nothing = (math.nan,) * 3
    (row,) = (
        row
        for row in rows_of(
            [replace(verified(), temperatures=DwellTemperatures(gyro_c=nothing))], [calibrated()]
        )
        if row.method == "velocity"
    )
    assert (row.flags, row.accelerometer_sigma_ug) == ((), pytest.approx(1000.0))
    assert not math.isnan(row.bias_dph)
    assert not row.is_compared


def test_each_unit_is_held_against_its_own_calibration():
    dwells = [verified(), verified(dwell=2, unit="U8")]
    other = calibrated(unit="U8", bias_dph=(0.0, 0.5, 0.0))
    first, second = (row for row in rows_of(dwells, [calibrated(), other]) if row.method == "velocity")
    assert (first.unit, first.calibrated_dph) == ("U7", pytest.approx(-0.02))
    assert (second.unit, second.calibrated_dph) == ("U8", pytest.approx(0.5))


@pytest.mark.parametrize(("scale", "is_flagged"), [(1.0, False), (1.001, True)])
def test_a_table_that_does_not_turn_by_what_it_reads_is_no_bias(scale, is_flagged):
    """Its reading is taken for the truth; the unit stands elsewhere."""
    dwells = [_on_table(each, scale) for each in four_azimuths("z_up")]
    rows = [row for row in rows_of(dwells, [calibrated()]) if row.method == "alignment"]
    assert len(rows) == 2
    for row, others in zip(rows, ("2 and 4", "1 and 3"), strict=True):
        named = [flag for flag in row.flags if f"in dwells {others}: the table does not turn" in flag]
        assert bool(named) == is_flagged
        assert math.isnan(row.p_value) == is_flagged


def _on_table(check, scale):
    """The same dwell, but the table reads an azimuth that is off by a wrong scale."""
    angle = math.radians(check.marks.azimuth_deg) * (1.0 - 1.0 / scale)
    reading = rotation_matrix(UP, -angle)
    dwell = check.navigation.dwell
    tables = tuple(reading @ table for table in dwell.C_nb_table)
    navigation = replace(check.navigation, dwell=replace(dwell, C_nb_table=tables))
    return replace(check, navigation=navigation)


def test_nothing_gives_nothing():
    assert rows_of([], [calibrated()]) == []
