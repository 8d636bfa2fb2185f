"""Turn-on to turn-on repeatability: variation of a gyro's bias from one power cycle to the next.

Each power cycle gives one bias with a known standard uncertainty. The repeatability is the scatter of the
biases beyond these uncertainties. Errors that all power cycles have in common do not add to the scatter, and
are not counted. The variance is estimated by restricted maximum likelihood. Its interval is exact for normal
biases: it contains the variances for which the weighted sum of squares is within its 95 % range of
chi-squared.

References
----------
Viechtbauer, "Confidence intervals for the amount of heterogeneity in meta-analysis", Statistics in
Medicine 26 (2007), section 3.1: Q profile.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from types import MappingProxyType

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.error_split import SplitError, SplitErrors, mean_error, scatter_variances
from gyrobench.bench.bias.plateaus import set_point_c
from gyrobench.bench.bias.statistics import excess_variance, weighted_fit
from gyrobench.bench.characteristics.results import Coefficient, Curve, TestResult, coefficient
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.navigation.positions import AXES

#: Fewest power cycles of a test of repeatability.
MIN_POWER_CYCLES = 7
#: Largest difference of the gyro temperatures of power cycles without a note, K.
MAX_TEMPERATURE_SPREAD_C = 1.0

_NONE_SPLIT: SplitErrors = MappingProxyType({})


def turn_on_repeatability(rows: Sequence[DwellRow], errors: SplitErrors = _NONE_SPLIT) -> TestResult:
    """Repeatability from dwells of several power cycles (``run``).

    The bias of a power cycle is the mean over positions and set points. Power cycles are used if they have
    dwells without flags in the same positions and set points as most others. ``errors``: of the dwells;
    dwells that it lacks have no common errors. Raises MeasurementError if fewer than two power cycles remain.
    """
    good = [row for row in rows if not row.flags]
    cells = {run: frozenset(_cell(row) for row in good if row.run == run) for run in _runs(good)}
    usual_cells = [each for each, _ in Counter(cells.values()).most_common(1)]
    complete = [run for run, cell_rows in cells.items() if cell_rows in usual_cells]
    left_out = len(_runs(rows)) - len(complete)
    if len(complete) < 2:
        raise MeasurementError(
            f"{counted(len(complete), 'power cycle')} of {left_out + len(complete)} with the same dwells "
            "without flags: a repeatability needs two or more"
        )
    notes = (
        [f"{counted(left_out, 'power cycle')} left out: not all dwells without flags."] if left_out else []
    )
    if len(complete) < MIN_POWER_CYCLES:
        notes.append(f"{len(complete)} power cycles: fewer than {MIN_POWER_CYCLES} leave wide intervals.")
    means = [_means([row for row in good if row.run == run], errors) for run in complete]
    biases, temperatures = (np.array([each[index] for each in means]) for index in (0, 1))
    sigmas = np.sqrt(scatter_variances([error for *_, error in means]))
    spread_c = float(np.ptp(temperatures, axis=0).max())
    if spread_c > MAX_TEMPERATURE_SPREAD_C:
        notes.append(
            f"The gyros' temperatures differ by {spread_c:.1f} K between power cycles, which adds to the "
            "scatter: let the unit cool down longer."
        )
    coefficients: list[Coefficient] = []
    curves = []
    cycles = np.arange(1.0, len(complete) + 1.0)
    for axis, gyro in enumerate(AXES):
        bias, sigma = biases[:, axis], sigmas[:, axis]
        ones = np.ones((len(bias), 1))
        variance = excess_variance(bias, sigma**2, ones)
        mean = weighted_fit(bias, sigma**2 + variance, ones).values[0]
        coefficients += _gyro_coefficients(gyro, bias, sigma, variance)
        curves.append(Curve.of(gyro, cycles, bias - mean, sigma, np.zeros(len(bias))))
    return TestResult(test="turn_on_repeatability", coefficients=coefficients, curves=curves, notes=notes)


def variance_interval(values: FloatArray, sigmas: FloatArray, design: FloatArray) -> tuple[float, float]:
    """95 % interval of the variance of values (n,) beyond their standard uncertainties (n,).

    ``design`` (n, k): columns of the fitted parameters, of full rank. If values happen to scatter less than
    their uncertainties, the upper limit is that for a scatter equal to the uncertainties: the limit must not
    be below the sensitivity of the measurement (power-constrained limit: Cowan et al., arXiv:1105.3166).
    """
    from scipy.optimize import brentq
    from scipy.stats import chi2

    dof = len(values) - design.shape[1]
    limits = [float(chi2.ppf(each, dof)) for each in (0.975, 0.025)]
    max_variance = float(np.var(values) + np.max(sigmas) ** 2) * len(values) / limits[1] * 10.0

    def end(limit: float) -> float:
        def above(variance: float) -> float:
            return weighted_fit(values, sigmas**2 + variance, design).chi2 - limit

        return (
            0.0
            if above(0.0) <= 0.0
            else float(brentq(above, 0.0, max_variance, xtol=1e-9 * max_variance, rtol=1e-6))
        )

    scatter = weighted_fit(values, sigmas**2, design).chi2
    return end(limits[0]), end(limits[1] * min(scatter / dof, 1.0))


def _gyro_coefficients(gyro: str, bias: FloatArray, sigma: FloatArray, value: float) -> list[Coefficient]:
    low, high = variance_interval(bias, sigma, np.ones((len(bias), 1)))
    return [
        coefficient(
            gyro, "turn-on standard deviation", "deg/h", math.sqrt(value), math.sqrt(low), math.sqrt(high)
        ),
        coefficient(gyro, "turn-on variance", "(deg/h)^2", value, low, high),
        coefficient(gyro, "largest difference", "deg/h", float(np.ptp(bias)), math.nan, math.nan),
    ]


def _runs(rows: Sequence[DwellRow]) -> list[str]:
    return list(dict.fromkeys(row.run for row in rows))


def _cell(row: DwellRow) -> tuple[str, float | None]:
    return row.position, set_point_c(row.chamber_set_c)


def _means(rows: Sequence[DwellRow], errors: SplitErrors) -> tuple[FloatArray, FloatArray, SplitError]:
    """Mean biases and temperatures (3,) over the cells of a power cycle, and the error of the biases."""
    cells: dict[tuple[str, float | None], list[DwellRow]] = {}
    for row in rows:
        cells.setdefault(_cell(row), []).append(row)
    ordered = [row for cell_rows in cells.values() for row in cell_rows]
    weights = []
    for cell_rows in cells.values():
        of_cell = np.array([row.sigma_dph for row in cell_rows]) ** -2.0
        weights.append(of_cell / of_cell.sum(axis=0) / len(cells))
    weight = np.vstack(weights)
    bias = (weight * np.array([row.bias_dph for row in ordered])).sum(axis=0)
    of_dwells = [errors.get(row.dwell) or SplitError.independent(row.sigma_dph) for row in ordered]
    temperature_c = np.mean(
        [np.mean([row.gyro_c for row in cell_rows], axis=0) for cell_rows in cells.values()], axis=0
    )
    return bias, temperature_c, mean_error(of_dwells, weight)
