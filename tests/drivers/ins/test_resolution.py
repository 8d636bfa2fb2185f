import numpy as np
import pytest

from gyrobench.drivers.ins.resolution import (
    LIMIT_DPH,
    horizontal_gyro_errors_dph,
    resolution_report,
    vertical_gyro_errors_dph,
)

WINDOW_S, SAMPLES = 600.0, 6000
DPH = np.radians(1 / 3600)
G = 9.80665


def slope_weights(order):
    """Weights of the samples in the least-squares derivative of that order, SI."""
    time_s = (np.arange(SAMPLES) + 0.5) / SAMPLES * WINDOW_S
    fit = np.linalg.pinv(np.vander(time_s - WINDOW_S / 2, order + 1, increasing=True))
    return fit[order] * order


def test_errors_are_those_of_least_squares_fits_over_both_windows():
    step = 1e-3
    second, first = slope_weights(2), slope_weights(1)
    sigma, worst = horizontal_gyro_errors_dph(step, WINDOW_S, SAMPLES)
    white = step / np.sqrt(12) * np.linalg.norm(second) * np.sqrt(2) / (2 * G)
    bound = 2 * step / 2 * np.abs(second).sum() / (2 * G)
    assert (sigma, worst) == pytest.approx((white / DPH, bound / DPH), rel=1e-3)
    sigma, worst = vertical_gyro_errors_dph(step, WINDOW_S, SAMPLES)
    white = step / np.sqrt(12) * np.linalg.norm(first) / np.sqrt(2)
    bound = step / 2 * np.abs(first).sum()
    assert (sigma, worst) == pytest.approx((white / DPH, bound / DPH), rel=1e-3)


def test_rounding_a_real_drift_stays_within_the_bound():
    rng = np.random.default_rng(0)
    time_s = (np.arange(SAMPLES) + 0.5) / SAMPLES * WINDOW_S
    step = 0.01
    _, worst = horizontal_gyro_errors_dph(step, WINDOW_S, SAMPLES)
    errors = []
    for _ in range(200):
        velocity = rng.uniform(-1, 1) * step + rng.uniform(-1, 1, 2) @ [
            time_s * 1e-5,
            G * 0.002 * DPH * time_s**2,
        ]
        rounding = np.rint(velocity / step) * step - velocity
        errors.append(abs(slope_weights(2) @ rounding) / G / DPH)
    assert max(errors) < worst
    assert max(errors) > 0.1 * worst


def test_the_projects_ins_is_fine_enough(signal_map, codec):
    limits = {limit.quantity: limit for limit in resolution_report(signal_map, codec)}
    assert set(limits) == {"velocity_east", "velocity_north", "attitude.euler.yaw"}
    assert all(limit.sufficient for limit in limits.values())
    assert limits["velocity_east"].lsb == pytest.approx(1e-4)
    assert limits["attitude.euler.yaw"].lsb == pytest.approx(1e-6)
    assert "VELOCITY_NE.VELOCITY_EAST" in limits["velocity_east"].text
    assert "sufficient" in limits["velocity_east"].text


def test_an_output_of_centimetres_per_second_and_tenths_of_milliradians_is_too_coarse(signal_map, codec_with):
    codec = codec_with(
        {
            '(0.0001,0) [-214748.3648|214748.3647] "m/s"': '(0.01,0) [0|0] "m/s"',
            '(1E-006,0) [0|360] "deg"': '(0.0001,0) [0|0] "rad"',
        }
    )
    limits = resolution_report(signal_map, codec)
    assert not any(limit.sufficient for limit in limits)
    assert all("too coarse" in limit.text for limit in limits)
    assert limits[0].sigma_dph < LIMIT_DPH < limits[0].worst_dph


def test_the_step_of_a_floating_point_signal_is_that_at_its_largest_value(signal_map, codec_with):
    codec = codec_with(
        {
            "(1E-006,0) [0|360]": "(1,0) [0|360]",
            "SIG_VALTYPE_ 513 VALUE : 1;": "SIG_VALTYPE_ 513 VALUE : 1;\nSIG_VALTYPE_ 7 HEADING : 1;",
        }
    )
    yaw = resolution_report(signal_map, codec)[2]
    assert yaw.lsb == pytest.approx(2.0**-16)
    assert yaw.sufficient


def test_a_coarse_quaternion_is_found_by_its_coarsest_component(make_signal_map, codec_with):
    codec = codec_with({'(1E-006,0) [-180|180] "deg"': '(3.05e-05,0) [0|0] ""'})
    quaternion = (
        "quaternion: {w: HEADING.HEADING, x: ROLL_PITCH.ROLL, y: HEIGHT_VELOCITY_D.HEIGHT, "
        "z: ROLL_PITCH.PITCH, frames: frd_to_ned}"
    )
    signal_map = make_signal_map(
        {
            "  euler:\n    roll: ROLL_PITCH.ROLL\n    pitch: ROLL_PITCH.PITCH\n    yaw: HEADING.HEADING\n"
            "    sequence: INS_STATUS.EULER_SEQUENCE\n    yaw_positive: down": f"  {quaternion}"
        }
    )
    azimuth = resolution_report(signal_map, codec)[2]
    assert azimuth.quantity == "attitude.quaternion.y"
    assert azimuth.lsb == pytest.approx(np.degrees(2 * np.sqrt(2) * 1e-4))
    assert not azimuth.sufficient
