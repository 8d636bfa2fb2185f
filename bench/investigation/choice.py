"""Predictions of each hypothesis for a block, and the expected decrease of the entropy by the block.

A hypothesis fitted to the measured dwells predicts new ones with a normal distribution: its coefficients are
linearized about the fit. The utility of a block is the expected decrease of the entropy of the probabilities
per hour, estimated from outcomes drawn under each hypothesis (Lindley 1956; for rival models Box and Hill
1967).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gyrobench.bench.closure.campaign import Campaign
from gyrobench.bench.closure.candidates import Candidate
from gyrobench.bench.closure.effects.effect import Effect
from gyrobench.bench.closure.problem import DEGREE, declared_columns
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.foundations.text import plain_name

#: Number of outcomes drawn under each hypothesis.
_DRAWS = 96
#: Prior standard deviation of the size of a term, in standard deviations of the noise, and of a parameter, as
#: a share of its range; they only keep coefficients finite that the data do not determine.
_MAX_SIZE = 300.0
_PARAMETER_SHARE = 0.3
_STEP_SHARE = 0.02


@dataclass(frozen=True)
class Rival:
    """A hypothesis that may be true."""

    names: tuple[str, ...]  #: Its effects; empty for none.
    candidates: tuple[Candidate, ...]  #: As fitted.
    probability: float  #: Normalized to 1 over all rivals.
    #: Rms of an additional unlisted effect, deg/h; zero for none.
    remainder_dph: float = 0.0
    #: Its effects that were not fitted, since the dwells lack an input; the effects that they imitate were.
    unfitted: tuple[Effect, ...] = ()

    @property
    def labels(self) -> list[str]:
        """Labels of its effects."""
        effects = (*(each.effect for each in self.candidates), *self.unfitted)
        label_of = {each.name: each.display_name for each in effects}
        return [label_of.get(name, plain_name(name)) for name in self.names]

    @property
    def title(self) -> str:
        """Names of its effects: "warm_up + time_drift", "nothing", "... + not on the list"."""
        names = " + ".join(self.names) or "nothing"
        return f"{names} + not on the list" if self.remainder_dph else names


@dataclass(frozen=True, eq=False)
class Prediction:
    """Normal distribution of the biases of q / 3 new dwells, gyro by gyro."""

    mean_dph: FloatArray  #: Shape (q,).
    covariance: FloatArray  #: Shape (q, q), (deg/h)^2, including the noise of the dwells.
    #: :attr:`Problem.correlation_factor` of the noise, which the covariance does not include.
    correlation_factor: float = 1.0

    @cached_property
    def factor(self) -> FloatArray:
        """Lower triangular factor of the covariance (Cholesky), shape (q, q)."""
        return np.asarray(np.linalg.cholesky(self.covariance))

    @cached_property
    def _whitening(self) -> FloatArray:
        return np.asarray(np.linalg.inv(self.factor))

    def log_likelihood(self, outcomes_dph: FloatArray) -> FloatArray:
        """Logarithm of the density of outcomes (s, q), shape (s,); correlated values count as fewer."""
        log_determinant = 2.0 * np.sum(np.log(np.diag(self.factor))) / self.correlation_factor
        return np.asarray(-0.5 * (self.chi2(outcomes_dph) + log_determinant))

    def chi2(self, outcomes_dph: FloatArray) -> FloatArray:
        """chi2 of outcomes (s, q) with the predicted covariance, of :attr:`dof`, shape (s,)."""
        squares = (self._whitening @ (outcomes_dph - self.mean_dph).T) ** 2
        return np.asarray(np.sum(squares, axis=0) / self.correlation_factor)

    @property
    def dof(self) -> float:
        """Number of independent values."""
        return len(self.mean_dph) / self.correlation_factor

    def draw(self, normals: FloatArray) -> FloatArray:
        """Draw outcomes (s, q) with standard normal values (s, q)."""
        return np.asarray(self.mean_dph + normals @ self.factor.T)


@dataclass(frozen=True)
class LinearizedHypothesis:
    """A hypothesis linearized about its fit to the measured ones of n dwells; all arrays gyro by gyro."""

    design: FloatArray  #: Shape (3 n, p). Design matrix: derivatives of the biases by the coefficients.
    values: FloatArray  #: Shape (p,). Fitted coefficients.
    sigma_dph: FloatArray  #: Shape (3 n,). Noise of the dwells.
    precision: FloatArray  #: Shape (p,). Prior precision of the coefficients.
    measured: BoolArray  #: Shape (n,). Whether a dwell was used by the fit.
    fitted_covariance: FloatArray  #: Shape (p, p). Covariance of the fitted coefficients.

    def covariance(self, measured: BoolArray, target: BoolArray) -> FloatArray:
        """Covariance of the biases of m ``target`` dwells (n,), given that the dwells ``measured`` (n,) are.

        Shape (3 m, 3 m), (deg/h)^2, without the noise of the target dwells.
        """
        target_design = self.design[np.tile(target, 3)]
        covariance = self.fitted_covariance
        if not np.array_equal(measured, self.measured):
            rows = np.tile(measured, 3)
            covariance = _covariance(self.design[rows] / self.sigma_dph[rows, np.newaxis], self.precision)
        return np.asarray(target_design @ covariance @ target_design.T)

    def prediction(self, target: BoolArray) -> Prediction:
        """Predict the ``target`` dwells (n,) from those of the fit."""
        rows = np.tile(target, 3)
        noise = np.diag(self.sigma_dph[rows] ** 2)
        return Prediction(self.design[rows] @ self.values, self.covariance(self.measured, target) + noise)


def linearize(
    campaign: Campaign,
    measured: BoolArray,
    candidates: Sequence[Candidate],
    noise_scale: FloatArray | float,
    run_spread_dph: float,
) -> LinearizedHypothesis:
    """Linearize a hypothesis about its fit to the ``measured`` ones (n,) of the n dwells of a campaign.

    New dwells have forecast temperatures and expected uncertainties. ``candidates`` are the effects of the
    hypothesis, with their fitted parameters; ``noise_scale`` is the ratio of the noise to the stated
    uncertainties, ``run_spread_dph`` the standard deviation of the bias from one power-on to the next.
    """
    sigma_dph = campaign.sigma_dph * noise_scale
    linear_columns = [_linear_columns(campaign, candidates, gyro) for gyro in range(3)]
    widths = [each.shape[1] for each in linear_columns]
    count, starts = len(campaign), np.concatenate([[0], np.cumsum(widths)])
    parameters = [each for candidate in candidates for each in candidate.form.parameters]
    design = np.zeros((3 * count, starts[-1] + len(parameters)))
    precision = np.zeros(design.shape[1])
    for gyro, columns in enumerate(linear_columns):
        block = slice(starts[gyro], starts[gyro + 1])
        design[gyro * count : (gyro + 1) * count, block] = columns
        precision[block] = _prior_precision(campaign, columns, sigma_dph[:, gyro], run_spread_dph)
    data, sigma = campaign.bias_dph.T.ravel(), sigma_dph.T.ravel()
    rows = np.tile(measured, 3)
    sizes, covariance = _solve(design[rows], data[rows], sigma[rows], precision)
    if parameters:
        slopes, ranges = _parameter_slopes(campaign, candidates, sizes, starts)
        design[:, starts[-1] :] = slopes
        precision[starts[-1] :] = 1.0 / (_PARAMETER_SHARE * ranges) ** 2
        sizes, covariance = _solve(design[rows], data[rows], sigma[rows], precision)
    return LinearizedHypothesis(design, sizes, sigma, precision, measured, covariance)


@dataclass(frozen=True)
class ExpectedEntropy:
    """Expectation for the probabilities of hypotheses after a block."""

    entropy: float  #: Expected entropy, nats.
    unsettled: float  #: Probability that no hypothesis is settled.
    unsettled_entropy: float  #: Contribution to the entropy of the outcomes after which none is settled.


def expected_entropy_after(
    predictions: Sequence[Prediction], probabilities: FloatArray, settled: float, seed: int = 0
) -> ExpectedEntropy:
    """Expected entropy after a block of the probabilities (k,) of k hypotheses.

    ``predictions``: those of each hypothesis for the dwells of the block. ``settled``: probability from which
    on a hypothesis is settled. All blocks use the same normal values, so that the noise of the draws does not
    affect their comparison.
    """
    normals = np.random.default_rng(seed).standard_normal((_DRAWS, len(predictions[0].mean_dph)))
    expected = np.zeros(3)
    for true_prediction, probability in zip(predictions, probabilities, strict=True):
        outcomes = true_prediction.draw(normals)
        log_weights = np.stack([each.log_likelihood(outcomes) for each in predictions], axis=1) + np.log(
            probabilities
        )
        posterior = np.exp(log_weights - log_weights.max(axis=1, keepdims=True))
        posterior /= posterior.sum(axis=1, keepdims=True)
        entropies, is_open = entropy(posterior), posterior.max(axis=1) < settled
        expected += probability * np.mean([entropies, is_open, entropies * is_open], axis=1)
    return ExpectedEntropy(*expected.tolist())


def entropy(probabilities: FloatArray) -> FloatArray:
    """Entropy (...) of probabilities (..., k), nats."""
    logarithms = np.log(np.where(probabilities > 0.0, probabilities, 1.0))
    return np.asarray(-np.sum(probabilities * logarithms, axis=-1))


def _linear_columns(campaign: Campaign, candidates: Sequence[Candidate], gyro: int) -> FloatArray:
    """Columns (n, p): those of the declared model, the mean constant, and the terms that one gyro keeps."""
    declared = declared_columns(campaign, gyro)
    terms = [each.columns(campaign)[:, gyro, each.kept[gyro]] for each in candidates]
    return np.concatenate([declared, np.ones((len(campaign), 1)), *terms], axis=1)


def _prior_precision(
    campaign: Campaign, columns: FloatArray, sigma_dph: FloatArray, run_spread_dph: float
) -> FloatArray:
    """Prior precision of each coefficient of one gyro: constants scatter, sizes are finite."""
    runs = len(campaign.run_names)
    lengths = np.maximum(np.sqrt(np.mean((columns / sigma_dph[:, np.newaxis]) ** 2, axis=0)), 1e-12)
    precision = (lengths / _MAX_SIZE) ** 2
    precision[DEGREE : DEGREE + runs] = 1.0 / run_spread_dph**2
    return np.asarray(precision)


def _solve(
    design: FloatArray, data: FloatArray, sigma: FloatArray, precision: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Coefficients by least squares with a prior of mean zero, and their covariance."""
    weighted = design / sigma[:, np.newaxis]
    covariance = _covariance(weighted, precision)
    return np.asarray(covariance @ (weighted.T @ (data / sigma))), covariance


def _covariance(weighted: FloatArray, precision: FloatArray) -> FloatArray:
    """Covariance of coefficients, from columns (m, p) in units of the noise and their prior precision."""
    scales = 1.0 / np.sqrt(np.sum(weighted**2, axis=0) + precision + 1e-300)
    normal = scales[:, np.newaxis] * (weighted.T @ weighted + np.diag(precision)) * scales
    inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
    return np.asarray(scales[:, np.newaxis] * inverse * scales)


def _parameter_slopes(
    campaign: Campaign, candidates: Sequence[Candidate], sizes: FloatArray, starts: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Derivative of the bias by each nonlinear parameter (3 n, parameters), and the parameters' ranges."""
    slopes, ranges = [], []
    first = DEGREE + len(campaign.run_names) + 1
    offsets = [first] * 3
    for each in candidates:
        own_sizes = np.zeros(each.kept.shape)
        for gyro in range(3):
            kept = int(each.kept[gyro].sum())
            start = int(starts[gyro]) + offsets[gyro]
            own_sizes[gyro, each.kept[gyro]] = sizes[start : start + kept]
            offsets[gyro] += kept
        for index, parameter in enumerate(each.form.parameters):
            is_bounded = np.isfinite([parameter.low, parameter.high]).all()
            width = parameter.high - parameter.low if is_bounded else float(np.ptp(campaign.middle_s))
            step = _STEP_SHARE * (min(width, abs(each.values[index])) or width)
            end_points = []
            for sign in (-1.0, 1.0):
                value = each.values[index] + sign * step
                value = float(np.clip(value, parameter.low, parameter.high))
                values = each.with_value(index, value).values
                end_points.append(
                    (value, np.einsum("ngk,gk->gn", each.form.columns(campaign, values), own_sizes))
                )
            (low, low_bias), (high, high_bias) = end_points
            slopes.append(((high_bias - low_bias) / (high - low)).ravel())
            ranges.append(width)
    return np.stack(slopes, axis=1), np.array(ranges)
