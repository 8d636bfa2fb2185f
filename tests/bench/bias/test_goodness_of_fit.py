"""What the test of fit of the state-space estimate passes, and what it does not."""

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from gyrobench.bench.bias.bias_filter import estimate_state_space
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.parameters import ErrorModel
from gyrobench.bench.bias.statistics import Chi2Test, chi2_test
from tests.bench.bias import disturbances
from tests.bench.bias.emulated_dwells import emulate, noise_model, sensors, site, turned_about_up

ARW = 0.0006
NOISE = noise_model(ARW)
#: A good dwell is below this once in a hundred thousand.
FLAGGED = 1e-5


def fits(count=3, declared=NOISE, **dwell):
    random = np.random.default_rng(30)
    for _ in range(count):
        emulated = emulate(noise=NOISE, random=random, **dwell)
        yield estimate_state_space(emulated, ErrorModel(site(), declared)).fit


def flagged(**dwell):
    return [fit.p_value < FLAGGED for fit in fits(**dwell)]


def test_good_dwells_pass():
    assert not any(flagged(ins=sensors((0.05, -0.05, 0.05), (100.0, 100.0, 0.0), NOISE)))


@pytest.mark.parametrize("axis", range(3))
def test_a_bias_that_jumps_in_a_window_is_flagged(axis):
    assert all(flagged(ins=sensors(noise=NOISE, gyro_bias_change=disturbances.bias_step(axis, 0.05, 300.0))))


@pytest.mark.parametrize("axis", range(3))
def test_an_attitude_that_jumps_in_a_window_is_flagged(axis):
    change = disturbances.tilt_step("z_up", axis, 1e-4, 300.05)
    assert all(flagged(ins=sensors(noise=NOISE, gyro_bias_change=change)))


@pytest.mark.parametrize("noise", [noise_model(3.0 * ARW), noise_model(ARW, 50.0)])
def test_more_noise_than_declared_is_flagged(noise):
    assert all(flagged(ins=sensors(noise=noise)))


def test_less_noise_than_declared_shows_in_the_ratio():
    declared = NoiseModel(*(3.0 * getattr(NOISE, field.name) for field in fields(NOISE)[:4]))
    for fit in fits(ins=sensors(noise=NOISE), declared=declared):
        assert fit.ratio == pytest.approx(1.0 / 3.0, abs=0.1)


@cache
def undisturbed():
    """A good dwell and its biases."""
    dwell = emulate(ins=sensors(noise=NOISE), noise=NOISE, random=np.random.default_rng(31))
    return dwell, estimate_state_space(dwell, ErrorModel(site(), NOISE)).bias_dph


def spiked(at, velocity_mps=0.0, heading_rad=0.0):
    """Fit of a dwell with one wrong epoch of the first window, and what it does to the bias."""
    dwell, bias_dph = undisturbed()
    first = dwell.windows[0]
    velocity = first.velocity_enu_mps.copy()
    velocity[at] += velocity_mps
    headings = np.zeros(len(velocity))
    headings[at] = heading_rad
    wrong = replace(first, velocity_enu_mps=velocity, C_nb=turned_about_up(first.C_nb, headings))
    spike = replace(dwell, windows=(wrong, *dwell.windows[1:]))
    found = estimate_state_space(spike, ErrorModel(site(), NOISE))
    return found.fit, np.abs(found.bias_dph - bias_dph).max()


@pytest.mark.parametrize("at", [0, 1, 300, 600])
@pytest.mark.parametrize("spike", [{"velocity_mps": 1.0}, {"heading_rad": 1e-3}])
def test_a_wrong_epoch_is_flagged_or_does_no_harm(at, spike):
    fit, shift_dph = spiked(at, **spike)
    assert fit.p_value < FLAGGED or shift_dph < 3e-4


def random_problem(parameters=5, sums=30, prior=1e3):
    random = np.random.default_rng(32)
    responses = random.standard_normal((3 * sums, parameters))
    covariance = np.linalg.inv(responses.T @ responses + np.eye(parameters) / prior**2)
    return random, responses, covariance


@pytest.mark.long
def test_residuals_of_least_squares_have_the_distribution_that_it_shows():
    random, flat, covariance = random_problem()
    results = []
    for _ in range(500):
        data = flat @ random.standard_normal(5) + random.standard_normal(len(flat))
        parameters = covariance @ flat.T @ data
        results.append(chi2_test(data - flat @ parameters, flat, covariance))
    assert {each.dof for each in results} == {90 - 5}
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], 85 * len(results))
    assert low < sum(each.chi2 for each in results) < high
    assert np.mean([each.p_value < 0.05 for each in results]) == pytest.approx(0.05, abs=0.035)


def test_probability_is_that_of_chi_square():
    _, flat, covariance = random_problem()
    data = np.full(len(flat), 1.2)
    fit = chi2_test(data - flat @ covariance @ flat.T @ data, flat, covariance)
    assert fit.p_value == pytest.approx(chi2.sf(fit.chi2, fit.dof))
    assert fit.ratio == pytest.approx(np.sqrt(fit.chi2 / fit.dof))


def test_no_freedom_has_no_ratio():
    assert np.isnan(Chi2Test(0.0, 0, 1.0).ratio)
