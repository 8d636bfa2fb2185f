"""Scatter beyond stated uncertainties, against what is known in closed form and by simulation."""

import numpy as np
import pytest

from gyrobench.bench.bias.random_effects import (
    excess_information,
    excess_sigma,
    excess_variance,
    weighted_fit,
)

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


def test_no_more_values_than_unknowns_tell_nothing():
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
    assert fit.freedom == 10
    assert fit.covariance == pytest.approx(np.linalg.inv(design.T @ np.diag(1 / variances) @ design))
