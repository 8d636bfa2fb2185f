"""Drift of one unit: a straight line through its runs over calendar time, for each gyro and temperature."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student

from gyrobench.bench.bias.statistics import excess_variance, holm, weighted_fit
from gyrobench.bench.runs.index_run_biases import LEVEL, Quantity, RunBias

#: Mean length of a month, days.
MONTH_DAYS = 365.2425 / 12.0
#: A line with uncertainty needs as many runs, at times of their own.
FEWEST_RUNS = 3
#: Chance of one false alarm or more that is accepted in all comparisons of a trend together.
FALSE_ALARM = 0.01

_DAY_S = 86400.0


@dataclass(frozen=True)
class Trend:
    """Drift of one gyro's bias in one temperature bin.

    Attributes
    ----------
    quantity : Quantity
        What drifts.
    runs : sequence of RunBias
        What it was measured in, in the order of time.
    bias_dph, sigma_dph : float
        Mean over the runs, and its standard uncertainty.
    between_runs_dph : float
        Scatter of the runs about the line beyond their uncertainties, as from one power-on to the next.
    slope_dph_per_month, slope_sigma_dph_per_month : float
        The drift; NaN with too few runs.
    p_value : float
        Probability of a slope at least as steep if there is none; NaN with too few runs.
    p_adjusted : float
        The same, allowing for all comparisons.
    """

    quantity: Quantity
    runs: Sequence[RunBias]
    bias_dph: float
    sigma_dph: float
    between_runs_dph: float
    slope_dph_per_month: float
    slope_sigma_dph_per_month: float
    p_value: float
    p_adjusted: float

    @property
    def is_proven(self) -> bool:
        """Whether chance does not explain the slope."""
        return self.p_adjusted < FALSE_ALARM


def trends(biases: Mapping[Quantity, Sequence[RunBias]]) -> list[Trend]:
    """Fit a line to the level of each gyro and bin of one unit.

    The uncertainty of a slope is from the scatter of the runs about the line, where that is larger than
    their own uncertainties say, with Student's distribution for as many runs as there are.
    """
    levels = [(quantity, runs) for quantity, runs in biases.items() if quantity.name == LEVEL and runs]
    fitted = [_fitted(quantity, runs) for quantity, runs in levels]
    adjusted = holm([each.p_value for each in fitted])
    return [Trend(**{**vars(each), "p_adjusted": float(p)}) for each, p in zip(fitted, adjusted, strict=True)]


def months_since_first(runs: Sequence[RunBias]) -> list[float]:
    """Time of each run after the first one, months."""
    return [(run.started_utc - runs[0].started_utc).total_seconds() / _DAY_S / MONTH_DAYS for run in runs]


def mixed_origins(runs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say where runs of one unit are of several benches or procedures, which can look like a drift."""
    stations = sorted({run["station"] for run in runs})
    versions = {(run["procedure"], run["procedure_sha256"]) for run in runs}
    texts = []
    if len(stations) > 1:
        texts.append(f"the runs are of the benches {', '.join(stations)}; --bench takes those of one.")
    if len(versions) > 1:
        texts.append(
            f"the runs are of {len(versions)} procedures or versions of one; --procedure takes those of one."
        )
    return texts


def _fitted(quantity: Quantity, runs: Sequence[RunBias]) -> Trend:
    values = np.array([run.bias_dph for run in runs])
    variances = np.array([run.sigma_dph for run in runs]) ** 2
    months = np.array(months_since_first(runs))
    constant = np.ones((len(runs), 1))
    slope = slope_sigma = p_value = math.nan
    design = constant
    if len(np.unique(months)) >= FEWEST_RUNS:
        design = np.column_stack([constant, months - months.mean()])
    between = excess_variance(values, variances, design)
    fit = weighted_fit(values, variances + between, design)
    # Where the runs agree by chance better than their uncertainties allow, these still count.
    scale = max(fit.chi2 / fit.freedom, 1.0) if fit.freedom else 1.0
    sigmas = np.sqrt(scale * np.diag(fit.covariance))
    if design.shape[1] > 1:
        slope, slope_sigma = float(fit.values[1]), float(sigmas[1])
        p_value = float(2.0 * student.sf(abs(slope) / slope_sigma, fit.freedom))
    return Trend(
        quantity, runs, float(fit.values[0]), float(sigmas[0]), math.sqrt(between), slope, slope_sigma,
        p_value, math.nan,
    )  # fmt: skip
