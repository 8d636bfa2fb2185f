from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from gyrobench.bench.closure.validation import LACK_OF_FIT_P, lack_of_fit


@pytest.fixture(scope="module")
def of_clean_data(problem):
    return [lack_of_fit(problem(seed=seed), 0) for seed in range(60)]


@pytest.mark.long
@pytest.mark.parametrize("name", ["time", "temperature", "position", "temperature rate"])
def test_without_anything_left_p_values_are_uniform(of_clean_data, name):
    assert kstest([each.p_structure[name] for each in of_clean_data], "uniform").pvalue > 0.01


@pytest.mark.long
def test_without_anything_left_the_sum_of_squares_is_uniform(of_clean_data):
    assert kstest([each.p_noise for each in of_clean_data], "uniform").pvalue > 0.01


@pytest.mark.long
def test_serial_correlation_of_noise_is_rarely_significant(of_clean_data):
    # A fitted model makes neighbours a little unlike: large values are frequent, small ones are not.
    p_values = [each.p_structure["the previous dwell"] for each in of_clean_data]
    assert kstest(p_values, "uniform", alternative="greater").pvalue > 0.01


@pytest.mark.long
def test_without_anything_left_few_tests_say_that_there_is(of_clean_data):
    # As many tests as there are would give 3 below 0.05 if they had nothing in common.
    assert sum(each.p_value < 0.05 for each in of_clean_data) <= 6
    assert sum(each.p_value < LACK_OF_FIT_P for each in of_clean_data) <= 1


@pytest.mark.long
def test_the_noise_ratio_is_that_of_the_noise(of_clean_data):
    assert np.mean([each.noise_ratio for each in of_clean_data]) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    ("effect", "followed"),
    [("time_drift", "time"), ("square_wave", "temperature"), ("g_sensitivity", "position")],
)
def test_residuals_that_follow_something_are_seen_to(problem, effect, followed):
    left = lack_of_fit(problem({effect: 2.0}, seed=3), 0)
    assert left.p_value < 1e-6
    assert left.follows == followed
    assert left.p_any_structure < 1e-6


def test_residuals_that_follow_the_temperature_rate_are_significant(problem):
    assert lack_of_fit(problem({"temperature_rate": 2.0}, seed=3), 0).p_structure["temperature rate"] < 1e-6


def test_residuals_that_follow_the_previous_dwell_are_significant(problem):
    left = lack_of_fit(problem({"sinusoid": 2.0}, seed=3), 0)
    assert left.p_structure["the previous dwell"] < 1e-6


@pytest.mark.parametrize("noise", [0.5, 2.0])
def test_another_noise_than_stated_is_no_structure(problem, noise):
    left = lack_of_fit(problem(noise=noise), 0)
    assert left.noise_ratio == pytest.approx(noise, rel=0.1)
    assert left.p_any_structure > 0.05
    assert (left.p_noise < 1e-6) == (noise > 1.0)


def test_the_same_residuals_against_their_true_noise_are_clean(problem):
    assert lack_of_fit(problem(sigma_dph=0.001), 0).p_value > 0.05


def test_structure_is_seen_where_the_noise_is_smaller_than_stated(problem):
    left = lack_of_fit(problem({"time_drift": 0.5}, noise=0.3), 0)
    assert left.p_noise > 0.5
    assert left.p_value < 1e-6


def test_p_values_count_how_many_tests_were_made(problem):
    left = lack_of_fit(problem(), 0)
    smallest = min(left.p_noise, *left.p_structure.values())
    assert left.p_value == min(1.0, smallest * (1 + len(left.p_structure)))


def test_parameters_fitted_beside_reduce_the_degrees_of_freedom(problem):
    one = problem()
    assert lack_of_fit(one, 6).noise_ratio == pytest.approx(np.sqrt(one.chi2 / (one.dof - 6)))
    assert lack_of_fit(one, 6).p_noise < lack_of_fit(one, 0).p_noise


def test_without_degrees_of_freedom_nothing_is_significant(problem):
    one = problem()
    left = lack_of_fit(one, one.dof)
    assert (left.p_value, left.p_any_structure) == (1.0, 1.0)
    assert np.isnan(left.noise_ratio)


def test_noise_that_gyros_share_is_named_with_them(problem):
    alone = problem(seed=0)
    assert lack_of_fit(alone, 0).correlated is None
    noise = alone.residuals.copy()
    noise[:, 2] = 0.8 * noise[:, 0] + 0.6 * noise[:, 2]
    first, second, value = lack_of_fit(replace(alone, residuals=noise), 0).correlated
    assert (first, second) == (0, 2)
    assert 0.6 < value < 0.95


@pytest.mark.long
def test_independent_noise_is_rarely_called_shared(of_clean_data):
    assert sum(each.correlated is not None for each in of_clean_data) <= 1
