"""What each hypothesis predicts for a block, and by how much the block would lower the entropy.

A hypothesis fitted to the dwells measured predicts new ones with a Gaussian: its coefficients are linearized
about the fit. The utility of a block is the expected fall of the entropy of the probabilities per hour, by
outcomes drawn under each hypothesis (Lindley 1956; for rival models Box and Hill 1967).
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

#: Outcomes drawn under each hypothesis.
_DRAWS = 96
#: Prior standard deviation of the size of a term, in standard deviations of the noise, and of a parameter as
#: a share of its bounds; they only keep what the data do not determine finite.
_MAX_SIZE = 300.0
_PARAMETER_SHARE = 0.3
_STEP_SHARE = 0.02


@dataclass(frozen=True)
class Rival:
    """A hypothesis that may be the cause."""

    names: tuple[str, ...]  #: Its effects; empty for none.
    candidates: tuple[Candidate, ...]  #: As fitted.
    probability: float  #: Of all rivals together 1.
    #: Rms of an unlisted effect beside the effects, deg/h; zero for none.
    remainder_dph: float = 0.0
    #: Effects among them that were not fitted, since the dwells lack an input; what imitates them was.
    unfitted: tuple[Effect, ...] = ()

    @property
    def labels(self) -> list[str]:
        """Labels of its effects."""
        effects = (*(each.effect for each in self.candidates), *self.unfitted)
        known = {each.name: each.display_name for each in effects}
        return [known.get(name, plain_name(name)) for name in self.names]

    @property
    def title(self) -> str:
        """Its effects by name: "warm_up + time_drift", "nothing", "... + not on the list"."""
        names = " + ".join(self.names) or "nothing"
        return f"{names} + not on the list" if self.remainder_dph else names


@dataclass(frozen=True, eq=False)
class Prediction:
    """A Gaussian for the biases of q / 3 new dwells, gyro by gyro."""

    mean_dph: FloatArray  #: Shape (q,).
    covariance: FloatArray  #: Shape (q, q), (deg/h)^2, with the noise of the dwells.

    @cached_property
    def factor(self) -> FloatArray:
        """Lower triangular factor of the covariance (Cholesky), shape (q, q)."""
        return np.asarray(np.linalg.cholesky(self.covariance))

    @cached_property
    def _whitening(self) -> FloatArray:
        return np.asarray(np.linalg.inv(self.factor))

    def log_likelihood(self, outcomes_dph: FloatArray) -> FloatArray:
        """Logarithm of the density of outcomes (s, q), shape (s,)."""
        return np.asarray(-0.5 * self.chi2(outcomes_dph) - np.sum(np.log(np.diag(self.factor))))

    def chi2(self, outcomes_dph: FloatArray) -> FloatArray:
        """Sum of squares of outcomes (s, q) in units of their uncertainty, shape (s,)."""
        return np.asarray(np.sum((self._whitening @ (outcomes_dph - self.mean_dph).T) ** 2, axis=0))

    def draw(self, normals: FloatArray) -> FloatArray:
        """Outcomes (s, q) from standard normal values (s, q)."""
        return np.asarray(self.mean_dph + normals @ self.factor.T)


@dataclass(frozen=True)
class Linearized:
    """A hypothesis linearized about its fit to the measured of n dwells; all arrays gyro by gyro."""

    design: FloatArray  #: Shape (3 n, p). Slopes of the biases by its coefficients.
    values: FloatArray  #: Shape (p,). The coefficients fitted.
    sigma_dph: FloatArray  #: Shape (3 n,). Noise of the dwells.
    precision: FloatArray  #: Shape (p,). Prior precision of the coefficients.
    measured: BoolArray  #: Shape (n,). The dwells that it was fitted to.
    fitted: FloatArray  #: Shape (p, p). Covariance of the coefficients by these.

    def covariance(self, known: BoolArray, at: BoolArray) -> FloatArray:
        """Covariance of the biases of m dwells ``at`` (n,), when those ``known`` (n,) are measured.

        Shape (3 m, 3 m), (deg/h)^2, without the noise of these dwells.
        """
        mine, there = np.tile(known, 3), self.design[np.tile(at, 3)]
        covariance = self.fitted
        if not np.array_equal(known, self.measured):
            covariance = _inverse(self.design[mine] / self.sigma_dph[mine, np.newaxis], self.precision)
        return np.asarray(there @ covariance @ there.T)

    def prediction(self, measured: BoolArray, at: BoolArray) -> Prediction:
        """Predict the dwells ``at`` from those measured."""
        there = np.tile(at, 3)
        noise = np.diag(self.sigma_dph[there] ** 2)
        return Prediction(self.design[there] @ self.values, self.covariance(measured, at) + noise)


def linearized(
    campaign: Campaign,
    measured: BoolArray,
    candidates: Sequence[Candidate],
    noise_scale: float,
    run_spread_dph: float,
) -> Linearized:
    """Linearize a hypothesis about its fit to the dwells of a campaign that are measured.

    Parameters
    ----------
    campaign : Campaign
        n dwells, the new ones with forecast temperatures and expected uncertainties.
    measured : ndarray of bool, shape (n,)
        The dwells with a bias.
    candidates : sequence of Candidate
        The effects of the hypothesis, with their fitted parameters.
    noise_scale : float
        Ratio of the noise to the stated uncertainties.
    run_spread_dph : float
        Standard deviation of the bias from one power-on to the next.
    """
    sigma_dph = campaign.sigma_dph * noise_scale
    linear = [_linear_columns(campaign, candidates, gyro) for gyro in range(3)]
    widths = [each.shape[1] for each in linear]
    count, starts = len(campaign), np.concatenate([[0], np.cumsum(widths)])
    parameters = [each for one in candidates for each in one.form.parameters]
    design = np.zeros((3 * count, starts[-1] + len(parameters)))
    precision = np.zeros(design.shape[1])
    for gyro, columns in enumerate(linear):
        place = slice(starts[gyro], starts[gyro + 1])
        design[gyro * count : (gyro + 1) * count, place] = columns
        precision[place] = _prior_precision(campaign, columns, sigma_dph[:, gyro], run_spread_dph)
    data, sigma = campaign.bias_dph.T.ravel(), sigma_dph.T.ravel()
    known = np.tile(measured, 3)
    sizes, fitted = _solved(design[known], data[known], sigma[known], precision)
    if parameters:
        slopes, widths_of = _parameter_slopes(campaign, candidates, sizes, starts)
        design[:, starts[-1] :] = slopes
        precision[starts[-1] :] = 1.0 / (_PARAMETER_SHARE * widths_of) ** 2
        sizes, fitted = _solved(design[known], data[known], sigma[known], precision)
    return Linearized(design, sizes, sigma, precision, measured, fitted)


@dataclass(frozen=True)
class Expected:
    """What is expected of the probabilities of hypotheses after a block was measured."""

    entropy: float  #: Nats.
    unsettled: float  #: Probability that no hypothesis is settled.
    unsettled_entropy: float  #: Part of the entropy from outcomes after which none is.


def expected_after(
    predictions: Sequence[Prediction], probabilities: FloatArray, settled: float, seed: int = 0
) -> Expected:
    """Expected entropy of the probabilities (k,) of k hypotheses, one of which is settled from a value on.

    ``predictions``: of each hypothesis for the same dwells. The normal values are the same for each block, so
    that blocks are compared without the noise of the draws.
    """
    normals = np.random.default_rng(seed).standard_normal((_DRAWS, len(predictions[0].mean_dph)))
    expected = np.zeros(3)
    for truth, probability in zip(predictions, probabilities, strict=True):
        outcomes = truth.draw(normals)
        logs = np.stack([each.log_likelihood(outcomes) for each in predictions], axis=1) + np.log(
            probabilities
        )
        posterior = np.exp(logs - logs.max(axis=1, keepdims=True))
        posterior /= posterior.sum(axis=1, keepdims=True)
        entropies, is_open = entropy(posterior), posterior.max(axis=1) < settled
        expected += probability * np.mean([entropies, is_open, entropies * is_open], axis=1)
    return Expected(*expected.tolist())


def entropy(probabilities: FloatArray) -> FloatArray:
    """Entropy of probabilities (..., k), nats, shape (...)."""
    logarithms = np.log(np.where(probabilities > 0.0, probabilities, 1.0))
    return np.asarray(-np.sum(probabilities * logarithms, axis=-1))


def _linear_columns(campaign: Campaign, candidates: Sequence[Candidate], gyro: int) -> FloatArray:
    """Declared columns, the mean constant, and the terms kept by one gyro, (n, p)."""
    declared = declared_columns(campaign, gyro)
    terms = [each.columns(campaign)[:, gyro, each.kept[gyro]] for each in candidates]
    return np.concatenate([declared, np.ones((len(campaign), 1)), *terms], axis=1)


def _prior_precision(
    campaign: Campaign, columns: FloatArray, sigma_dph: FloatArray, run_spread_dph: float
) -> FloatArray:
    """Prior precision of each coefficient of one gyro: runs scatter about their mean, sizes are finite."""
    runs = len(campaign.run_names)
    lengths = np.maximum(np.sqrt(np.mean((columns / sigma_dph[:, np.newaxis]) ** 2, axis=0)), 1e-12)
    precision = (lengths / _MAX_SIZE) ** 2
    precision[DEGREE : DEGREE + runs] = 1.0 / run_spread_dph**2
    return np.asarray(precision)


def _solved(
    design: FloatArray, data: FloatArray, sigma: FloatArray, precision: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Coefficients by least squares with a prior of mean zero, and their covariance."""
    weighted = design / sigma[:, np.newaxis]
    covariance = _inverse(weighted, precision)
    return np.asarray(covariance @ (weighted.T @ (data / sigma))), covariance


def _inverse(weighted: FloatArray, precision: FloatArray) -> FloatArray:
    """Covariance of coefficients by their columns (m, p) in units of the noise, and their prior precision."""
    scales = 1.0 / np.sqrt(np.sum(weighted**2, axis=0) + precision + 1e-300)
    normal = scales[:, np.newaxis] * (weighted.T @ weighted + np.diag(precision)) * scales
    inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
    return np.asarray(scales[:, np.newaxis] * inverse * scales)


def _parameter_slopes(
    campaign: Campaign, candidates: Sequence[Candidate], sizes: FloatArray, starts: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Slope of the bias (3 n, parameters) by each parameter, and the parameters' ranges."""
    slopes, ranges = [], []
    first = DEGREE + len(campaign.run_names) + 1
    offsets = [first] * 3
    for each in candidates:
        mine = np.zeros(each.kept.shape)
        for gyro in range(3):
            kept = int(each.kept[gyro].sum())
            at = int(starts[gyro]) + offsets[gyro]
            mine[gyro, each.kept[gyro]] = sizes[at : at + kept]
            offsets[gyro] += kept
        for index, parameter in enumerate(each.form.parameters):
            bounded = np.isfinite([parameter.low, parameter.high]).all()
            width = parameter.high - parameter.low if bounded else float(np.ptp(campaign.middle_s))
            step = _STEP_SHARE * (min(width, abs(each.values[index])) or width)
            sides = []
            for sign in (-1.0, 1.0):
                value = each.values[index] + sign * step
                value = float(np.clip(value, parameter.low, parameter.high))
                values = (*each.values[:index], value, *each.values[index + 1 :])
                sides.append((value, np.einsum("ngk,gk->gn", each.form.columns(campaign, values), mine)))
            (low, before), (high, after) = sides
            slopes.append(((after - before) / (high - low)).ravel())
            ranges.append(width)
    return np.stack(slopes, axis=1), np.array(ranges)
