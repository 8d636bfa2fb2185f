"""Date at which a bias leaves its limit, by a random-effects model of the drift of a unit and its siblings.

In run i of unit j, t months after its first run, the bias is y = a_j + b_j t + w_j(t) + r_ij + e_ij: a bias
of the unit, a drift that is normal about the mean of all units, a random walk, a scatter between runs
(turn-on), and the error of the measurement with its stated uncertainty. a_j and the mean drift have flat
priors; the standard deviations of drift, walk and scatter are integrated over a grid by their restricted
likelihood.

Source: Laird and Ware, Random-effects models for longitudinal data, Biometrics 38 (1982); for the restricted
likelihood Harville, JASA 72 (1977).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import product

import numpy as np
from scipy.stats import norm

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.runs.index.run_biases import MONTH_DAYS, RunBias, Trend, read_run_biases
from gyrobench.bench.runs.index.run_index import RunIndex, find_runs
from gyrobench.bench.runs.index.selection import Selection

#: Probability that the bias of a run on the due date is within the limit.
_CONFIDENCE = 0.95
#: Latest due date, in months after the last run.
MAX_MONTHS = 120.0
#: Runs of all units together beyond one for each unit; with fewer, the scatter is unknown.
_MIN_RUNS_BEYOND_FIRST = 2
#: Standard deviations of drift, walk and scatter on the grid, relative to that of the data.
_GRID_FACTORS = (0.0, *np.geomspace(0.02, 4.0, 9))
_SEARCH_STEPS = 60


@dataclass(frozen=True)
class Recalibration:
    """Due date of the recalibration of a bias: the last day on which it is within its limit."""

    limit_dph: float
    confidence: float
    #: Last day on which the bias is within the limit with the probability ``confidence``; None if that is
    #: more than :data:`MAX_MONTHS` after the last run.
    due: datetime | None
    months: float  #: From the last run to the due date; 0 if the bias is outside on the day of the last run.
    #: drift_dph_per_month, drift_sigma_dph_per_month: Of the unit, estimated with its siblings.
    drift_dph_per_month: float
    drift_sigma_dph_per_month: float
    siblings: int  #: Number of other units with at least two runs.


@dataclass(frozen=True)
class _Unit:
    """Runs of a unit: times since the first run, biases and their variances, each of shape (n,)."""

    months: FloatArray
    bias_dph: FloatArray
    variance: FloatArray

    @classmethod
    def of(cls, runs: Sequence[RunBias]) -> _Unit:
        start = runs[0].started_utc
        months = [(run.started_utc - start) / timedelta(days=MONTH_DAYS) for run in runs]
        return cls(
            np.array(months), np.array([r.bias_dph for r in runs]), np.array([r.sigma_dph**2 for r in runs])
        )

    def inverse_covariance(self, sigmas: FloatArray) -> FloatArray:
        """Inverse covariance of the runs for a given bias of the unit and mean drift.

        ``sigmas``, shape (g, 3), gives shape (g, n, n).
        """
        t, drift, walk, scatter = self.months, *(sigmas**2).T[:, :, None, None]
        covariance = drift * np.outer(t, t) + walk * np.minimum.outer(t, t) + scatter * np.eye(len(t))
        return np.asarray(np.linalg.inv(covariance + np.diag(self.variance)), dtype=float)


def recalibration(runs: Mapping[str, Sequence[RunBias]], unit: str, limit_dph: float) -> Recalibration:
    """Due date for the bias of a unit to stay within a limit of either sign.

    ``runs``: the same quantity in the runs of each unit, in order of time: the unit and its siblings;
    ``limit_dph``: largest bias of either sign in a run. Raises MeasurementError if the unit has no run, or
    all units together have too few to estimate the scatter between runs.
    """
    units = {name: _Unit.of(each) for name, each in runs.items() if each}
    if unit not in units:
        raise MeasurementError(f"unit {unit}: no run measured this bias. Give a unit that has runs")
    repeat_count = sum(len(each.months) - 1 for each in units.values())
    if repeat_count < _MIN_RUNS_BEYOND_FIRST:
        raise MeasurementError(
            f"unit {unit}: {repeat_count + len(units)} runs of {len(units)} units do not show how its bias "
            f"changes. At least {_MIN_RUNS_BEYOND_FIRST} runs beyond the first of each unit are necessary"
        )
    sigmas, prior = _grid(list(units.values()))
    log_likelihood, mean_drift = _restricted_likelihood(list(units.values()), sigmas)
    weight = prior * np.exp(log_likelihood - log_likelihood.max())
    weight /= weight.sum()
    unit_runs = units[unit]
    predict = _Prediction(unit_runs, sigmas, mean_drift - _eliminate_bias(unit_runs, sigmas)[0], weight)
    last = unit_runs.months[-1]

    def is_within(months: float) -> bool:
        return predict.probability_within(last + months, limit_dph) >= _CONFIDENCE

    ends = np.linspace(0.0, MAX_MONTHS, _SEARCH_STEPS + 1)
    first_outside = next((index for index, end in enumerate(ends) if not is_within(end)), None)
    months = MAX_MONTHS
    if first_outside is not None:
        low, high = (float(ends[max(first_outside - 1, 0)]), float(ends[first_outside]))
        for _ in range(20):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if is_within(middle) else (low, middle)
        months = low
    due = runs[unit][-1].started_utc + timedelta(days=MONTH_DAYS * months)
    drift, drift_sigma = predict.drift()
    return Recalibration(
        limit_dph,
        _CONFIDENCE,
        None if first_outside is None else due,
        months,
        drift,
        drift_sigma,
        sum(len(each.months) > 1 for name, each in units.items() if name != unit),
    )


def recalibrations(
    index: RunIndex, selection: Selection, trends: Sequence[Trend], limit_dph: float
) -> list[Recalibration | None]:
    """Recalibration for the bias of each trend, with the drift of the unit's siblings.

    ``selection`` is that of the unit's runs. None for a trend with too few runs.
    """
    all_runs = find_runs(index, replace(selection, unit=None))
    biases = read_run_biases(index, [run["path"] for run in all_runs])
    results: list[Recalibration | None] = []
    for trend in trends:
        by_unit: dict[str, list[RunBias]] = {trend.runs[0].unit: list(trend.runs)}
        same_quantity = [runs for quantity, runs in biases.items() if quantity.is_same_as(trend.quantity)]
        for run in (run for runs in same_quantity for run in runs if run.unit != trend.runs[0].unit):
            by_unit.setdefault(run.unit, []).append(run)
        try:
            results.append(recalibration(by_unit, trend.runs[0].unit, limit_dph))
        except MeasurementError:  # too few runs
            results.append(None)
    return results


def _grid(units: Sequence[_Unit]) -> tuple[FloatArray, FloatArray]:
    """Standard deviations of drift, walk and scatter, shape (g, 3), and the prior weight of each, uniform."""
    deviations = np.concatenate([unit.bias_dph - unit.bias_dph.mean() for unit in units])
    scale = max(float(deviations.std()), float(np.sqrt(np.mean(np.concatenate([u.variance for u in units])))))
    span = max(float(unit.months[-1]) for unit in units) or 1.0
    factors = np.array(_GRID_FACTORS)
    widths = np.gradient(factors)
    grid = np.array(list(product(factors, repeat=3))) * [scale / span, scale / np.sqrt(span), scale]
    return grid, np.prod(np.array(list(product(widths, repeat=3))), axis=1)


def _restricted_likelihood(units: Sequence[_Unit], sigmas: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Restricted log-likelihood at each grid point, shape (g,), and information on the mean drift, (g, 2).

    The information of all units consists of the inverse variance, and its product with the estimate.
    """
    total = np.zeros((len(sigmas), 2))
    log_likelihood = np.zeros(len(sigmas))
    for unit in units:
        information, quadratic, log_determinant = _eliminate_bias(unit, sigmas)
        total += information
        log_likelihood -= 0.5 * (quadratic + log_determinant)
    is_determined = total[:, 0] > 0.0
    inverse_variance, weighted_drift = total[is_determined].T
    log_likelihood[is_determined] += 0.5 * (weighted_drift**2 / inverse_variance - np.log(inverse_variance))
    return log_likelihood, total


def _eliminate_bias(unit: _Unit, sigmas: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Information on the mean drift, quadratic form and log determinant, with the unit's bias eliminated."""
    inverse = unit.inverse_covariance(sigmas)
    ones, t, y = np.ones_like(unit.months), unit.months, unit.bias_dph
    a = inverse.sum(axis=(1, 2))
    at, ay = inverse @ t @ ones, inverse @ y @ ones
    information = np.column_stack([inverse @ t @ t - at**2 / a, inverse @ y @ t - at * ay / a])
    quadratic = inverse @ y @ y - ay**2 / a
    return information, quadratic, np.log(a) - np.linalg.slogdet(inverse)[1]


class _Prediction:
    """Prediction of the bias of a unit in a later run, averaged over the grid points with their weights."""

    def __init__(
        self, unit: _Unit, sigmas: FloatArray, drift_of_others: FloatArray, weight: FloatArray
    ) -> None:
        is_relevant = weight > weight.max() * 1e-6
        self._unit, self._sigmas = unit, sigmas[is_relevant]
        self._weight = weight[is_relevant] / weight[is_relevant].sum()
        inverse = unit.inverse_covariance(self._sigmas)
        design = np.column_stack([np.ones_like(unit.months), unit.months])
        matrix = design.T @ inverse @ design
        matrix[:, 1, 1] += np.maximum(drift_of_others[is_relevant, 0], 0.0)
        right_side = (design.T @ (inverse @ unit.bias_dph)[..., None])[..., 0]
        right_side[:, 1] += drift_of_others[is_relevant, 1]
        self._inverse, self._design = inverse, design
        self._covariance = np.linalg.pinv(matrix, hermitian=True)
        self._estimate = np.einsum("gij,gj->gi", self._covariance, right_side)
        fitted = self._estimate @ design.T
        self._weighted_residuals = np.einsum("gij,gj->gi", inverse, unit.bias_dph - fitted)

    def probability_within(self, months: float, limit_dph: float) -> float:
        """Probability that the bias is within the limit in a run ``months`` after the unit's first run."""
        drift, walk, scatter = (self._sigmas**2).T
        cross_covariance = self._cross_covariance(months)
        mean, variance = self._predict(np.array([1.0, months]), cross_covariance)
        variance = variance + drift * months**2 + walk * months + scatter
        sigma = np.sqrt(np.maximum(variance, 1e-300))
        probability = norm.cdf((limit_dph - mean) / sigma) - norm.cdf((-limit_dph - mean) / sigma)
        return float(self._weight @ probability)

    def drift(self) -> tuple[float, float]:
        """Drift of the unit, and its standard uncertainty."""
        cross_covariance = (self._sigmas[:, 0] ** 2)[:, None] * self._unit.months
        mean, variance = self._predict(np.array([0.0, 1.0]), cross_covariance)
        variance = variance + self._sigmas[:, 0] ** 2
        overall = float(self._weight @ mean)
        return overall, float(np.sqrt(self._weight @ (variance + (mean - overall) ** 2)))

    def _cross_covariance(self, months: float) -> FloatArray:
        """Covariance of a later run with the measured runs, shape (g, n)."""
        t = self._unit.months
        drift, walk, _ = (self._sigmas**2).T[:, :, None]
        return np.asarray(drift * months * t + walk * np.minimum(t, months), dtype=float)

    def _predict(self, row: FloatArray, cross_covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and variance (g,) by universal kriging, without the prior variance of the predicted value."""
        gain = np.einsum("gij,gj->gi", self._inverse, cross_covariance)
        unexplained = row - gain @ self._design
        mean = self._estimate @ row + np.einsum("gi,gi->g", cross_covariance, self._weighted_residuals)
        variance = np.einsum("gi,gij,gj->g", unexplained, self._covariance, unexplained) - np.einsum(
            "gi,gi->g", gain, cross_covariance
        )
        return mean, variance
