"""Weighted means, excess scatter, multiple comparisons and uniformity of p-values."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import fdtrc
from scipy.stats import kstest

from gyrobench.bench.bias.statistics import (
    excess_information,
    excess_sigma,
    excess_variance,
    f_p_value,
    holm,
    uniformity_band,
    uniformity_p_value,
    weighted_fit,
    weighted_mean,
)


def test_two_values_by_hand():
    mean = weighted_mean([10.0, 20.0], [1.0, 2.0])
    assert (mean.value, mean.sigma) == pytest.approx((12.0, 1 / math.sqrt(1.25)))
    assert (mean.chi2, mean.dof) == (pytest.approx(2.0**2 + 4.0**2), 1)
    assert mean.chi2_reduced == mean.chi2
    assert mean.p_value == pytest.approx(math.erfc(math.sqrt(20.0 / 2.0)))


def test_single_value_is_its_own_mean_without_scatter():
    mean = weighted_mean([3.0], [0.5])
    assert (mean.value, mean.sigma, mean.chi2) == (3.0, 0.5, 0.0)
    assert math.isnan(mean.chi2_reduced)
    assert math.isnan(mean.p_value)


def test_mean_scatters_as_much_as_it_says():
    rng = np.random.default_rng(8)
    sigmas = np.array([1.0, 2.0, 0.5])
    means = [weighted_mean(rng.normal(0.0, sigmas), sigmas) for _ in range(2000)]
    assert np.std([mean.value for mean in means]) == pytest.approx(means[0].sigma, rel=0.06)
    assert 0.035 < np.mean([mean.p_value < 0.05 for mean in means]) < 0.065


ONE = np.ones((12, 1))


def test_with_equal_uncertainties_it_is_the_sample_variance_less_the_noise():
    values = np.random.default_rng(0).normal(0.0, 3.0, 12)
    expected = np.var(values, ddof=1) - 1.0
    assert excess_variance(values, np.ones(12), ONE) == pytest.approx(expected, rel=0.01)


def test_what_a_fit_takes_is_allowed_for():
    rng = np.random.default_rng(1)
    design = np.column_stack([np.ones(12), np.arange(12.0)])
    values = rng.normal(0.0, 3.0, 12)
    residuals = values - design @ np.linalg.lstsq(design, values, rcond=None)[0]
    expected = residuals @ residuals / 10.0 - 1.0
    assert excess_variance(values, np.ones(12), design) == pytest.approx(expected, rel=0.01)


def test_values_that_their_uncertainties_explain_have_none():
    assert excess_variance(np.linspace(-0.5, 0.5, 12), np.ones(12), ONE) == 0.0
    sigma = excess_sigma(np.linspace(-0.5, 0.5, 12), np.ones(12), ONE)
    assert (sigma.value, sigma.low) == (0.0, 0.0)
    assert 0.0 < sigma.high < 2.0


def test_no_more_values_than_parameters_determine_nothing():
    sigma = excess_sigma(np.array([1.0]), np.array([1.0]), np.ones((1, 1)))
    assert (sigma.value, sigma.low, sigma.high) == (0.0, 0.0, float("inf"))


def test_the_interval_holds_the_truth_about_as_often_as_stated():
    rng = np.random.default_rng(2)
    held = 0
    for _ in range(200):
        variances = rng.uniform(0.2, 3.0, 12)
        sigma = excess_sigma(rng.normal(0.0, np.sqrt(variances + 4.0)), variances, ONE)
        held += sigma.low <= 2.0 <= sigma.high
    assert 0.90 <= held / 200 <= 0.99


def test_the_information_is_one_over_the_variance_of_the_estimate():
    rng = np.random.default_rng(3)
    variances = np.linspace(0.5, 2.0, 12)
    found = [excess_variance(rng.normal(0.0, np.sqrt(variances + 9.0)), variances, ONE) for _ in range(400)]
    assert np.var(found) == pytest.approx(1.0 / excess_information(variances + 9.0, ONE), rel=0.2)


def test_a_weighted_fit_is_that_of_least_squares():
    design = np.column_stack([np.ones(12), np.arange(12.0)])
    variances = np.linspace(0.5, 2.0, 12)
    fit = weighted_fit(design @ [1.0, 2.0], variances, design)
    assert fit.values == pytest.approx([1.0, 2.0])
    assert fit.chi2 == pytest.approx(0.0, abs=1e-12)
    assert fit.dof == 10
    assert fit.covariance == pytest.approx(np.linalg.inv(design.T @ np.diag(1 / variances) @ design))


def test_the_smallest_p_value_counts_all_comparisons_the_next_one_less():
    assert np.allclose(holm([0.01, 0.04, 0.03]), [0.03, 0.06, 0.06])


def test_no_p_value_exceeds_one_and_none_falls_below_a_smaller_one():
    assert np.allclose(holm([0.5, 0.4, 0.01]), [0.8, 0.8, 0.03])


def test_what_was_not_compared_does_not_count():
    assert np.allclose(holm([np.nan, 0.01, np.nan]), [np.nan, 0.01, np.nan], equal_nan=True)
    assert len(holm([])) == 0


@pytest.mark.parametrize("count", [1, 2, 7, 60])
def test_p_value_is_the_exact_one_where_it_is_small(count):
    rng = np.random.default_rng(count)
    for power in (1.0, 3.0, 20.0):
        values = rng.uniform(size=count) ** power
        exact = kstest(values, "uniform", method="exact").pvalue
        found = uniformity_p_value(values)
        assert exact - 1e-12 <= found
        if exact < 0.1:
            assert found == pytest.approx(exact, rel=0.01)


def test_values_that_sit_too_well_in_the_middle_are_not_uniform():
    assert uniformity_p_value([0.5] * 20) < 1e-3


def test_band_is_left_by_one_uniform_sample_in_twenty():
    rng = np.random.default_rng(4)
    ordered = np.sort(rng.uniform(size=(4000, 30)), axis=1)
    above, below = np.arange(1, 31) / 30 - ordered, ordered - np.arange(30) / 30
    distances = np.maximum(above.max(axis=1), below.max(axis=1))
    assert 0.04 < np.mean(distances > uniformity_band(30)) < 0.06


def test_band_and_test_agree():
    values = np.maximum(np.arange(1, 11) / 10 - uniformity_band(10, 0.99), 0.0)
    assert uniformity_p_value(values) == pytest.approx(0.01)


@pytest.mark.parametrize("dof", [1, 2, 7, 40])
@pytest.mark.parametrize("residual_dof", [1, 4, 51, 6000])
@pytest.mark.parametrize("ratio", [0.0, 0.01, 0.9, 1.1, 4.0, 30.0])
def test_the_p_value_of_a_ratio_of_mean_squares_is_that_of_scipy(dof, residual_dof, ratio):
    assert f_p_value(dof, residual_dof, ratio) == pytest.approx(fdtrc(dof, residual_dof, ratio), rel=1e-9)
