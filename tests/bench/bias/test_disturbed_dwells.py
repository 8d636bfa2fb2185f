"""State-space estimate of dwells in which more acts than biases and noise."""

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.bias_filter import estimate_state_space
from gyrobench.bench.bias.parameters import ErrorModel, PriorKnowledge
from tests.bench.bias import disturbances
from tests.bench.bias.emulated_dwells import CLEAN, emulate, noise_model, sensors, site
from tests.bench.bias.pyins_dwells import RestingIns, simulate

NOISE = noise_model(0.0006)
#: With a surveyed latitude.
DEFAULT = PriorKnowledge.from_datasheet(latitude_arcmin=0.02)
BIAS_DPH = np.array([0.05, -0.05, 0.05])
EXACT_DPH = 2e-4


def estimate(dwell, prior=DEFAULT):
    return estimate_state_space(dwell, ErrorModel(site(), NOISE, prior))


def error_dph(dwell, bias_dph=BIAS_DPH):
    return estimate(dwell).bias_dph - bias_dph


def assert_declared(dwell, truth_dph=(0.0, 0.0, 0.0), **declared):
    """The error without noise is within three times the uncertainty that what is declared adds."""
    nothing = dict.fromkeys(
        (
            *("gyro_scale_factor_ppm", "gyro_misalignment_arcsec", "tilt_step_arcsec", "latitude_arcmin"),
            "accelerometer_drift_ug_per_h",
        ),
        0.0,
    )
    prior = PriorKnowledge.from_datasheet(**nothing | declared)
    known = estimate(dwell, prior)
    added_dph = np.sqrt(np.maximum(known.sigma_dph**2 - estimate(dwell, CLEAN).sigma_dph ** 2, 0.0))
    assert np.all(np.abs(known.bias_dph - truth_dph) < 3.0 * added_dph + 1e-5)
    return known


@pytest.mark.parametrize(("position", "outer_level"), [("z_up", False), ("y_up", True), ("x_down", True)])
def test_errors_of_scale_and_misalignment_in_the_turn_stay_within_their_uncertainty(position, outer_level):
    off_axis = 5.0 * np.pi / 180.0 / 3600.0 * np.array([[0, 1, -1], [1, 0, 1], [-1, 1, 0]])
    scale = emulate(position, sensors(gyro_matrix=np.diag([5e-6, -5e-6, 5e-6])), outer_level=outer_level)
    assert np.abs(assert_declared(scale, gyro_scale_factor_ppm=5.0).bias_dph).max() < EXACT_DPH
    crossed = emulate(position, sensors(gyro_matrix=off_axis), outer_level=outer_level)
    assert np.abs(assert_declared(crossed, gyro_misalignment_arcsec=5.0).bias_dph).max() < 1e-3


def test_a_drift_of_an_accelerometer_stays_within_the_uncertainty_that_it_adds():
    """10 ug over 2 x 600 s and the turn pass for 1.7e-3 deg/h, as 30 ug/h lead to expect."""
    ug = 9.80665e-6
    dwell = simulate(RestingIns(accelerometer_drift_mps2=(10.0 * ug, 0.0, 0.0)))
    drift_ug_per_h = 10.0 * 3600.0 / (dwell.windows[1].time_s[-1] - dwell.windows[0].time_s[0])
    known = assert_declared(dwell, accelerometer_drift_ug_per_h=drift_ug_per_h)
    assert 1e-3 < np.abs(known.bias_dph).max() < 2e-3


def test_a_scale_factor_error_makes_no_vertical_bias_out_of_the_turn():
    """The heading step of 5 ppm over the turn would be 3e-3 deg/h."""
    dwell = emulate(ins=sensors(gyro_matrix=5e-6 * np.eye(3)))
    assert abs(estimate(dwell, CLEAN).bias_dph[2]) < 1e-4


@pytest.mark.parametrize("axis", range(3))
def test_a_tilt_of_the_sensors_in_the_turn_stays_within_its_uncertainty(axis):
    size = 5.0 * np.pi / 180.0 / 3600.0
    change = disturbances.tilt_step("y_up", axis, size, 612.505, np.pi / 2)
    assert_declared(emulate("y_up", sensors(gyro_bias_change=change)), tilt_step_arcsec=5.0)


def test_a_latitude_that_may_be_wrong_costs_the_vertical_gyro_its_certainty():
    dwell = emulate("x_up", latitude_error_arcmin=1.0)
    trusting = estimate(dwell, CLEAN)
    assert abs(trusting.bias_dph[0]) == pytest.approx(0.0035, rel=0.02)
    assert_declared(dwell, latitude_arcmin=1.0)
    known = estimate(
        dwell, PriorKnowledge.from_datasheet(latitude_arcmin=1.0, accelerometer_drift_ug_per_h=0.0)
    )
    assert np.abs(known.bias_dph).max() < 1e-3
    np.testing.assert_allclose(known.sigma_dph[1:], trusting.sigma_dph[1:], rtol=0.02)


def test_a_rate_fixed_to_the_earth_stays_out_of_the_level_gyros():
    change = disturbances.navigation_rate("z_up", (0.005, 0.005, 0.005))
    error = estimate(emulate("z_up", sensors(gyro_bias_change=change))).bias_dph
    assert np.abs(error[:2]).max() < EXACT_DPH
    assert error[2] == pytest.approx(0.005, abs=EXACT_DPH)


def test_a_velocity_that_jumps_in_the_turn_does_not_matter():
    """A tilt of 1e-3 rad for ten seconds of the turn leaves 0.1 m/s."""

    def tilted_for_ten_seconds(time_s):
        ends = (
            (size, 612.5 + at_s, np.pi / 2.0 * (1.0 + np.sin(np.pi * at_s / 25.0)))
            for size, at_s in ((1e-3, -4.995), (-1e-3, 5.005))
        )
        return sum(disturbances.tilt_step("z_up", 0, *end)(time_s) for end in ends)

    dwell = emulate(ins=sensors(BIAS_DPH, gyro_bias_change=tilted_for_ten_seconds))
    jump = dwell.windows[1].velocity_enu_mps[0] - dwell.windows[0].velocity_enu_mps[-1]
    assert abs(jump[1]) == pytest.approx(0.098, rel=0.05)
    assert np.abs(error_dph(dwell)).max() < EXACT_DPH


def ramp(rate_c_per_h):
    return lambda time_s: rate_c_per_h * (np.maximum(time_s, -300.0) - 612.5) / 3600.0


def soak(time_s):
    return 4.0 * (1.0 - np.exp(-np.maximum(time_s, 0.0) / 300.0))


@pytest.mark.parametrize("is_known", [True, False])
@pytest.mark.parametrize("rate_c_per_h", [10.0, -60.0])
def test_a_bias_that_follows_a_ramp_is_given_at_the_mean_temperature(rate_c_per_h, is_known):
    warmth = ramp(rate_c_per_h)
    change = disturbances.warming((0.001, -0.001, 0.0005), warmth)
    gyro_c = (lambda time_s: 40.0 + np.multiply.outer(warmth(time_s), np.ones(3))) if is_known else None
    dwell = emulate("y_down", sensors(BIAS_DPH, gyro_bias_change=change), gyro_c=gyro_c)
    assert np.abs(error_dph(dwell, BIAS_DPH)).max() < EXACT_DPH


def test_each_gyro_has_its_own_mean_temperature():
    def gyro_c(time_s):
        return 20.0 + np.multiply.outer(soak(time_s), [1.0, 0.5, -1.0])

    slopes = np.array([0.001, 0.001, -0.001])
    change = disturbances.warming(slopes * [1.0, 0.5, -1.0], soak)
    dwell = emulate("z_up", sensors(gyro_bias_change=change), gyro_c=gyro_c)
    mean_c = np.concatenate([window.gyro_c for window in dwell.windows]).mean(axis=0) - 20.0
    assert np.abs(error_dph(dwell, slopes * mean_c)).max() < EXACT_DPH


def test_temperatures_explain_what_would_be_a_misfit_without_them():
    change = disturbances.warming((0.001, 0.001, 0.001), ramp(120.0))
    dwell = emulate(
        ins=sensors(gyro_bias_change=change),
        gyro_c=lambda time_s: np.multiply.outer(ramp(120.0)(time_s), np.ones(3)),
    )
    untold = replace(dwell, windows=tuple(replace(window, gyro_c=None) for window in dwell.windows))
    assert estimate(dwell).fit.ratio < 0.2
    assert estimate(untold).fit.p_value < 1e-6
