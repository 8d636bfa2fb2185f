"""Biases of many runs: levels and position differences by gyro and bin, and their drift over calendar time.

Runs are compared by the positions that they have in common, since means over different positions differ
even if no bias changed; and at one temperature, to which the curve of each gyro over all runs of its unit
reduces the biases: runs may have measured a bin at temperatures that differ by almost its width.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

import numpy as np
from scipy.stats import t as student

from gyrobench.bench.bias.position_differences import CubicBiasCurve, fit_curve
from gyrobench.bench.bias.statistics import excess_variance, holm, weighted_fit
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.text import bin_label
from gyrobench.bench.navigation.positions import POSITIONS, gyro_label, position_label
from gyrobench.bench.runs.index.run_index import RunIndex

#: Name of the mean over the positions.
LEVEL = "level"


@dataclass(frozen=True)
class RunBias:
    """One quantity in one run."""

    unit: str  #: Serial number of the INS.
    started_utc: datetime  #: Start of the run.
    #: bias_dph, sigma_dph: Value and standard uncertainty.
    bias_dph: float
    sigma_dph: float
    #: Errors due to the unit's curve, which is the same in all runs: three independent parts, with signs.
    by_curve_dph: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, order=True)
class BiasQuantity:
    """A quantity compared between runs."""

    gyro: str  #: "x", "y" or "z".
    #: bin_low_c, bin_high_c: Range of the gyro's temperature.
    bin_low_c: float
    bin_high_c: float
    name: str  #: :data:`LEVEL`, or the position whose bias minus the level it is.
    positions: tuple[str, ...]  #: Positions averaged in the level.

    def is_same_as(self, other: BiasQuantity) -> bool:
        """Whether it is the same quantity of another unit, with possibly other positions averaged."""
        return replace(self, positions=other.positions) == other

    @property
    def label(self) -> str:
        """Label: "X gyro at 20 to 40 °C", "X gyro at 20 to 40 °C, Z-Up minus the mean"."""
        level = f"{gyro_label(self.gyro)} at {bin_label(self.bin_low_c, self.bin_high_c)} °C"
        return level if self.name == LEVEL else f"{level}, {position_label(self.name)} minus the mean"


def read_run_biases(index: RunIndex, paths: Sequence[str]) -> dict[BiasQuantity, list[RunBias]]:
    """Read levels and position differences of some runs, each quantity in the order of time.

    Runs in which the INS compensated biases are left out: they measured residuals.
    """
    sql = (
        "SELECT path, unit, started_utc, gyro, bin_low_c, bin_high_c, position, temperature_c, bias_dph, "
        "sigma_dph FROM bins JOIN runs USING (path) WHERE isfinite(temperature_c) AND NOT compensated "
        "AND path IN (SELECT unnest(?)) ORDER BY started_utc, path"
    )
    return run_biases(index.query(sql, [list(paths)]).records())


def run_biases(rows: Iterable[Mapping[str, Any]]) -> dict[BiasQuantity, list[RunBias]]:
    """Compute levels and position differences from biases by run, gyro, bin and position.

    For each gyro and bin the positions common to most runs are used; runs that lack one are left out.
    """
    cells: dict[tuple[str, float, float], dict[str, dict[str, Mapping[str, Any]]]] = defaultdict(dict)
    by_unit: dict[tuple[str, str], list[Mapping[str, Any]]] = defaultdict(list)
    for row in rows:
        by_unit[row["unit"], row["gyro"]].append(row)
        rows_by_run = cells[row["gyro"], row["bin_low_c"], row["bin_high_c"]]
        rows_by_run.setdefault(row["path"], {})[row["position"]] = row
    curves = {key: _curve(of_unit) for key, of_unit in by_unit.items()}
    result: dict[BiasQuantity, list[RunBias]] = {}
    for (gyro, low_c, high_c), runs in sorted(cells.items()):
        positions = _common_positions(runs.values())
        complete_runs = [
            [run[each] for each in positions] for run in runs.values() if set(positions) <= run.keys()
        ]
        to_c = float(np.mean([row["temperature_c"] for run in complete_runs for row in run]))
        # With two positions, one difference is the negative of the other.
        names = [LEVEL, *(positions if len(positions) > 2 else positions[1:])]
        for name in names:
            weights = np.full(len(positions), 1.0 / len(positions))
            if name != LEVEL:
                weights = np.eye(len(positions))[positions.index(name)] - weights
            quantity = BiasQuantity(gyro, low_c, high_c, name, positions)
            result[quantity] = [
                _weighted_sum(run, weights, curves[run[0]["unit"], gyro], to_c) for run in complete_runs
            ]
    return result


def _columns(rows: Sequence[Mapping[str, Any]]) -> FloatArray:
    """Temperatures, biases and their uncertainties, shape (3, n)."""
    return np.array([[row[name] for row in rows] for name in ("temperature_c", "bias_dph", "sigma_dph")])


def _curve(rows: Sequence[Mapping[str, Any]]) -> CubicBiasCurve:
    """Curve of one gyro of a unit; each run has a constant."""
    temperature_c, bias_dph, sigma_dph = _columns(rows)
    runs, positions = [row["path"] for row in rows], [row["position"] for row in rows]
    return fit_curve(temperature_c, bias_dph, sigma_dph, runs, positions)


def _common_positions(runs: Iterable[Mapping[str, object]]) -> tuple[str, ...]:
    """Set of positions with the largest product of its size and the number of runs that have all of it."""
    sets = Counter(frozenset(run) for run in runs)

    def coverage(candidate: frozenset[str]) -> tuple[int, list[str]]:
        run_count = sum(count for each, count in sets.items() if candidate <= each)
        return run_count * len(candidate), sorted(candidate)

    common = max(sets, key=coverage)
    return tuple(position for position in POSITIONS if position in common)


def _weighted_sum(
    rows: Sequence[Mapping[str, Any]], weights: FloatArray, curve: CubicBiasCurve, to_c: float
) -> RunBias:
    """Weighted sum of the biases of one run at one temperature, which are taken as independent."""
    temperature_c, bias_dph, sigma_dph = _columns(rows)
    change = curve.responses(temperature_c) - curve.responses(np.array([to_c]))
    x, y, z = (weights @ change @ np.linalg.cholesky(curve.covariance)).tolist()
    return RunBias(
        rows[0]["unit"],
        rows[0]["started_utc"],
        float(weights @ (bias_dph - change @ curve.coefficients)),
        math.sqrt(float(weights**2 @ sigma_dph**2) + x**2 + y**2 + z**2),
        (x, y, z),
    )


#: Mean length of a month, days.
MONTH_DAYS = 365.2425 / 12.0
#: Smallest number of runs at different times for a slope with uncertainty.
_MIN_RUNS = 3
#: Family-wise false-alarm probability of all comparisons of a trend or a batch.
FALSE_ALARM = 0.01

_DAY_S = 86400.0


@dataclass(frozen=True)
class Trend:
    """Drift of one gyro's bias in one temperature bin."""

    quantity: BiasQuantity  #: The quantity.
    runs: Sequence[RunBias]  #: Its measurements in order of time.
    #: bias_dph, sigma_dph: Mean over the runs, and its standard uncertainty.
    bias_dph: float
    sigma_dph: float
    #: Standard deviation of the runs about the line in excess of their uncertainties (turn-on bias).
    between_runs_dph: float
    #: slope_dph_per_month, slope_sigma_dph_per_month: The drift; NaN with too few runs.
    slope_dph_per_month: float
    slope_sigma_dph_per_month: float
    p_value: float  #: Probability of a slope at least as steep if there is none; NaN with too few runs.
    p_adjusted: float  #: The same, corrected for all comparisons (Holm).

    @property
    def is_proven(self) -> bool:
        """Whether the slope is significant."""
        return self.p_adjusted < FALSE_ALARM


def trends(biases: Mapping[BiasQuantity, Sequence[RunBias]]) -> list[Trend]:
    """Fit a line to the level of each gyro and bin of one unit.

    The uncertainty of a slope includes the scatter of the runs about the line in excess of their
    uncertainties, and the error of the curve, which is the same in all runs; its p-value is that of
    Student's t.
    """
    levels = [(quantity, runs) for quantity, runs in biases.items() if quantity.name == LEVEL and runs]
    unadjusted = [_fit_trend(quantity, runs) for quantity, runs in levels]
    adjusted = holm([each.p_value for each in unadjusted])
    return [replace(each, p_adjusted=float(p)) for each, p in zip(unadjusted, adjusted, strict=True)]


def months_since_first(runs: Sequence[RunBias]) -> list[float]:
    """Time of each run after the first one, months."""
    return [(run.started_utc - runs[0].started_utc).total_seconds() / _DAY_S / MONTH_DAYS for run in runs]


def mixed_origins(runs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Warnings if the runs come from several benches or procedures, which can look like drift."""
    stations = sorted({run["station"] for run in runs})
    versions = {(run["procedure"], run["procedure_sha256"]) for run in runs}
    texts = []
    if len(stations) > 1:
        texts.append(f"the runs come from the benches {', '.join(stations)}; select one with --bench.")
    if len(versions) > 1:
        texts.append(f"the runs follow {len(versions)} procedures or versions; select one with --procedure.")
    return texts


def _fit_trend(quantity: BiasQuantity, runs: Sequence[RunBias]) -> Trend:
    """Level and slope of one quantity over the runs of a unit; ``p_adjusted`` is NaN."""
    values = np.array([run.bias_dph for run in runs])
    by_curve = np.array([run.by_curve_dph for run in runs])
    variances = np.array([run.sigma_dph for run in runs]) ** 2 - (by_curve**2).sum(axis=1)
    months = np.array(months_since_first(runs))
    constant = np.ones((len(runs), 1))
    slope = slope_sigma = p_value = math.nan
    design = constant
    if len(np.unique(months)) >= _MIN_RUNS:
        design = np.column_stack([constant, months - months.mean()])
    excess = excess_variance(values, variances, design)
    fit = weighted_fit(values, variances + excess, design)
    # Runs that agree better than their uncertainties do not reduce the uncertainty.
    scale = max(fit.chi2 / fit.dof, 1.0) if fit.dof else 1.0
    shared = fit.covariance @ (design.T / (variances + excess)) @ by_curve
    sigmas = np.sqrt(scale * np.diag(fit.covariance) + (shared**2).sum(axis=1))
    if design.shape[1] > 1:
        slope, slope_sigma = float(fit.values[1]), float(sigmas[1])
        p_value = float(2.0 * student.sf(abs(slope) / slope_sigma, fit.dof))
    return Trend(
        quantity, runs, float(fit.values[0]), float(sigmas[0]), math.sqrt(excess), slope, slope_sigma,
        p_value, math.nan,
    )  # fmt: skip
