"""Standard uncertainties and intervals hold what they state, over simulated units of known parameters."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtri

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.candidates import Candidate, best_start, refine, solve_with
from gyrobench.bench.closure.effects.laws import G_SENSITIVITY, WARM_UP
from gyrobench.bench.closure.problem import declared_problem
from gyrobench.bench.closure.uncertainty import _chi2_quantile_4_dof, bound_of, draw, interval
from tests.bench.closure.thermal_bench import SIGMA_DPH, measure

TWO_SIGMA = 1.96


@pytest.fixture(scope="module")
def quiet():
    return campaign_of(measure(cycles=2, dwell_s=3600.0, power_on_each_cycle=True, noise=0.0).rows)


def fitted(campaign, effect, values, sizes_dph, random):
    """A unit with an effect: its true bias, the candidate fitted to it, the fit and the draws."""
    form = effect.forms[0]
    true = Candidate(effect, form, values, np.ones((3, len(form.terms)), dtype=bool))
    bias_dph = campaign.bias_dph + np.einsum("ngk,gk->ng", true.columns(campaign), sizes_dph)
    noisy = replace(campaign, bias_dph=bias_dph + SIGMA_DPH * random.standard_normal(bias_dph.shape))
    problem = declared_problem(noisy, noisy.all_dwells)
    [candidate] = refine(problem, [best_start(problem, effect, form)])
    return bias_dph, candidate, solve_with(problem, [candidate]), draw(problem, [candidate])


@pytest.mark.long
def test_sizes_and_predictions_are_within_their_95_percent_intervals(quiet):
    random = np.random.default_rng(1)
    of_sizes, of_predictions = [], []
    for _ in range(100):
        sizes_dph = 2.0 * SIGMA_DPH * random.standard_normal((3, 3))
        bias_dph, _, model, draws = fitted(quiet, G_SENSITIVITY, (), sizes_dph, random)
        sigma_dph = draws.sigma(draws.sizes_dph["g_sensitivity"], model.sizes[0])
        of_sizes.append(np.abs(model.sizes[0] - sizes_dph) < TWO_SIGMA * sigma_dph)
        sigma_dph = draws.sigma(draws.bias_dph(quiet), model.bias_dph)
        of_predictions.append(np.abs(model.bias_dph - bias_dph) < TWO_SIGMA * sigma_dph)
    assert 0.92 < np.mean(of_sizes) < 0.975
    assert 0.92 < np.mean(of_predictions) < 0.975


@pytest.mark.long
def test_a_time_constant_is_within_its_95_percent_interval(quiet):
    random = np.random.default_rng(2)
    effect = WARM_UP.bounded(quiet)
    [parameter] = effect.forms[0].parameters
    held, lengths = [], []
    for _ in range(50):
        tau_s = float(np.exp(random.uniform(np.log(1.0 * 3600.0), np.log(12.0 * 3600.0))))
        sizes_dph = 6.0 * SIGMA_DPH * random.choice([-1.0, 1.0], (3, 1))
        _, candidate, _, draws = fitted(quiet, effect, (tau_s,), sizes_dph, random)
        low, high = interval(parameter, candidate.values[0], draws.values["warm_up"][:, 0])
        held.append(low <= tau_s <= high)
        lengths.append(np.log(high / low))
    assert np.mean(held) >= 0.86  # 95 % of 50 within three standard deviations
    assert np.median(lengths) < 1.5


def test_noise_that_gyros_share_widens_the_interval_of_a_parameter_that_they_have_in_common(quiet):
    effect = WARM_UP.bounded(quiet)
    candidate = Candidate(effect, effect.forms[0], (4.0 * 3600.0,), np.ones((3, 1), dtype=bool))
    bias_dph = quiet.bias_dph + 6.0 * SIGMA_DPH * candidate.columns(quiet)[..., 0]
    bias_dph += SIGMA_DPH * np.random.default_rng(4).standard_normal(bias_dph.shape)
    alone = declared_problem(replace(quiet, bias_dph=bias_dph), quiet.all_dwells)
    drawn = [draw(replace(alone, correlation_factor=each), [candidate]) for each in (1.0, 3.0)]
    logs = [np.log(each.values["warm_up"]).std() for each in drawn]
    assert logs[1] == pytest.approx(np.sqrt(3.0) * logs[0], rel=0.25)


def test_a_parameter_at_its_bound_has_an_interval_that_ends_there(quiet):
    effect = WARM_UP.bounded(quiet)
    [parameter] = effect.forms[0].parameters
    sizes_dph = 40.0 * SIGMA_DPH * np.ones((3, 1))
    _, candidate, _, draws = fitted(
        quiet, effect, (0.2 * parameter.low,), sizes_dph, np.random.default_rng(3)
    )
    assert bound_of(parameter, candidate.values[0]) == "lower"
    low, high = interval(parameter, candidate.values[0], draws.values["warm_up"][:, 0])
    assert low == parameter.low < high


def test_noise_above_the_stated_one_widens_the_uncertainties(quiet):
    sigmas = []
    for scale in (1.0, 2.0):
        random = np.random.default_rng(4)
        noisy = replace(quiet, sigma_dph=quiet.sigma_dph / scale)
        sizes_dph = 3.0 * SIGMA_DPH * np.ones((3, 3))
        _, _, model, draws = fitted(noisy, G_SENSITIVITY, (), sizes_dph, random)
        sigmas.append(draws.sigma(draws.sizes_dph["g_sensitivity"], model.sizes[0]).mean())
    assert 0.85 < sigmas[1] / sigmas[0] <= 1.0


def test_the_quantiles_of_four_squares_are_those_of_scipy():
    probability = np.array([1e-9, 1e-3, 0.3, 0.5, 0.9, 1.0 - 1e-6])
    assert _chi2_quantile_4_dof(probability) == pytest.approx(chdtri(4.0, probability), rel=1e-9)
