"""Scatter, uncertainty and fit of the state-space estimate of dwells that differ in their noise."""

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from gyrobench.bench.bias.bias_filter import estimate_state_space
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.paper import estimate_paper
from gyrobench.bench.bias.parameters import ErrorModel
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.bias.cramer_rao import CramerRao
from tests.bench.bias.emulated_dwells import CLEAN, DPH, emulate, noise_model, sensors, site

NOISY = noise_model(0.001)
SHORT = {"window_s": 300.0, "epoch_s": 2.0}
TRUTH_DPH = np.array([0.02, -0.01, 0.015])


def estimate(dwell, noise=NOISY):
    return estimate_state_space(dwell, ErrorModel(site(), noise, CLEAN))


def chi_square(estimates, truth_dph):
    """Sum of the squared errors weighted by their covariance; three degrees of freedom each."""
    errors = [each.bias_radps - np.asarray(truth_dph) * DPH for each in estimates]
    return sum(e @ np.linalg.solve(each.covariance, e) for e, each in zip(errors, estimates, strict=True))


def assert_chi_square(value, dof):
    low, high = chi2.ppf([1e-4, 1.0 - 1e-4], dof)
    assert low < value < high


@pytest.fixture(scope="module", params=[40, pytest.param(200, marks=pytest.mark.long)])
def noisy_dwells(request):
    """Dwells that differ in their noise alone."""
    random = np.random.default_rng(20)
    ins = sensors(TRUTH_DPH, (20.0, 40.0, 0.0), NOISY)
    return [emulate("z_up", ins, noise=NOISY, random=random, **SHORT) for _ in range(request.param)]


@pytest.fixture(scope="module")
def noisy_estimates(noisy_dwells):
    return [estimate(dwell) for dwell in noisy_dwells]


@pytest.fixture(scope="module")
def bound():
    return CramerRao(window_s=SHORT["window_s"], epoch_s=SHORT["epoch_s"])


def test_uncertainty_is_the_least_that_the_data_allow(noisy_estimates, bound):
    """By the Fisher information of the simulated INS; a velocity that may jump in the turn costs little."""
    sigma = np.sqrt(np.diag(noisy_estimates[0].covariance))
    np.testing.assert_allclose(sigma, bound.bias_sigma(NOISY, velocity_jump=True)[:3], rtol=1e-3)
    np.testing.assert_allclose(sigma, bound.bias_sigma(NOISY, velocity_jump=False)[:3], rtol=0.05)


def test_uncertainty_of_the_level_accelerometers_is_the_least_too(noisy_estimates, bound):
    least = bound.bias_sigma(NOISY, velocity_jump=True)[3:5]
    np.testing.assert_allclose(noisy_estimates[0].accelerometer_sigma[:2], least, rtol=5e-3)


def test_errors_scatter_as_the_bound_says(noisy_estimates, bound):
    errors = np.array([each.bias_radps for each in noisy_estimates]) - TRUTH_DPH * DPH
    for gyro, sigma in zip(errors.T, bound.bias_sigma(NOISY, velocity_jump=True)[:3], strict=True):
        assert_chi_square((gyro**2).sum() / sigma**2, len(errors))
    assert_chi_square(chi_square(noisy_estimates, TRUTH_DPH), 3 * len(errors))


def test_errors_are_smaller_than_those_of_the_papers_method(noisy_dwells, noisy_estimates):
    papers = np.array([estimate_paper(dwell, site().gravity, NOISY).bias_dph for dwell in noisy_dwells])
    ours = np.array([each.bias_dph for each in noisy_estimates])
    # 1.1 with a standard deviation of 0.015.
    assert np.mean(papers.std(axis=0) / ours.std(axis=0)) > 1.05


def test_intervals_of_95_percent_hold_the_truth_in_95_percent(noisy_estimates):
    off = [np.abs(each.bias_dph - TRUTH_DPH) / each.sigma_dph for each in noisy_estimates]
    # A share of 0.95 in 200 scatters by 0.015.
    assert np.abs((np.array(off) < 1.96).mean(axis=0) - 0.95).max() < 0.05


def test_the_fit_of_true_dwells_has_uniform_p_values(noisy_estimates):
    assert kstest([each.fit.p_value for each in noisy_estimates], "uniform").pvalue > 1e-3
    assert np.mean([each.fit.chi2 / each.fit.dof for each in noisy_estimates]) == pytest.approx(1.0, abs=0.05)


@pytest.mark.long
@pytest.mark.parametrize(
    ("position", "stops_deg"),
    [("y_up", (30.0, -150.0)), ("x_down", (0.0, 120.0)), ("y_up", (0.0, 90.0, 180.0, 270.0))],
)
def test_uncertainty_is_right_with_any_azimuths_and_turns(position, stops_deg):
    random, ins = np.random.default_rng(21), sensors(TRUTH_DPH, noise=NOISY)
    estimates = [
        estimate(emulate(position, ins, noise=NOISY, random=random, stops_deg=stops_deg, window_s=120.0))
        for _ in range(30)
    ]
    assert_chi_square(chi_square(estimates, TRUTH_DPH), 3 * len(estimates))


@pytest.mark.long
def test_uncertainty_is_right_with_outputs_of_the_resolution_of_the_emulated_ins():
    noise = NoiseModel.from_datasheet(0.0006, 5.0, 1e-4, np.radians(1e-6))
    random, ins = np.random.default_rng(22), sensors(TRUTH_DPH, noise=noise)
    estimates = [
        estimate(emulate(position, ins, random=random, lsb=(1e-4, 1e-6), epoch_s=0.1, window_s=120.0), noise)
        for position in POSITIONS
        for _ in range(8)
    ]
    assert_chi_square(chi_square(estimates, TRUTH_DPH), 3 * len(estimates))
    assert_chi_square(sum(each.fit.chi2 for each in estimates), sum(each.fit.dof for each in estimates))
