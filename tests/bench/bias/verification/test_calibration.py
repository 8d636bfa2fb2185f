import math
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.prior import PriorKnowledge
from gyrobench.bench.bias.verification.calibration import Calibration
from gyrobench.bench.navigation.positions import POSITIONS

UG = 9.80665e-6
PRIOR = PriorKnowledge.from_datasheet(accelerometer_bias_ug=1000.0, accelerometer_misalignment_arcsec=5.0)
GRAVITY_UG = 5.0 * np.pi / 180.0 / 3600.0 * 1e6  # what 5 arcsec let in
SIGMA_DPH, SIGMA_UG = 0.001, 3.0


def triple(values):
    return tuple(float(each) for each in np.broadcast_to(values, 3))


def row(position="z_up", gyro_c=20.0, bias_dph=0.0, accelerometer_ug=0.0, **fields):
    """A dwell; one value stands for all three axes."""
    vertical = POSITIONS[position].up_axis
    sigmas = [1000.0 if axis == vertical else SIGMA_UG for axis in range(3)]
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
            "gyro_c": triple(gyro_c),
            "gyro_rate_c_per_h": (0.0,) * 3,
            "bias_dph": triple(bias_dph),
            "sigma_dph": (SIGMA_DPH,) * 3,
            "accelerometer_ug": triple(accelerometer_ug),
            "accelerometer_sigma_ug": tuple(sigmas),
        }
        | fields
    )


def known_ug(rows, position="z_up", gyro_c=20.0):
    known = Calibration(rows, PRIOR).accelerometers(position, (gyro_c,) * 3)
    return known.bias / UG, known.sigma / UG


def test_a_gyro_has_its_own_bias_in_each_position_and_temperature():
    rows = [
        row("z_up", 20.0, bias_dph=(0.001, 0.002, 0.003)),
        row("z_up", 40.0, bias_dph=(0.005, 0.006, 0.007)),
        row("z_down", 20.0, bias_dph=(-0.001, -0.002, -0.003)),
    ]
    calibration = Calibration(rows, PRIOR)
    assert calibration.gyro_dph("z_up", 0, 20.0) == pytest.approx((0.001, SIGMA_DPH))
    assert calibration.gyro_dph("z_up", 2, 30.0)[0] == pytest.approx(0.005)
    assert calibration.gyro_dph("z_down", 1, 20.0)[0] == pytest.approx(-0.002)


def test_a_gyro_that_was_not_measured_near_has_no_calibrated_bias():
    calibration = Calibration([row("z_up", 20.0)], PRIOR)
    assert calibration.gyro_dph("z_up", 0, 25.0) is None
    assert calibration.gyro_dph("y_up", 0, 20.0) is None
    assert Calibration([], PRIOR).gyro_dph("z_up", 0, 20.0) is None


def test_each_gyro_is_read_at_its_own_temperature():
    calibration = Calibration([row(gyro_c=(10.0, 20.0, 30.0))], PRIOR)
    found = [
        [calibration.gyro_dph("z_up", axis, c) is not None for c in (10.0, 20.0, 30.0)] for axis in range(3)
    ]
    assert found == np.eye(3, dtype=bool).tolist()


def test_dwells_with_flags_are_left_out():
    good, bad = row(bias_dph=0.001), row(bias_dph=0.05, accelerometer_ug=9e3, flags="door opened")
    assert Calibration([good, bad], PRIOR).gyro_dph("z_up", 0, 20.0) == pytest.approx((0.001, SIGMA_DPH))
    np.testing.assert_allclose(known_ug([good, bad])[0], 0.0)
    assert Calibration([bad], PRIOR).gyro_dph("z_up", 0, 20.0) is None


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


def test_without_a_calibration_near_the_accelerometers_are_as_uncertain_as_beforehand():
    without = replace(row(), accelerometer_ug=(math.nan,) * 3, accelerometer_sigma_ug=(math.nan,) * 3)
    for rows in ([], [row(gyro_c=60.0)], [without]):
        bias, sigma = known_ug(rows)
        np.testing.assert_allclose(bias, 0.0)
        np.testing.assert_allclose(sigma, 1000.0)
