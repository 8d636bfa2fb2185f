"""Statistics of the units of one batch: mean, spread between units and between runs, outliers.

Each quantity has a separate model. Quantities are the level of each gyro in each temperature bin, the
difference of each position from that level, and the size of each effect. The value of run r of unit u is

    m + b_u + c_ur + e_ur

with the batch's mean m, the deviation of the unit b_u and of the run c_ur, normal with variances estimated
from the data by restricted maximum likelihood (c from repeated runs of a unit, b from the means of the
units), and noise e_ur of known size.

Quantities belong to temperature bins, not to coefficients of the declared cubic: bins are measured, while
coefficients of a cubic are correlated and depend on the temperature range of the procedure.

Each unit is compared with a prediction from the other units, so an outlier does not widen the spread with
which it is judged. Few units give a poor estimate of a spread, so the gyros share one variance, and all
position differences share one, unless a likelihood-ratio test rejects a common variance. Two outliers in the
same direction still mask each other slightly.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from gyrobench.bench.bias.statistics import (
    ExcessSigma,
    excess_information,
    excess_sigma,
    excess_variance,
    holm,
    indicator_columns,
    restricted_deviance,
    weighted_fit,
)
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import plain_name
from gyrobench.bench.runs.index.run_biases import FALSE_ALARM, LEVEL, BiasQuantity, RunBias, read_run_biases
from gyrobench.bench.runs.index.run_index import RunIndex

#: Minimum number of units for an estimate of their spread.
_MIN_UNITS = 4
#: Significance of the test for a common variance of several quantities.
_COMMON_VARIANCE_P = 0.05


@dataclass(frozen=True, order=True)
class EffectSize:
    """Rms size of an effect, deg/h; zero in runs whose search did not find it."""

    effect: str

    @property
    def label(self) -> str:
        """Name for display."""
        return f"effect {plain_name(self.effect)}"


BatchQuantity = BiasQuantity | EffectSize


@dataclass(frozen=True)
class UnitStatistics:
    """Statistics of one unit in one quantity."""

    unit: str  #: Serial number.
    runs: int  #: Number of its runs.
    #: bias_dph, sigma_dph: Mean over its runs, and its standard uncertainty with the scatter between runs.
    bias_dph: float
    sigma_dph: float
    #: shrunken_dph, shrunken_sigma_dph: Estimate shrunk towards the batch's mean (best linear unbiased
    #: prediction).
    shrunken_dph: float
    shrunken_sigma_dph: float
    #: expected_dph, expected_sigma_dph: Prediction of its mean from the other units, and the standard
    #: deviation of the difference.
    expected_dph: float
    expected_sigma_dph: float
    p_value: float  #: Probability of a difference at least as large.
    p_adjusted: float = math.nan  #: The same, corrected for all units and quantities (Holm).

    @property
    def is_outlier(self) -> bool:
        """Whether it differs significantly from the other units."""
        return self.p_adjusted < FALSE_ALARM


@dataclass(frozen=True)
class QuantityStatistics:
    """Statistics of one quantity over the units of a batch."""

    quantity: BatchQuantity  #: The quantity.
    #: mean_dph, mean_sigma_dph: The batch's mean, and its standard uncertainty.
    mean_dph: float
    mean_sigma_dph: float
    between_units: ExcessSigma  #: Standard deviation between units without noise, with its 95 % interval.
    #: Standard deviation between runs of one unit; None if no unit has two runs: it is then part of the
    #: spread between units.
    between_runs_dph: float | None
    units: Sequence[UnitStatistics]  #: By serial number.


def fit_batch(values: Mapping[BatchQuantity, Sequence[RunBias]]) -> list[QuantityStatistics]:
    """Fit the model to each quantity measured on at least :data:`_MIN_UNITS` units, in the given order.

    Raises MeasurementError if there is no such quantity.
    """
    families: dict[object, list[_UnitMeans]] = defaultdict(list)
    for quantity, runs in values.items():
        if len({run.unit for run in runs}) >= _MIN_UNITS:
            families[_family(quantity)].append(_unit_means(quantity, runs))
    if not families:
        raise MeasurementError(
            f"no gyro was measured in the same bin and positions on at least {_MIN_UNITS} units. Select more "
            "runs"
        )
    order = list(values)
    fitted = sorted(
        (stats for family in families.values() for stats in _fit_family(family)),
        key=lambda stats: order.index(stats.quantity),
    )
    adjusted = iter(holm([unit.p_value for stats in fitted for unit in stats.units]))
    return [
        replace(stats, units=[replace(unit, p_adjusted=float(next(adjusted))) for unit in stats.units])
        for stats in fitted
    ]


def outliers(batch: Sequence[QuantityStatistics]) -> list[tuple[QuantityStatistics, UnitStatistics]]:
    """Outlying units with the quantity in which they differ, smallest p-value first."""
    pairs = [(stats, unit) for stats in batch for unit in stats.units if unit.is_outlier]
    return sorted(pairs, key=lambda pair: pair[1].p_value)


@dataclass(frozen=True, eq=False)
class _UnitMeans:
    """Mean and its variance (u,) of each unit in one quantity."""

    quantity: BatchQuantity
    names: list[str]
    runs: list[int]
    means: FloatArray
    variances: FloatArray
    between_runs: float | None

    def without(self, unit: str) -> tuple[FloatArray, FloatArray]:
        """Means and variances of the other units."""
        others = np.array([name != unit for name in self.names])
        return self.means[others], self.variances[others]


@dataclass(frozen=True)
class _Spread:
    """Variance between units, the variance of that estimate, and its degrees of freedom."""

    value: float
    variance: float
    dof: float


def _family(quantity: BatchQuantity) -> object:
    """Key of the quantities that may share a variance between units: those of all gyros in a bin."""
    if isinstance(quantity, EffectSize):
        return quantity
    return quantity.bin_low_c, quantity.name == LEVEL


def _unit_means(quantity: BatchQuantity, runs: Sequence[RunBias]) -> _UnitMeans:
    by_unit: dict[str, list[RunBias]] = defaultdict(list)
    for run in runs:
        by_unit[run.unit].append(run)
    names = sorted(by_unit)
    between_runs = _between_runs([by_unit[name] for name in names if len(by_unit[name]) > 1])
    fits = []
    for name in names:
        biases, variances = _arrays(by_unit[name])
        fits.append(weighted_fit(biases, variances + (between_runs or 0.0), np.ones((len(biases), 1))))
    return _UnitMeans(
        quantity,
        names,
        [len(by_unit[name]) for name in names],
        np.array([fit.values[0] for fit in fits]),
        np.array([fit.covariance[0, 0] for fit in fits]),
        between_runs,
    )


def _between_runs(repeated: Sequence[Sequence[RunBias]]) -> float | None:
    """Variance between the runs of a unit without noise, common to all units."""
    if not repeated:
        return None
    biases, variances = _arrays([run for runs in repeated for run in runs])
    design = indicator_columns([number for number, runs in enumerate(repeated) for _ in runs])
    return excess_variance(biases, variances, design)


def _fit_family(family: Sequence[_UnitMeans]) -> list[QuantityStatistics]:
    units = sorted({name for each in family for name in each.names})
    spreads = {unit: _spreads_without(unit, family) for unit in units}
    return [
        _quantity_statistics(each, {unit: spreads[unit][index] for unit in each.names})
        for index, each in enumerate(family)
    ]


def _quantity_statistics(unit_means: _UnitMeans, spreads: Mapping[str, _Spread]) -> QuantityStatistics:
    design = np.ones((len(unit_means.names), 1))
    between_units = excess_sigma(unit_means.means, unit_means.variances, design)
    spread = between_units.value**2
    fit = weighted_fit(unit_means.means, unit_means.variances + spread, design)
    mean, mean_variance = float(fit.values[0]), float(fit.covariance[0, 0])
    shrinkage = spread / (spread + unit_means.variances)
    shrunken_dph = mean + shrinkage * (unit_means.means - mean)
    shrunken_variance = shrinkage * unit_means.variances + (1.0 - shrinkage) ** 2 * mean_variance
    units = [
        UnitStatistics(
            name,
            unit_means.runs[index],
            float(unit_means.means[index]),
            math.sqrt(unit_means.variances[index]),
            float(shrunken_dph[index]),
            math.sqrt(shrunken_variance[index]),
            *_prediction(unit_means, index, spreads[name]),
        )
        for index, name in enumerate(unit_means.names)
    ]
    between_runs = None if unit_means.between_runs is None else math.sqrt(unit_means.between_runs)
    return QuantityStatistics(
        unit_means.quantity, mean, math.sqrt(mean_variance), between_units, between_runs, units
    )


def _spreads_without(unit: str, family: Sequence[_UnitMeans]) -> list[_Spread]:
    """Variance between the other units in each quantity of a family."""
    others = [each.without(unit) for each in family]
    ones = [np.ones((len(means), 1)) for means, _ in others]
    separate = [excess_variance(*other, one) for other, one in zip(others, ones, strict=True)]
    means = np.concatenate([means for means, _ in others])
    variances = np.concatenate([variances for _, variances in others])
    design = indicator_columns([number for number, one in enumerate(ones) for _ in one])
    common = excess_variance(means, variances, design)
    deviance = restricted_deviance(means, variances + common, design) - sum(
        restricted_deviance(means, variances + variance, one)
        for (means, variances), variance, one in zip(others, separate, ones, strict=True)
    )
    if chi2.sf(deviance, max(len(family) - 1, 1)) < _COMMON_VARIANCE_P:
        return [
            _Spread(variance, excess_information(variances + variance, one) ** -1.0, len(one) - 1)
            for (_, variances), variance, one in zip(others, separate, ones, strict=True)
        ]
    share = _independent_share(family[0].quantity)
    information = share * excess_information(variances + common, design)
    dof = share * (design.shape[0] - design.shape[1])
    return [_Spread(common, 1.0 / information, dof)] * len(family)


def _independent_share(quantity: BatchQuantity) -> float:
    """Share of independent quantities in a family: differences from a mean add up to zero."""
    if isinstance(quantity, EffectSize) or quantity.name == LEVEL or len(quantity.positions) < 3:
        return 1.0
    return 1.0 - 1.0 / len(quantity.positions)


def _prediction(unit_means: _UnitMeans, index: int, spread: _Spread) -> tuple[float, float, float]:
    """Prediction from the other units, standard deviation of the difference, and its p-value.

    Student's distribution with degrees of freedom by Satterthwaite.
    """
    means, variances = unit_means.without(unit_means.names[index])
    fit = weighted_fit(means, variances + spread.value, np.ones((len(means), 1)))
    expected = float(fit.values[0])
    variance = spread.value + float(unit_means.variances[index] + fit.covariance[0, 0])
    distance = abs(float(unit_means.means[index]) - expected) / math.sqrt(variance)
    dof = min(2.0 * variance**2 / spread.variance, spread.dof)
    return expected, math.sqrt(variance), float(2.0 * student.sf(distance, dof))


def _arrays(runs: Sequence[RunBias]) -> tuple[FloatArray, FloatArray]:
    return np.array([run.bias_dph for run in runs]), np.array([run.sigma_dph for run in runs]) ** 2


#: Verdicts of searches that are complete: an effect not found has size zero.
_COMPLETE = ("clean", "explained")


def read_batch(index: RunIndex, runs: Sequence[Mapping[str, Any]]) -> dict[BatchQuantity, Sequence[RunBias]]:
    """Read the quantities to compare between units of the selected runs: biases and sizes of effects."""
    biases = read_run_biases(index, [run["path"] for run in runs])
    by_bin = sorted(biases.items(), key=lambda pair: (pair[0].gyro, pair[0].bin_low_c))
    values: dict[BatchQuantity, Sequence[RunBias]] = dict(by_bin)
    values.update(_effect_sizes(index, runs).items())
    return values


def _effect_sizes(index: RunIndex, runs: Sequence[Mapping[str, Any]]) -> dict[EffectSize, list[RunBias]]:
    """Size of each effect found in any run, for all runs with a complete search.

    Its uncertainty is that of an rms over the dwells searched.
    """
    searched = [
        run
        for run in runs
        if run["verdict"] in _COMPLETE
        and run["noise_dph"]
        and run["dwells_searched"]
        and not run["compensated"]
    ]
    sql = "SELECT path, effect, rms_dph FROM effects WHERE path IN (SELECT unnest(?))"
    sizes = {
        (row["path"], row["effect"]): row["rms_dph"]
        for row in index.query(sql, [[run["path"] for run in searched]]).records()
    }
    return {
        EffectSize(effect): [
            RunBias(
                run["unit"],
                run["started_utc"],
                sizes.get((run["path"], effect), 0.0),
                run["noise_dph"] / math.sqrt(run["dwells_searched"]),
            )
            for run in searched
        ]
        for effect in sorted({effect for _, effect in sizes})
    }
