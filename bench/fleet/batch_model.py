"""Units of one batch: what they share, how far they spread, and which of them stands out.

Each quantity is modelled by itself: the level of each gyro in each temperature bin, the difference of
each position from that, and the size of each effect. The value of run r of unit u is

    m + b_u + c_ur + e_ur

with the batch's mean m, the unit's own part b_u and the run's c_ur, normal with variances that the data
tell, and noise e_ur of known size. The runs of one unit tell the variance of c, the means of the units that
of b, each by restricted maximum likelihood.

Quantities are those of temperature bins, not the coefficients of the declared cubic: bins are measured,
while coefficients of a cubic lean on each other and on the range of temperatures that a procedure has.

A unit is compared with what the others lead to expect: without it the model is fitted again, so that it
cannot widen the spread that it is judged by. A handful of units tells a spread badly, so the others of all
gyros tell one together, and those of all differences of positions, where they don't contradict a common
one. Two units that are out in the same way still hide each other a little.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2
from scipy.stats import t as student

from gyrobench.bench.bias.statistics import (
    ExcessSigma,
    excess_information,
    excess_sigma,
    excess_variance,
    holm,
    restricted_deviance,
    weighted_fit,
)
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import plain_name
from gyrobench.bench.runs.index_run_biases import LEVEL, Quantity, RunBias

#: With fewer units there is no spread to speak of.
FEWEST_UNITS = 4
#: Chance of one false alarm or more that is accepted in all comparisons of a batch together.
FALSE_ALARM = 0.01
#: Below this probability units of several quantities don't spread alike.
_CONTRADICTS = 0.05


@dataclass(frozen=True, order=True)
class EffectSize:
    """Rms size of an effect that searches found, in deg/h; zero where a search told that it is not there."""

    effect: str

    @property
    def label(self) -> str:
        """Say what it is."""
        return f"effect {plain_name(self.effect)}"


Trait = Quantity | EffectSize


@dataclass(frozen=True)
class UnitInBatch:
    """One unit in one quantity.

    Attributes
    ----------
    unit : str
        Serial number.
    runs : int
        Number of its runs.
    bias_dph, sigma_dph : float
        Mean over its runs, and its standard uncertainty with the scatter between runs.
    shrunken_dph, shrunken_sigma_dph : float
        Its value as all units tell it: nearer to the batch's mean the less its own runs tell.
    expected_dph, expected_sigma_dph : float
        What the other units lead to expect of its mean, and how far it may be from that.
    p_value : float
        Probability of being at least as far from it.
    p_adjusted : float
        The same, allowing for all units and quantities.
    """

    unit: str
    runs: int
    bias_dph: float
    sigma_dph: float
    shrunken_dph: float
    shrunken_sigma_dph: float
    expected_dph: float
    expected_sigma_dph: float
    p_value: float
    p_adjusted: float = math.nan

    @property
    def stands_out(self) -> bool:
        """Whether chance does not explain how far it is from the others."""
        return self.p_adjusted < FALSE_ALARM


@dataclass(frozen=True)
class TraitInBatch:
    """One quantity over the units of a batch.

    Attributes
    ----------
    trait : Quantity or EffectSize
        What it is.
    mean_dph, mean_sigma_dph : float
        The batch's mean, and its standard uncertainty.
    between_units : ExcessSigma
        Standard deviation of the units about it, noise taken off, with its 95 % interval.
    between_runs_dph : float or None
        That of the runs of one unit; None where no unit has two, and it is in the above.
    units : sequence of UnitInBatch
        By serial number.
    """

    trait: Trait
    mean_dph: float
    mean_sigma_dph: float
    between_units: ExcessSigma
    between_runs_dph: float | None
    units: Sequence[UnitInBatch]


def fit_batch(values: Mapping[Trait, Sequence[RunBias]]) -> list[TraitInBatch]:
    """Fit the model to each quantity that enough units have.

    Raises
    ------
    MeasurementError
        There is none.
    """
    families: dict[object, list[_UnitMeans]] = defaultdict(list)
    for trait, runs in values.items():
        if len({run.unit for run in runs}) >= FEWEST_UNITS:
            families[_family(trait)].append(_unit_means(trait, runs))
    if not families:
        raise MeasurementError(
            f"no gyro was measured in the same bin and positions on {FEWEST_UNITS} units or more, so there "
            "is no batch to compare with"
        )
    fitted = [trait for family in families.values() for trait in _fitted(family)]
    adjusted = iter(holm([unit.p_value for trait in fitted for unit in trait.units]))
    return [
        replace(trait, units=[replace(unit, p_adjusted=float(next(adjusted))) for unit in trait.units])
        for trait in fitted
    ]


def standing_out(batch: Sequence[TraitInBatch]) -> list[tuple[TraitInBatch, UnitInBatch]]:
    """Units that stand out, each with in what; the clearest first."""
    found = [(trait, unit) for trait in batch for unit in trait.units if unit.stands_out]
    return sorted(found, key=lambda pair: pair[1].p_value)


@dataclass(frozen=True, eq=False)
class _UnitMeans:
    """One quantity: mean and its variance (u,) of each unit."""

    trait: Trait
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
    """Variance between units, the variance of that estimate, and how many values made it."""

    value: float
    variance: float
    freedom: float


def _family(trait: Trait) -> object:
    """Quantities whose units may spread alike: those of all gyros in one bin."""
    if isinstance(trait, EffectSize):
        return trait
    return trait.bin_low_c, trait.name == LEVEL


def _unit_means(trait: Trait, runs: Sequence[RunBias]) -> _UnitMeans:
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
        trait,
        names,
        [len(by_unit[name]) for name in names],
        np.array([fit.values[0] for fit in fits]),
        np.array([fit.covariance[0, 0] for fit in fits]),
        between_runs,
    )


def _between_runs(repeated: Sequence[Sequence[RunBias]]) -> float | None:
    """Variance between the runs of a unit, beyond their noise; the same for all units."""
    if not repeated:
        return None
    biases, variances = _arrays([run for runs in repeated for run in runs])
    return excess_variance(biases, variances, _blocks([len(runs) for runs in repeated]))


def _fitted(family: Sequence[_UnitMeans]) -> list[TraitInBatch]:
    units = sorted({name for each in family for name in each.names})
    spreads = {unit: _spreads_without(unit, family) for unit in units}
    return [
        _trait(each, {unit: spreads[unit][number] for unit in each.names})
        for number, each in enumerate(family)
    ]


def _trait(each: _UnitMeans, spreads: Mapping[str, _Spread]) -> TraitInBatch:
    one = np.ones((len(each.names), 1))
    between_units = excess_sigma(each.means, each.variances, one)
    spread = between_units.value**2
    fit = weighted_fit(each.means, each.variances + spread, one)
    mean, mean_variance = float(fit.values[0]), float(fit.covariance[0, 0])
    shares = spread / (spread + each.variances)
    shrunken_dph = mean + shares * (each.means - mean)
    shrunken_variance = shares * each.variances + (1.0 - shares) ** 2 * mean_variance
    units = []
    for number, name in enumerate(each.names):
        units.append(
            UnitInBatch(
                name,
                each.runs[number],
                float(each.means[number]),
                math.sqrt(each.variances[number]),
                float(shrunken_dph[number]),
                math.sqrt(shrunken_variance[number]),
                *_compared(each, number, spreads[name]),
            )
        )
    between_runs = None if each.between_runs is None else math.sqrt(each.between_runs)
    return TraitInBatch(each.trait, mean, math.sqrt(mean_variance), between_units, between_runs, units)


def _spreads_without(unit: str, family: Sequence[_UnitMeans]) -> list[_Spread]:
    """Variance between the other units in each quantity of a family."""
    others = [each.without(unit) for each in family]
    ones = [np.ones((len(means), 1)) for means, _ in others]
    each_alone = [excess_variance(*other, one) for other, one in zip(others, ones, strict=True)]
    means = np.concatenate([means for means, _ in others])
    variances = np.concatenate([variances for _, variances in others])
    design = _blocks([len(one) for one in ones])
    together = excess_variance(means, variances, design)
    worse = restricted_deviance(means, variances + together, design) - sum(
        restricted_deviance(means, variances + alone, one)
        for (means, variances), alone, one in zip(others, each_alone, ones, strict=True)
    )
    if chi2.sf(worse, max(len(family) - 1, 1)) < _CONTRADICTS:
        return [
            _Spread(alone, excess_information(variances + alone, one) ** -1.0, len(one) - 1)
            for (_, variances), alone, one in zip(others, each_alone, ones, strict=True)
        ]
    share = _independent(family[0].trait)
    information = share * excess_information(variances + together, design)
    freedom = share * (design.shape[0] - design.shape[1])
    return [_Spread(together, 1.0 / information, freedom)] * len(family)


def _independent(trait: Trait) -> float:
    """Share of a family's quantities that the rest does not tell: differences from a mean add up to zero."""
    if isinstance(trait, EffectSize) or trait.name == LEVEL or len(trait.positions) < 3:
        return 1.0
    return 1.0 - 1.0 / len(trait.positions)


def _compared(each: _UnitMeans, number: int, spread: _Spread) -> tuple[float, float, float]:
    """What the other units lead to expect of a unit, how far it may be from that, and p of its distance.

    The less is known of the spread, the fewer degrees of freedom has the distribution of the distance
    (Satterthwaite).
    """
    means, variances = each.without(each.names[number])
    fit = weighted_fit(means, variances + spread.value, np.ones((len(means), 1)))
    expected = float(fit.values[0])
    variance = spread.value + float(each.variances[number] + fit.covariance[0, 0])
    distance = abs(float(each.means[number]) - expected) / math.sqrt(variance)
    freedom = min(2.0 * variance**2 / spread.variance, spread.freedom)
    return expected, math.sqrt(variance), float(2.0 * student.sf(distance, freedom))


def _blocks(sizes: Sequence[int]) -> FloatArray:
    """Design with one column of ones for each group of values."""
    of_group = np.repeat(np.arange(len(sizes)), sizes)
    return np.asarray(of_group[:, np.newaxis] == np.arange(len(sizes)), dtype=np.float64)


def _arrays(runs: Sequence[RunBias]) -> tuple[FloatArray, FloatArray]:
    return np.array([run.bias_dph for run in runs]), np.array([run.sigma_dph for run in runs]) ** 2
