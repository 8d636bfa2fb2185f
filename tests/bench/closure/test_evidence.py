"""Evidence against numerical quadrature, and probabilities against frequencies of data from the prior."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import invgamma, multivariate_normal

from gyrobench.bench.closure import evidence
from gyrobench.bench.closure.candidates import hypothesis_with
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.effects.effect import Effect, Form, Parameter, fixed
from gyrobench.bench.closure.effects.laws import TEMPERATURE_RATE, TIME_DRIFT
from gyrobench.bench.closure.evidence import MAGNITUDES, NOISE_PRIOR, Evidences, detectable_dph, prior_width
from gyrobench.bench.closure.problem import declared_problem
from gyrobench.bench.closure.remainder import RANK, remainder_of
from gyrobench.bench.closure.search import Search
from tests.bench.closure.test_candidates import whole


def with_biases(problem, noise_units):
    """Same dwells with biases of (m, 3) standard deviations."""
    campaign = problem.campaign
    bias_dph = campaign.bias_dph.copy()
    bias_dph[problem.searched] = noise_units * campaign.sigma_dph[problem.searched]
    return declared_problem(replace(campaign, bias_dph=bias_dph), problem.searched)


def log_evidence_by_quadrature(problem, column, sigma):
    """Of one term in all gyros with a standard deviation of its size, integrated over the noise by a sum."""
    ratios = np.geomspace(0.2, 20.0, 2000)
    together = []
    for probability, shape, scale in NOISE_PRIOR:
        total = np.log(probability)
        for gyro in range(3):
            basis = problem.bases[gyro]
            complement = np.linalg.svd(np.eye(len(basis)) - basis @ basis.T)[0][
                :, : len(basis) - basis.shape[1]
            ]
            data, term = complement.T @ problem.residuals[:, gyro], complement.T @ column[gyro]
            covariance = np.eye(len(data)) + sigma**2 * np.outer(term, term)
            chi2 = data @ np.linalg.solve(covariance, data)
            constant = multivariate_normal.logpdf(np.zeros(len(data)), cov=covariance)
            values = constant - 0.5 * len(data) * np.log(ratios) - 0.5 * chi2 / ratios
            values += invgamma.logpdf(ratios, shape, scale=scale) + np.log(np.gradient(ratios))
            total += logsumexp(values)
        together.append(total)
    return logsumexp(together)


def test_values_of_correlated_gyros_count_as_fewer_in_evidence_and_p_values(problem):
    alone = problem({"time_drift": 3.0}, cycles=2, seed=2)
    odds, p_values = [], []
    for each in (alone, replace(alone, correlation_factor=3.0)):
        drift, none = hypothesis_with(each, [whole(TIME_DRIFT)]), hypothesis_with(each, [])
        odds.append(Evidences(each, [TIME_DRIFT]).log_odds(drift, none))
        p_values.append(Search(each, [TIME_DRIFT]).p_value(drift, 0))
    assert 0.2 * odds[0] < odds[1] < 0.5 * odds[0]
    assert p_values[0] < p_values[1] ** 2


@pytest.mark.parametrize("sigma", [0.5, 8.0])
def test_evidence_of_one_term_is_that_of_numerical_quadrature(problem, monkeypatch, sigma):
    """Difference to the declared model: what does not depend on the hypothesis is left out."""
    clean = problem({"time_drift": 1.0}, cycles=2, seed=2)
    monkeypatch.setattr(evidence, "MAGNITUDES", np.array([sigma]))
    monkeypatch.setattr(evidence, "_MAGNITUDE_IN_GYRO", np.eye(1))
    evidences = Evidences(clean, [TIME_DRIFT])
    drift, none = hypothesis_with(clean, [whole(TIME_DRIFT)]), hypothesis_with(clean, [])
    prior = [np.log(each) for each in evidence.EFFECT_COUNT_PRIOR[:2]]
    found = evidences.weights(drift)[0] - evidences.weights(none)[0] - (prior[1] - prior[0])
    columns, rms = clean.project_out(whole(TIME_DRIFT).columns(clean.campaign)[clean.searched])
    column = [columns[gyro, :, 0] / rms[gyro, 0] for gyro in range(3)]
    expected = log_evidence_by_quadrature(clean, column, sigma) - log_evidence_by_quadrature(
        clean, column, 0.0
    )
    assert found == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("count", [20, pytest.param(600, marks=pytest.mark.long)])
def test_probabilities_are_frequencies_of_data_from_the_prior(problem, count):
    """Half the data have a drift of a magnitude from the prior, half nothing."""
    clean, random = problem(cycles=2), np.random.default_rng(5)
    column = whole(TIME_DRIFT).columns(clean.campaign)[clean.searched]
    _, rms = clean.project_out(column)
    stated, true = [], []
    prior = np.array(evidence.EFFECT_COUNT_PRIOR[:2]) / sum(evidence.EFFECT_COUNT_PRIOR[:2])
    for _ in range(count):
        is_there = random.random() < prior[1]
        size = random.choice(MAGNITUDES[:2]) * random.standard_normal(3) if is_there else np.zeros(3)
        noise = random.standard_normal((clean.searched.sum(), 3))
        data = with_biases(clean, noise + column[:, :, 0] / rms[:, 0] / clean.sigma_dph * size)
        evidences = Evidences(data, [TIME_DRIFT])
        both = [hypothesis_with(data, []), hypothesis_with(data, [whole(TIME_DRIFT)])]
        stated.append(evidences.posterior(both).effect_probabilities["time_drift"])
        true.append(is_there)
    stated, true = np.array(stated), np.array(true)
    for low, high in ((0.0, 0.1), (0.1, 0.9), (0.9, 1.0)):
        mine = (stated >= low) & (stated <= high)
        spread = max(np.sqrt(np.sum(stated[mine] * (1.0 - stated[mine]))), 1.0)
        assert np.sum(true[mine]) == pytest.approx(np.sum(stated[mine]), abs=4.0 * spread + 0.04 * mine.sum())


def test_a_bend_that_no_effect_describes_is_not_on_the_list(problem):
    data = problem({"g_sensitivity": 2.0}, seed=3)
    found, posterior = Search(data, [TEMPERATURE_RATE, TIME_DRIFT]).most_probable()
    assert posterior.unlisted_probability > 0.99
    assert max(posterior.process_probabilities, key=posterior.process_probabilities.get).startswith(
        "attitude"
    )
    assert not found.names


def test_clean_data_are_probably_clean(problem):
    _, posterior = Search(problem(seed=4), all_effects()).most_probable()
    assert posterior.no_effect_probability > 0.9
    assert posterior.unlisted_probability < 0.05


def test_an_effect_that_can_not_be_fitted_is_as_probable_as_the_one_that_it_imitates(problem):
    data = problem({"temperature_rate": 4.0}, sensors=(), seed=1)
    _, posterior = Search(data, all_effects()).most_probable()
    assert posterior.effect_probabilities["thermal_gradient"] == pytest.approx(
        posterior.effect_probabilities["temperature_rate"], rel=0.1
    )
    assert "thermal_gradient" in posterior.tied_with(frozenset({"temperature_rate"}), "temperature_rate")


def test_terms_that_were_dropped_are_summed_over(problem):
    """Data with two orthogonal terms: the evidence is that of all subsets, whichever the search kept."""
    clean = problem(cycles=2, seed=2)
    terms = np.zeros((len(clean.campaign), 3, 2))
    terms[::4, :, 0] = terms[1::4, :, 1] = clean.sigma_dph[0]
    two = Effect("two", "", "", (Form(("one", "other"), lambda _campaign, _values: terms),))
    data = with_biases(clean, clean.residuals + 1.5 * (terms[clean.searched, :, 0] > 0.0))
    subsets = [np.array(each) for each in ([True, True], [True, False], [False, True])]
    evidences = Evidences(data, [two])

    def weight(*kept):
        one = replace(whole(two), kept=np.stack(kept))
        return evidences.weights(hypothesis_with(data, [one]))[0]

    assert weight(*[subsets[0]] * 3) == pytest.approx(weight(*[subsets[1]] * 3), abs=0.7)


def test_the_prior_of_an_onset_does_not_depend_on_its_zero(problem):
    """Limits of 5 and 60 degC are no reason to expect the onset at 10 degC."""
    onset, scale = (Parameter("p", 5.0, 60.0, fixed(20.0), is_place=each) for each in (True, False))
    one = problem()
    assert prior_width(one, onset, 10.0) == prior_width(one, onset, 50.0) == 55.0
    assert prior_width(one, scale, 10.0) == pytest.approx(10.0 * np.log(12.0))


def test_the_evidence_of_a_step_is_the_same_for_all_times_between_two_dwells(problem):
    dense = problem(cycles=2, seed=2)
    campaign = replace(dense.campaign, end_s=dense.campaign.end_s - 300.0)
    clean = declared_problem(campaign, dense.searched)
    gap_s = np.linspace(campaign.end_s[10], campaign.start_s[11], 4)[1:-1]
    data = with_biases(clean, clean.residuals + 4.0 * (campaign.start_s > gap_s[0])[clean.searched, None])
    [jump] = [each for each in all_effects() if each.name == "bias_jump"]
    fits = [hypothesis_with(data, [replace(whole(jump), values=(at_s,))]) for at_s in gap_s.tolist()]
    first, second = (Evidences(data, [jump]).weights(each)[0] for each in fits)
    assert gap_s[1] > gap_s[0]
    assert first == pytest.approx(second, abs=1e-6)


def test_effects_that_are_not_significant_count(problem):
    search = Search(problem(seed=4), all_effects())
    found, posterior = search.most_probable()
    assert not found.names
    weak = [p for name, p in posterior.effect_probabilities.items() if name not in search.single_effects]
    assert len(weak) > 5
    assert 0.0 < min(weak) <= max(weak) < 0.1


@pytest.mark.parametrize(("count", "within"), [(15, 0.25), pytest.param(40, 0.15, marks=pytest.mark.long)])
def test_a_remainder_of_the_stated_size_is_shown_in_nine_of_ten(problem, count, within):
    clean, random = problem(), np.random.default_rng(6)
    remainder = remainder_of(clean)
    index = remainder.names.index("temperature")
    size = detectable_dph(clean)["temperature"] / np.sqrt(np.mean(clean.sigma_dph**2))
    shown = []
    for _ in range(count):
        noise = random.standard_normal((clean.searched.sum(), 3))
        for gyro in range(3):
            amplitudes = size * np.sqrt(remainder.powers[gyro, index]) * random.standard_normal(RANK)
            noise[:, gyro] += remainder.directions[gyro, index] @ amplitudes
        data = with_biases(clean, noise)
        shown.append(Evidences(data, []).posterior([hypothesis_with(data, [])]).unlisted_probability > 0.5)
    assert np.mean(shown) == pytest.approx(0.9, abs=within)  # three standard deviations
