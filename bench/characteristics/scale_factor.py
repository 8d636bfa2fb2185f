"""Scale-factor stability: how gyro scale factors by whole turns change over hours and power cycles.

    ``S_i = constant + d t_i + e_i``

of measurements i at one temperature, each with a known standard uncertainty. The scatter e is what they
differ beyond it. Several power cycles have a constant each, and the scatter of these is the turn-on
repeatability of the scale factor. Variances are those of restricted maximum likelihood with exact intervals
for normal values, as of :mod:`gyrobench.bench.characteristics.turn_on`. The uncertainty of the drift follows
the residuals, with a t distribution (Knapp and Hartung).

Asymmetry and nonlinearity (one rate less the mean of all rates) are means over all measurements. The worst
are the largest magnitudes, their intervals those in which all magnitudes are at once (Bonferroni).

References
----------
Knapp and Hartung, "Improved tests for a random effects meta-regression with a single covariate", Statistics
in Medicine 22 (2003).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.statistics import excess_variance, weighted_fit, weighted_mean
from gyrobench.bench.calibration.spins import SpinScaleFactor
from gyrobench.bench.characteristics.profile_fit import indicators
from gyrobench.bench.characteristics.results import Coefficient, Curve, TestResult, coefficient
from gyrobench.bench.characteristics.turn_on import MAX_TEMPERATURE_SPREAD_C, variance_interval
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.navigation.positions import AXES

#: Fewest measurements of a test of stability, and fewest that give a result.
MIN_MEASUREMENTS, _MIN_FOR_RESULT = 8, 4
#: Rates that differ by less than this part are one.
_SAME_RATE = 0.02
_LEVEL = 0.95


@dataclass(frozen=True)
class SpinRecord:
    """Scale factors by the whole turns of one dwell."""

    run: str  #: Power cycle.
    at_s: float  #: Middle of the dwell on the run's clock.
    gyro_c: tuple[float, float, float]  #: Mean temperature of each gyro, degC.
    gyros: tuple[SpinScaleFactor, ...]  #: Of the gyros that were spun; none where there is a ``finding``.
    finding: str = ""  #: Why the dwell gives nothing.


def scale_factor_stability(records: Sequence[SpinRecord]) -> TestResult:
    """Stability from the dwells with whole turns of a run, each of which is one measurement.

    Raises MeasurementError if no gyro has four measurements or more.
    """
    coefficients: list[Coefficient] = []
    curves, notes = [], []
    left_out = [each.finding for each in records if each.finding]
    if left_out:
        notes.append(f"{counted(len(left_out), 'measurement')} left out: {left_out[0]}.")
    for axis, gyro in enumerate(AXES):
        pairs = [(each, spun) for each in records for spun in each.gyros if spun.axis == gyro]
        if not pairs:
            continue
        if len(pairs) < _MIN_FOR_RESULT:
            notes.append(f"{gyro.upper()} gyro: {counted(len(pairs), 'measurement')}, which are too few.")
            continue
        spread_c = float(np.ptp([each.gyro_c[axis] for each, _ in pairs]))
        if spread_c > MAX_TEMPERATURE_SPREAD_C:
            notes.append(
                f"{gyro.upper()} gyro: its temperature differs by {spread_c:.1f} K between measurements, "
                "which adds to drift and scatter. Let the unit settle for longer."
            )
        own, curve = _over_time(gyro, *zip(*pairs, strict=True))
        coefficients += own + _over_rates(gyro, [spun for _, spun in pairs])
        curves.append(curve)
    if not curves:
        raise MeasurementError(
            f"no gyro has {_MIN_FOR_RESULT} measurements by whole turns: a stability needs as many"
            + (f". The first of {len(left_out)} left out: {left_out[0]}" if left_out else "")
        )
    return TestResult(test="scale_factor_stability", coefficients=coefficients, curves=curves, notes=notes)


def _over_time(
    gyro: str, records: Sequence[SpinRecord], spun: Sequence[SpinScaleFactor]
) -> tuple[list[Coefficient], Curve]:
    from scipy.stats import t

    value = np.array([each.scale_factor_ppm for each in spun])
    sigma = np.array([each.sigma_ppm for each in spun])
    hours = (np.array([each.at_s for each in records]) - records[0].at_s) / 3600.0
    groups = indicators([each.run for each in records])
    if len(value) < groups.shape[1] + _MIN_FOR_RESULT - 1:  # hardly more than one in each power cycle
        groups = np.ones((len(value), 1))
    # Times from the middle of each power cycle: the constants and the drift are then independent.
    elapsed = hours - groups @ (groups.T @ (hours / sigma**2) / (groups.T @ sigma**-2.0))
    design = np.column_stack([groups, elapsed])
    variance = excess_variance(value, sigma**2, design)
    fit = weighted_fit(value, sigma**2 + variance, design)
    covariance = fit.covariance * fit.chi2 / fit.dof
    quantile = float(t.ppf(0.5 + 0.5 * _LEVEL, fit.dof))
    share = np.append(groups.mean(axis=0), 0.0)
    found = [
        _with_sigma(gyro, name, unit, float(weights @ fit.values), quantile * _root(weights, covariance))
        for name, unit, weights in (
            ("mean scale factor", "ppm", share),
            ("scale factor drift", "ppm/h", np.eye(len(share))[-1]),
        )
    ]
    scatters = [("scale factor", variance, variance_interval(value, sigma, design))]
    if groups.shape[1] > 1:
        constants, sigmas = fit.values[:-1], np.sqrt(np.diag(fit.covariance)[:-1])
        ones = np.ones((len(constants), 1))
        between = excess_variance(constants, sigmas**2, ones)
        scatters.append(("turn-on", between, variance_interval(constants, sigmas, ones)))
    for name, size, (low, high) in scatters:
        roots = (math.sqrt(each) for each in (size, low, high))
        found.append(coefficient(gyro, f"{name} standard deviation", "ppm", *roots))
        found.append(coefficient(gyro, f"{name} variance", "ppm^2", size, low, high))
    mean = float(share @ fit.values)
    return found, Curve.of(
        gyro, hours, value - mean, sigma, design @ fit.values - mean, [each.run for each in records]
    )


def _over_rates(gyro: str, spun: Sequence[SpinScaleFactor]) -> list[Coefficient]:
    """Worst asymmetry and nonlinearity, where measured."""
    from scipy.stats import norm, t

    rates: list[float] = []
    for each in (row.rate_dps for one in spun for row in one.rates):
        if not any(_is_same(each, rate) for rate in rates):
            rates.append(each)
    found = []
    both = [
        [(row.asymmetry_ppm, row.asymmetry_sigma_ppm) for row in rows if row.asymmetry_ppm is not None]
        for rows in (
            [row for one in spun for row in one.rates if _is_same(row.rate_dps, rate)] for rate in rates
        )
    ]
    means = [weighted_mean(*zip(*pairs, strict=True)) for pairs in both if pairs]
    if means:
        scales = [math.sqrt(max(1.0, each.chi2_reduced)) if each.dof else 1.0 for each in means]
        quantile = float(norm.ppf(_one_of(len(means))))
        reach = quantile * np.array([each.sigma for each in means]) * scales
        found.append(_worst(gyro, "worst asymmetry", np.array([each.value for each in means]), reach))
    whole = [sorted(one.rates, key=lambda row: row.rate_dps) for one in spun if len(one.rates) == len(rates)]
    if len(rates) > 1 and len(whole) > 1:
        # All rates count alike: less the mean that their uncertainties weight.
        away = np.array([[row.deviation_ppm for row in rows] for rows in whole])
        away -= away.mean(axis=1, keepdims=True)
        quantile = float(t.ppf(_one_of(len(rates)), len(whole) - 1))
        reach = quantile * away.std(axis=0, ddof=1) / math.sqrt(len(whole))
        found.append(_worst(gyro, "worst nonlinearity", away.mean(axis=0), reach))
    return found


def _is_same(rate_dps: float, other_dps: float) -> bool:
    return abs(rate_dps / other_dps - 1.0) < _SAME_RATE


def _one_of(count: int) -> float:
    """Level of a quantile at which ``count`` intervals hold at once."""
    return 1.0 - 0.5 * (1.0 - _LEVEL) / count


def _worst(gyro: str, name: str, values: FloatArray, reach: FloatArray) -> Coefficient:
    size = np.abs(values)
    low, high = max(0.0, float((size - reach).max())), float((size + reach).max())
    return coefficient(gyro, name, "ppm", float(size.max()), low, high)


def _with_sigma(gyro: str, name: str, unit: str, value: float, reach: float) -> Coefficient:
    return coefficient(gyro, name, unit, value, value - reach, value + reach)


def _root(weights: FloatArray, covariance: FloatArray) -> float:
    return math.sqrt(float(weights @ covariance @ weights))
