"""Bias per gyro, position and temperature bin (``bias_bins.csv``), and the comparison of positions in a bin.

The bias of a gyro changes with each power-on. If the positions of a bin were measured in different power
cycles, as after a resume in the middle of a plateau, that change would look like a difference of positions.
Therefore each power cycle has a constant: positions are compared within power cycles, and between power
cycles only if positions measured in both connect them.

The positions of a bin are measured one after the other, while the gyros still change by a kelvin or more. A
bias that follows the temperature would therefore look like one that follows the position, or scatters: tests
reduce biases to one temperature by the curve of the gyro, and count its uncertainty.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.position_differences import CubicBiasCurve, fit_curve
from gyrobench.bench.bias.statistics import WeightedMean, chi2_p_value, indicator_columns, weighted_mean
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.csv_tables import CsvTable, RecordTable, one_of
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import AXES, POSITIONS

#: Usual width of a bin, K.
DEFAULT_WIDTH_C = 5.0
#: Smallest width, K; narrower bins would fill the memory with empty ones.
_MIN_WIDTH_C = 0.01
_MAX_ROUNDING = 1e-9


@dataclass(frozen=True)
class PowerCycleMean:
    """Mean bias of the dwells of one position, bin and power cycle, deg/h, and their mean temperature."""

    number: int  #: Of the power cycle in the table, from 1.
    temperature_c: float
    bias_dph: float
    sigma_dph: float
    #: paper_bias_dph, paper_sigma_dph: By the paper's method; NaN if it does not apply.
    paper_bias_dph: float = math.nan
    paper_sigma_dph: float = math.nan

    @property
    def by_paper(self) -> PowerCycleMean:
        """Mean with the bias by the paper's method in place of the state-space one."""
        return PowerCycleMean(self.number, self.temperature_c, self.paper_bias_dph, self.paper_sigma_dph)


@dataclass(frozen=True)
class BiasBin:
    """Bias of one gyro in one position and range of the gyro temperature."""

    gyro: str  #: "x", "y" or "z".
    position: str  #: Key of :data:`gyrobench.bench.navigation.positions.POSITIONS`.
    #: bin_low_c, bin_high_c: Range of the gyro's temperature; the upper end belongs to the next bin.
    bin_low_c: float
    bin_high_c: float
    #: temperature_c, bias_dph: Means weighted by 1/sigma^2; NaN in an empty bin, as are all others below
    #: except ``count``.
    temperature_c: float
    bias_dph: float
    sigma_dph: float  #: Standard uncertainty of the mean from those of the dwells.
    count: int  #: Number of dwells.
    #: Reduced chi-square of the dwells' biases at one temperature: near 1 if their uncertainties explain the
    #: spread; NaN for a single dwell.
    chi2_reduced: float
    spread_p_value: float  #: Probability of at least this spread if due only to these uncertainties.
    #: paper_bias_dph, paper_sigma_dph: The mean by the paper's method, over the dwells to which it applies;
    #: NaN if there are none.
    paper_bias_dph: float = math.nan
    paper_sigma_dph: float = math.nan
    #: Means by power cycle, if the dwells of the gyro at these temperatures are from several. Not in the
    #: file: :func:`with_power_cycles` adds them.
    by_power_cycle: tuple[PowerCycleMean, ...] = ()

    @property
    def is_empty(self) -> bool:
        """Whether no dwell fell into this bin."""
        return self.count == 0


_SIGMA = partial(CsvTable.uncertainty, may_be_empty=True)
#: ``bias_bins.csv``; the columns of the paper may be missing.
BIAS_BINS_TABLE = RecordTable(
    BiasBin,
    {
        "gyro": one_of(AXES),
        "position": one_of(POSITIONS),
        **dict.fromkeys(("bin_low_c", "bin_high_c"), CsvTable.number),
        "temperature_c": partial(CsvTable.temperature, may_be_empty=True),
        **dict.fromkeys(("sigma_dph", "paper_sigma_dph"), _SIGMA),
    },
    left_out=["by_power_cycle"],
)


def bin_biases(rows: Iterable[DwellRow], width_c: float = DEFAULT_WIDTH_C) -> list[BiasBin]:
    """Sort the dwells of one unit into temperature bins.

    Every position that was measured has all bins of the gyro from the lowest to the highest occupied one, so
    a missing measurement shows as an empty bin.

    ``rows``: dwells in any order; a gyro without result (NaN) in a dwell is left out. ``width_c``: width of a
    bin; bins begin at its multiples. Result: by gyro, position (in the order of the paper) and temperature.
    Raises MeasurementError if the width is too small, or the dwells are of several units.
    """
    rows = list(rows)
    if not (math.isfinite(width_c) and width_c >= _MIN_WIDTH_C):
        raise MeasurementError(
            f"temperature bins need a width of {_MIN_WIDTH_C:g} K or more; found {width_c:g} K"
        )
    units = sorted({row.unit for row in rows})
    if len(units) > 1:
        raise MeasurementError(
            f"the dwells are of several units ({', '.join(units)}); bin each unit by itself"
        )
    power_cycles = {run: number for number, run in enumerate(dict.fromkeys(row.run for row in rows), 1)}
    measured = {row.position for row in rows}
    positions = [name for name in POSITIONS if name in measured]
    result = []
    for axis in range(len(AXES)):
        members = _by_position_and_number(axis, rows, width_c)
        curve = curve_of_dwells(axis, [row for dwells in members.values() for row in dwells])
        numbers = [number for _, number in members]
        for position in positions:
            for number in range(min(numbers, default=0), max(numbers, default=-1) + 1):
                ends = (number * width_c, (number + 1) * width_c)
                dwells = members.get((position, number), [])
                runs = {row.run for name in positions for row in members.get((name, number), [])}
                by_cycle = _by_power_cycle(axis, dwells, power_cycles) if len(runs) > 1 else ()
                result.append(replace(_bin(axis, position, ends, dwells, curve), by_power_cycle=by_cycle))
    return result


def paper_bins(bins: Iterable[BiasBin]) -> list[BiasBin]:
    """Bins with the paper's bias instead of the state-space one; empty if there is none.

    The spread of the dwells applies to the other estimate, so it is left out.
    """
    return [
        replace(
            each,
            bias_dph=each.paper_bias_dph,
            sigma_dph=each.paper_sigma_dph,
            count=0 if math.isnan(each.paper_bias_dph) else each.count,
            chi2_reduced=math.nan,
            spread_p_value=math.nan,
            by_power_cycle=tuple(
                mean.by_paper for mean in each.by_power_cycle if not math.isnan(mean.paper_bias_dph)
            ),
        )
        for each in bins
    ]


def with_power_cycles(bins: Sequence[BiasBin], rows: Iterable[DwellRow]) -> list[BiasBin]:
    """Bins of one unit as read from a file, with means by power cycle added from dwells without flags.

    Raises MeasurementError as :func:`bin_biases`.
    """
    width_c = round(bins[0].bin_high_c - bins[0].bin_low_c, 9) if bins else DEFAULT_WIDTH_C

    def key(each: BiasBin) -> tuple[str, str, int]:
        return each.gyro, each.position, round(each.bin_low_c / width_c)

    by_key = {key(each): each for each in bin_biases([row for row in rows if not row.flags], width_c)}
    return [
        replace(each, by_power_cycle=by_key[key(each)].by_power_cycle if key(each) in by_key else ())
        for each in bins
    ]


def _by_position_and_number(
    axis: int, rows: Iterable[DwellRow], width_c: float
) -> dict[tuple[str, int], list[DwellRow]]:
    members: dict[tuple[str, int], list[DwellRow]] = defaultdict(list)
    for row in rows:
        if not math.isnan(row.gyro_c[axis] + row.bias_dph[axis] + row.sigma_dph[axis]):
            members[row.position, math.floor(row.gyro_c[axis] / width_c)].append(row)
    return members


def curve_of_dwells(axis: int, rows: Sequence[DwellRow]) -> CubicBiasCurve:
    """Curve of one gyro by dwells with results; see :func:`fit_curve`."""
    values = [(row.gyro_c[axis], row.bias_dph[axis], row.sigma_dph[axis]) for row in rows]
    gyro_c, bias_dph, sigma_dph = np.array(values).reshape(-1, 3).T
    runs, positions = [row.run for row in rows], [row.position for row in rows]
    return fit_curve(gyro_c, bias_dph, sigma_dph, runs, positions)


def _bin(
    axis: int, position: str, ends_c: tuple[float, float], rows: Sequence[DwellRow], curve: CubicBiasCurve
) -> BiasBin:
    if not rows:
        return BiasBin(AXES[axis], position, *ends_c, math.nan, math.nan, math.nan, 0, math.nan, math.nan)
    values = [(row.bias_dph[axis], row.sigma_dph[axis], row.gyro_c[axis]) for row in rows]
    bias_dph, sigma_dph, gyro_c = np.array(values).T
    bias = weighted_mean(bias_dph, sigma_dph)
    temperature_c = weighted_mean(gyro_c, sigma_dph).value
    spread = _reduced_mean(curve, bias_dph, sigma_dph, gyro_c, temperature_c)
    paper_bias_dph, paper_sigma_dph = _paper_mean(axis, rows)
    return BiasBin(
        AXES[axis],
        position,
        *ends_c,
        temperature_c=temperature_c,
        bias_dph=bias.value,
        sigma_dph=bias.sigma,
        count=len(rows),
        chi2_reduced=spread.chi2_reduced,
        spread_p_value=spread.p_value,
        paper_bias_dph=paper_bias_dph,
        paper_sigma_dph=paper_sigma_dph,
    )


def _by_power_cycle(
    axis: int, rows: Sequence[DwellRow], power_cycles: Mapping[str, int]
) -> tuple[PowerCycleMean, ...]:
    means = []
    for run in dict.fromkeys(row.run for row in rows):
        in_run = [row for row in rows if row.run == run]
        sigmas = [row.sigma_dph[axis] for row in in_run]
        mean = weighted_mean([row.bias_dph[axis] for row in in_run], sigmas)
        gyro_c = weighted_mean([row.gyro_c[axis] for row in in_run], sigmas).value
        means.append(
            PowerCycleMean(power_cycles[run], gyro_c, mean.value, mean.sigma, *_paper_mean(axis, in_run))
        )
    return tuple(means)


def _paper_mean(axis: int, rows: Sequence[DwellRow]) -> tuple[float, float]:
    """Mean and its standard uncertainty by the paper's method; NaN without."""
    pairs = [(row.paper_bias_dph[axis], row.paper_sigma_dph[axis]) for row in rows]
    valid = [pair for pair in pairs if not any(map(math.isnan, pair))]
    if not valid:
        return math.nan, math.nan
    values, sigmas = zip(*valid, strict=True)
    mean = weighted_mean(values, sigmas)
    return mean.value, mean.sigma


@dataclass(frozen=True)
class PositionComparison:
    """Comparison of the positions of one gyro in one temperature bin, or in two that share a plateau."""

    gyro: str  #: "x", "y" or "z".
    #: bin_low_c, bin_high_c: Range of the gyro's temperature, of both bins if there are two.
    bin_low_c: float
    bin_high_c: float
    #: Probability of differences at least as large if the positions were equal: the chi-square test of
    #: homogeneity with a degree of freedom for each position except one, and fewer if power cycles have no
    #: position in common.
    p_value: float
    largest_pair: tuple[str, str]  #: The two positions that differ most, the higher bias first.
    #: largest_difference_dph, largest_difference_sigma_dph: Their difference at one temperature and its
    #: standard uncertainty.
    largest_difference_dph: float
    largest_difference_sigma_dph: float
    temperature_spread_c: float  #: Largest difference of the positions' mean temperatures.


def compare_positions(bins: Iterable[BiasBin]) -> list[PositionComparison]:
    """Compare the positions of each gyro and bin; bins without two comparable positions are left out.

    Where the border of two bins divides the positions of a plateau, they are compared over both. If the
    dwells of a bin are from several power cycles, each power cycle has a constant.

    ``bins``: of one unit, in any order; :func:`gyrobench.bench.bias.bins.paper_bins` for the paper's method.
    Result: by gyro and temperature.
    """
    groups = [(group, _power_cycle_means(group)) for group in _groups(bins)]
    curves = {
        gyro: _curve_of_means([mean for group, means in groups if group[0].gyro == gyro for mean in means])
        for gyro in dict.fromkeys(group[0].gyro for group, _ in groups)
    }
    compared = (_compare(group, means, curves[group[0].gyro]) for group, means in groups)
    return [each for each in compared if each is not None]


def disconnected_bins(bins: Iterable[BiasBin]) -> list[BiasBin]:
    """One bin of each gyro and range in which some positions can't be compared with the others.

    There, power cycles have no position in common.
    """
    result = []
    for group in _groups(bins):
        of_positions, _, dof = _columns(_power_cycle_means(group))
        if dof < of_positions.shape[1] - 1:
            result.append(group[0])
    return result


def _groups(bins: Iterable[BiasBin]) -> list[list[BiasBin]]:
    """Bins of each gyro and range with two positions or more; of two ranges if these share a plateau."""
    by_range: dict[tuple[str, float], list[BiasBin]] = defaultdict(list)
    for each in bins:
        if not each.is_empty:
            by_range[each.gyro, each.bin_low_c].append(each)
    groups: list[list[BiasBin]] = []
    for _, group in sorted(by_range.items()):
        if groups and _share_plateau(groups[-1], group):
            groups[-1] += group
        else:
            groups.append(group)
    return [group for group in groups if len(group) > 1]


def _share_plateau(lower: Sequence[BiasBin], upper: Sequence[BiasBin]) -> bool:
    """Whether the border of two bins of a gyro divides the positions of a plateau.

    Their temperatures are then within the width of one bin, and no position is in both.
    """
    both = [*lower, *upper]
    return (
        lower[0].gyro == upper[0].gyro
        and len({each.position for each in both}) == len(both)
        and float(np.ptp([each.temperature_c for each in both])) <= upper[0].bin_high_c - upper[0].bin_low_c
    )


def _power_cycle_means(group: Iterable[BiasBin]) -> list[tuple[str, PowerCycleMean]]:
    """Means by position and power cycle, with uncertainties that include errors common to the dwells."""
    means = []
    for each in group:
        of_one = (PowerCycleMean(0, each.temperature_c, each.bias_dph, each.sigma_dph),)
        by_power_cycle = each.by_power_cycle or of_one
        weight = sum(mean.sigma_dph**-2.0 for mean in by_power_cycle)
        factor = max(1.0, each.sigma_dph * math.sqrt(weight))
        means += [
            (each.position, replace(mean, sigma_dph=factor * mean.sigma_dph)) for mean in by_power_cycle
        ]
    return means


def _curve_of_means(means: Sequence[tuple[str, PowerCycleMean]]) -> CubicBiasCurve:
    values = [(each.temperature_c, each.bias_dph, each.sigma_dph) for _, each in means]
    gyro_c, bias_dph, sigma_dph = np.array(values).T
    runs, positions = [each.number for _, each in means], [position for position, _ in means]
    return fit_curve(gyro_c, bias_dph, sigma_dph, runs, positions)


def _columns(means: Sequence[tuple[str, PowerCycleMean]]) -> tuple[FloatArray, FloatArray, int]:
    """Responses of means (n, g) to the biases of positions and to the constants of power cycles.

    Also returns the degrees of freedom of equal positions: one less than positions if all are connected.
    """
    of_positions = indicator_columns([position for position, _ in means])
    constants = indicator_columns([each.number for _, each in means])
    rank = int(np.linalg.matrix_rank(np.hstack([of_positions, constants])))
    return of_positions, constants, rank - constants.shape[1]


def _compare(
    group: Sequence[BiasBin], means: Sequence[tuple[str, PowerCycleMean]], curve: CubicBiasCurve
) -> PositionComparison | None:
    """Compare positions at one temperature by their means in each power cycle; None if none are connected."""
    of_positions, constants, dof = _columns(means)
    if not dof:
        return None
    values = [(each.bias_dph, each.sigma_dph, each.temperature_c) for _, each in means]
    bias_dph, sigma_dph, gyro_c = np.array(values).T
    reduced_dph, _, white = curve.reduce(bias_dph, sigma_dph, gyro_c, float(gyro_c.mean()))
    design = np.hstack([of_positions, constants])
    data, rows = white @ reduced_dph, white @ design

    def chi2(columns: FloatArray) -> float:
        return float(((data - columns @ np.linalg.lstsq(columns, data)[0]) ** 2).sum())

    covariance = np.linalg.pinv(rows.T @ rows)
    values_dph = covariance @ (rows.T @ data)
    projection = np.linalg.pinv(design) @ design  # onto the combinations that the data determine
    positions = list(dict.fromkeys(position for position, _ in means))
    pairs = np.array(list(permutations(range(len(positions)), 2)), dtype=int).reshape(-1, 2)
    contrasts = np.eye(design.shape[1])[pairs[:, 0]] - np.eye(design.shape[1])[pairs[:, 1]]
    is_determined = np.abs(contrasts @ projection.T - contrasts).max(axis=1, initial=0.0) <= _MAX_ROUNDING
    differences_dph = np.where(is_determined, contrasts @ values_dph, -math.inf)
    best = int(np.argmax(differences_dph))
    (high, low), largest = pairs[best].tolist(), contrasts[best]
    return PositionComparison(
        gyro=group[0].gyro,
        bin_low_c=group[0].bin_low_c,
        bin_high_c=group[-1].bin_high_c,
        p_value=chi2_p_value(dof, chi2(white @ constants) - chi2(rows)),
        largest_pair=(positions[high], positions[low]),
        largest_difference_dph=float(differences_dph.max()),
        largest_difference_sigma_dph=math.sqrt(largest @ covariance @ largest),
        temperature_spread_c=float(np.ptp([each.temperature_c for each in group])),
    )


def _reduced_mean(
    curve: CubicBiasCurve, bias_dph: FloatArray, sigma_dph: FloatArray, gyro_c: FloatArray, to_c: float
) -> WeightedMean:
    """Mean of biases (n,) reduced to one temperature."""
    reduced_dph, _, white = curve.reduce(bias_dph, sigma_dph, gyro_c, to_c)
    data, ones = white @ reduced_dph, white.sum(axis=1)
    information = float(ones @ ones)
    mean = float(ones @ data) / information
    return WeightedMean(mean, information**-0.5, float(((data - mean * ones) ** 2).sum()), len(data) - 1)
