"""Scale-factor stability: change of gyro scale factors from whole turns over hours and power cycles.

    ``S_i = constant + d t_i + e_i``

for measurements i at one temperature, each with a known standard uncertainty. The scatter e is the variation
beyond it. Each power cycle has a constant, and the scatter of the constants is the turn-on repeatability of
the scale factor. Variances are estimated by restricted maximum likelihood, with exact intervals for normal
values, as in :mod:`gyrobench.bench.characteristics.turn_on`. The uncertainty of the drift is estimated from
the residuals, with a t distribution (Knapp and Hartung).

Asymmetry and nonlinearity (scale factor at one rate minus the mean of all rates) are means over all
measurements. The worst values are the largest magnitudes, with joint intervals for all magnitudes
(Bonferroni).

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

from gyrobench.bench.bias.statistics import excess_variance, indicator_columns, weighted_fit, weighted_mean
from gyrobench.bench.calibration.spins import SpinScaleFactor
from gyrobench.bench.characteristics.results import Coefficient, Curve, TestResult, coefficient
from gyrobench.bench.characteristics.turn_on import MAX_TEMPERATURE_SPREAD_C, variance_interval
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.navigation.positions import AXES

#: Fewest measurements of a test of stability, and fewest that give a result.
MIN_MEASUREMENTS, _MIN_FOR_RESULT = 8, 4
#: Largest relative difference of rates that count as equal.
_RATE_TOLERANCE = 0.02
_CONFIDENCE = 0.95


@dataclass(frozen=True)
class SpinRecord:
    """Scale factors from the whole turns of one dwell."""

    run: str  #: Power cycle.
    at_s: float  #: Middle of the dwell on the run's clock.
    gyro_c: tuple[float, float, float]  #: Mean temperature of each gyro, degC.
    gyros: tuple[SpinScaleFactor, ...]  #: Of the gyros that were spun; empty if there is a ``finding``.
    finding: str = ""  #: Reason why the dwell gives no result.


def scale_factor_stability(records: Sequence[SpinRecord]) -> TestResult:
    """Stability of the scale factors from the dwells with whole turns of a run, each one measurement.

    Raises MeasurementError if no gyro has at least four measurements.
    """
    coefficients: list[Coefficient] = []
    curves, notes = [], []
    findings = [each.finding for each in records if each.finding]
    if findings:
        notes.append(f"{counted(len(findings), 'measurement')} left out: {findings[0]}.")
    for axis, gyro in enumerate(AXES):
        pairs = [
            (each, scale_factor)
            for each in records
            for scale_factor in each.gyros
            if scale_factor.axis == gyro
        ]
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
        over_time, curve = _over_time(gyro, *zip(*pairs, strict=True))
        coefficients += over_time + _over_rates(gyro, [scale_factor for _, scale_factor in pairs])
        curves.append(curve)
    if not curves:
        raise MeasurementError(
            f"no gyro has {_MIN_FOR_RESULT} measurements by whole turns: a stability needs as many"
            + (f". The first of {len(findings)} left out: {findings[0]}" if findings else "")
        )
    return TestResult(test="scale_factor_stability", coefficients=coefficients, curves=curves, notes=notes)


def _over_time(
    gyro: str, records: Sequence[SpinRecord], scale_factors: Sequence[SpinScaleFactor]
) -> tuple[list[Coefficient], Curve]:
    from scipy.stats import t

    value = np.array([each.scale_factor_ppm for each in scale_factors])
    sigma = np.array([each.sigma_ppm for each in scale_factors])
    hours = (np.array([each.at_s for each in records]) - records[0].at_s) / 3600.0
    groups = indicator_columns([each.run for each in records])
    if len(value) < groups.shape[1] + _MIN_FOR_RESULT - 1:  # too few for a constant in each power cycle
        groups = np.ones((len(value), 1))
    # With times relative to the middle of each power cycle, the constants and the drift are independent.
    elapsed = hours - groups @ (groups.T @ (hours / sigma**2) / (groups.T @ sigma**-2.0))
    design = np.column_stack([groups, elapsed])
    variance = excess_variance(value, sigma**2, design)
    fit = weighted_fit(value, sigma**2 + variance, design)
    covariance = fit.covariance * fit.chi2 / fit.dof
    quantile = float(t.ppf(0.5 + 0.5 * _CONFIDENCE, fit.dof))
    mean_weights = np.append(groups.mean(axis=0), 0.0)
    results = []
    for name, unit, weights in (
        ("mean scale factor", "ppm", mean_weights),
        ("scale factor drift", "ppm/h", np.eye(len(mean_weights))[-1]),
    ):
        estimate = float(weights @ fit.values)
        half_width = quantile * math.sqrt(weights @ covariance @ weights)
        results.append(coefficient(gyro, name, unit, estimate, estimate - half_width, estimate + half_width))
    scatters = [("scale factor", variance, variance_interval(value, sigma, design))]
    if groups.shape[1] > 1:
        constants, sigmas = fit.values[:-1], np.sqrt(np.diag(fit.covariance)[:-1])
        ones = np.ones((len(constants), 1))
        between = excess_variance(constants, sigmas**2, ones)
        scatters.append(("turn-on", between, variance_interval(constants, sigmas, ones)))
    for name, size, (low, high) in scatters:
        roots = (math.sqrt(each) for each in (size, low, high))
        results.append(coefficient(gyro, f"{name} standard deviation", "ppm", *roots))
        results.append(coefficient(gyro, f"{name} variance", "ppm^2", size, low, high))
    mean = float(mean_weights @ fit.values)
    return results, Curve.of(
        gyro, hours, value - mean, sigma, design @ fit.values - mean, [each.run for each in records]
    )


def _over_rates(gyro: str, scale_factors: Sequence[SpinScaleFactor]) -> list[Coefficient]:
    """Worst asymmetry and nonlinearity, if measured."""
    from scipy.stats import norm, t

    rates: list[float] = []
    for each in (row.rate_dps for factor in scale_factors for row in factor.rates):
        if not any(_are_equal(each, rate) for rate in rates):
            rates.append(each)
    results = []
    asymmetries = [
        [(row.asymmetry_ppm, row.asymmetry_sigma_ppm) for row in rows if row.asymmetry_ppm is not None]
        for rows in (
            [row for factor in scale_factors for row in factor.rates if _are_equal(row.rate_dps, rate)]
            for rate in rates
        )
    ]
    means = [weighted_mean(*zip(*pairs, strict=True)) for pairs in asymmetries if pairs]
    if means:
        scales = [math.sqrt(max(1.0, each.chi2_reduced)) if each.dof else 1.0 for each in means]
        quantile = float(norm.ppf(_joint_level(len(means))))
        half_widths = quantile * np.array([each.sigma for each in means]) * scales
        results.append(_worst(gyro, "worst asymmetry", np.array([each.value for each in means]), half_widths))
    complete = [
        sorted(factor.rates, key=lambda row: row.rate_dps)
        for factor in scale_factors
        if len(factor.rates) == len(rates)
    ]
    if len(rates) > 1 and len(complete) > 1:
        # Relative to the unweighted mean of all rates instead of the weighted one.
        deviations = np.array([[row.deviation_ppm for row in rows] for rows in complete])
        deviations -= deviations.mean(axis=1, keepdims=True)
        quantile = float(t.ppf(_joint_level(len(rates)), len(complete) - 1))
        half_widths = quantile * deviations.std(axis=0, ddof=1) / math.sqrt(len(complete))
        results.append(_worst(gyro, "worst nonlinearity", deviations.mean(axis=0), half_widths))
    return results


def _are_equal(rate_dps: float, other_dps: float) -> bool:
    return abs(rate_dps / other_dps - 1.0) < _RATE_TOLERANCE


def _joint_level(count: int) -> float:
    """Level of the quantile with which ``count`` intervals are joint intervals."""
    return 1.0 - 0.5 * (1.0 - _CONFIDENCE) / count


def _worst(gyro: str, name: str, values: FloatArray, half_widths: FloatArray) -> Coefficient:
    size = np.abs(values)
    low, high = max(0.0, float((size - half_widths).max())), float((size + half_widths).max())
    return coefficient(gyro, name, "ppm", float(size.max()), low, high)
