import numpy as np
import pytest
from scipy.special import chdtrc
from scipy.stats import multivariate_normal

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.investigation.choice import Prediction, entropy, expected_entropy_after, linearize
from tests.bench.investigation.simulated_bench import first_campaign, simulate


def prediction(mean, variance=1.0):
    return Prediction(np.array(mean, dtype=float), variance * np.eye(len(mean)))


def test_the_log_likelihood_is_that_of_a_normal_distribution_but_for_a_constant():
    covariance = np.array([[2.0, 0.7], [0.7, 1.0]])
    one = Prediction(np.array([1.0, -1.0]), covariance)
    outcomes = np.array([[0.0, 0.0], [1.0, -1.0], [3.0, 2.0]])
    expected = multivariate_normal([1.0, -1.0], covariance).logpdf(outcomes)
    assert np.allclose(np.diff(one.log_likelihood(outcomes)), np.diff(expected))


def test_noise_that_gyros_share_rarely_settles_the_wrong_prediction_and_fits_the_right_one():
    """Two predictions that differ by the same in all gyros; correlations of 0.8 count 2.28 values as one."""
    right, wrong = (Prediction(np.full(18, mean), np.eye(18), 2.28) for mean in (0.0, 0.8))
    root = np.linalg.cholesky(np.full((3, 3), 0.8) + 0.2 * np.eye(3))
    noise = np.random.default_rng(0).standard_normal((4000, 6, 3)) @ root.T
    outcomes = noise.swapaxes(1, 2).reshape(4000, 18)
    odds = wrong.log_likelihood(outcomes) - right.log_likelihood(outcomes)
    assert np.mean(odds > np.log(99.0)) < 0.01
    assert np.mean(odds < -np.log(3.0)) > 0.5
    assert np.mean(chdtrc(right.dof, right.chi2(outcomes)) < 0.01) == pytest.approx(0.01, abs=0.01)


def test_equal_predictions_leave_the_entropy_as_it_is():
    probabilities = np.array([0.7, 0.3])
    assert expected_entropy_after([prediction([1.0, 2.0])] * 2, probabilities, 0.99).entropy == pytest.approx(
        entropy(probabilities)
    )


def test_predictions_far_apart_remove_all_doubt():
    apart = [prediction([0.0] * 3), prediction([30.0] * 3)]
    after = expected_entropy_after(apart, np.array([0.5, 0.5]), 0.99)
    assert after.entropy < 1e-6
    assert (after.unsettled, after.unsettled_entropy) == (0.0, 0.0)


def test_the_expected_entropy_is_that_of_numerical_integration():
    outcomes = np.linspace(-8.0, 10.0, 4001)
    densities = np.stack([np.exp(-0.5 * (outcomes - mean) ** 2) for mean in (0.0, 1.5)]) / np.sqrt(
        2.0 * np.pi
    )
    joint = densities * np.array([[0.5], [0.5]])
    posterior = joint / joint.sum(axis=0)
    pointwise = -np.sum(posterior * np.log(np.maximum(posterior, 1e-300)), axis=0)
    exact = np.trapezoid(joint.sum(axis=0) * pointwise, outcomes)
    drawn = [
        expected_entropy_after(
            [prediction([0.0]), prediction([1.5])], np.array([0.5, 0.5]), 0.99, seed
        ).entropy
        for seed in range(40)
    ]
    assert np.mean(drawn) == pytest.approx(exact, abs=3.0 * np.std(drawn) / np.sqrt(40) + 1e-3)


def test_the_declared_model_predicts_the_last_cycle_of_a_unit_without_effects():
    squares, count = 0.0, 0
    for seed in range(6):
        rows = simulate(
            {"unit": "S", "seed": seed, "effects": {}, "steps": first_campaign([45.0, 10.0, -20.0])}
        )
        campaign = campaign_of(rows)
        measured = campaign.cycle < campaign.cycle.max()
        found = linearize(campaign, measured, (), 1.0, 0.005).prediction(~measured)
        error = campaign.bias_dph[~measured].T.ravel() - found.mean_dph
        squares += float(error @ np.linalg.solve(found.covariance, error))
        count += len(error)
    assert squares / count == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / count))
