import numpy as np
import pytest

from gyrobench.bench.bias.window_filter import COLUMN_COUNT, DATA, HEADING, INPUT, SLOPE, STATE, whiten
from gyrobench.bench.navigation.error_model import Site, integrate

VARIANCES = np.array([1e-3, 1e-3, 2e-6]) ** 2
WALKS = 3e-7, 5e-5
#: Rows of the state that are measured: velocity East and North, attitude about Up.
MEASURED = [3, 4, 2]


class Case:
    """Epochs at uneven times with measurements and inputs out of nowhere."""

    def __init__(self, epochs=40, seed=1):
        random = np.random.default_rng(seed)
        self.intervals = np.append(0.0, random.uniform(0.5, 20.0, epochs - 1))
        self.steps = integrate(Site(0.6), self.intervals, *WALKS)
        self.measured = random.standard_normal((epochs, 3)) * [0.1, 0.1, 1e-5]
        self.driven = random.standard_normal((epochs, 5, DATA - SLOPE))
        self.columns, self.covariance = np.zeros((6, COLUMN_COUNT)), np.zeros((6, 6))
        self.columns[:, :INPUT] = np.eye(6)

    def whiten(self, part=slice(None)):
        steps = self.steps
        rows, _, _ = whiten(
            self.columns, self.covariance, self.measured[part], VARIANCES, steps.transition[part],
            steps.response[part], steps.covariance[part], self.driven[part],
        )  # fmt: skip
        return rows

    def dense(self):
        """Responses (3 n, c) and covariance (3 n, 3 n) of all epochs at once, epoch by epoch."""
        count = len(self.measured)
        responses, covariance = np.zeros((count, 3, COLUMN_COUNT)), np.zeros((count, 3, count, 3))
        state, spread = self.columns.copy(), self.covariance.copy()
        for k in range(count):
            F, response = self.steps.transition[k], self.steps.response[k]
            state = F @ state
            state[:, INPUT:HEADING] += response
            state[:, SLOPE:DATA] += response @ self.driven[k]
            spread = F @ spread @ F.T + self.steps.covariance[k]
            responses[k] = state[MEASURED]
            responses[k, 2, HEADING], responses[k, :, DATA] = 1.0, self.measured[k]
            later = spread[:, MEASURED]
            covariance[k, :, k] = later[MEASURED]
            for j in range(k + 1, count):
                later = self.steps.transition[j] @ later
                covariance[j, :, k] = later[MEASURED]
                covariance[k, :, j] = later[MEASURED].T
        dense = covariance.reshape(3 * count, 3 * count)
        return responses.reshape(-1, COLUMN_COUNT), dense + np.diag(np.tile(VARIANCES, count))


def test_white_rows_are_generalised_least_squares():
    case = Case()
    responses, covariance = case.dense()
    rows = case.whiten().reshape(-1, COLUMN_COUNT)
    expected = responses.T @ np.linalg.solve(covariance, responses)
    scale = np.outer(*(np.sqrt(np.diag(expected)),) * 2)
    np.testing.assert_allclose(rows.T @ rows / scale, expected / scale, rtol=0, atol=1e-7)


def test_data_with_the_noise_of_the_model_become_white_with_unit_variance():
    case, random = Case(), np.random.default_rng(2)
    _, covariance = case.dense()
    root = np.linalg.cholesky(covariance)
    draws = []
    for _ in range(300):
        each = Case()
        each.measured = (root @ random.standard_normal(len(root))).reshape(-1, 3)
        draws.append(each.whiten()[:, :, DATA].ravel())
    correlations = np.array(draws).T @ np.array(draws) / len(draws)
    # Elements scatter by 0.06; the largest of 7260 is seldom beyond 4.5 of that.
    assert np.abs(correlations - np.eye(len(root))).max() < 0.35
    assert np.diag(correlations).mean() == pytest.approx(1.0, abs=0.03)
    assert abs(correlations[~np.eye(len(root), dtype=bool)].mean()) < 0.003


def test_rows_are_the_same_however_the_epochs_are_cut():
    whole, cut = Case(), Case()
    rows = whole.whiten()
    parts = [cut.whiten(slice(a, b)) for a, b in ((0, 1), (1, 1), (1, 17), (17, 40))]
    np.testing.assert_array_equal(np.concatenate(parts), rows)
    np.testing.assert_array_equal(cut.columns, whole.columns)
    np.testing.assert_array_equal(cut.covariance, whole.covariance)


def test_covariance_stays_symmetric_and_positive():
    case = Case(400)
    case.whiten()
    scale = np.outer(*(np.sqrt(np.diag(case.covariance + np.diag([0, 0, 0, 0, 0, 1e-20]))),) * 2)
    np.testing.assert_allclose(case.covariance / scale, case.covariance.T / scale, atol=1e-9)
    assert np.linalg.eigvalsh(case.covariance / scale).min() > -1e-9


def test_a_state_that_explains_the_data_leaves_nothing():
    case, truth = Case(), np.array([1e-5, -2e-5, 3e-4, 0.1, -0.2, 1e-6])
    responses, _ = case.dense()
    case.measured = -(responses[:, STATE:INPUT] @ truth).reshape(-1, 3)
    rows = case.whiten()
    explained = rows[:, :, STATE:INPUT] @ truth
    np.testing.assert_allclose(rows[:, :, DATA] + explained, 0.0, atol=1e-7)
