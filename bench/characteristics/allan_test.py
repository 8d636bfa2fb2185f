"""Noise of the gyros from a long Allan variance: the five coefficients of the standard model.

Quantisation Q, angle random walk N, bias instability B and rate random walk K are fitted to the overlapping
Allan variance; the ramp R is the mean slope of the rate, with its uncertainty due to this noise. Intervals
are those of chi-squared with the effective degrees of freedom ``2 c^2 / var(c)`` of the squared coefficient
c. Effects that these five terms do not explain, as a periodic rate, nevertheless contribute to them: a note
reports such effects, detected in the Allan variance or, if the record has few periods, in the periodogram.

The periodogram of the rate is compared with ``a + b / f + c / f^2 + d f^2``: angle random walk, bias
instability, rate random walk and quantisation, none below zero. The terms are fitted with and without a
sinusoid by maximum Whittle likelihood, and the likelihood ratio is evaluated at the best frequency.

References
----------
IEEE Std 952-1997, annex C: the model. Riley, *Handbook of Frequency Stability Analysis*, NIST SP 1065 (2008),
section 5.4: effective degrees of freedom and chi-squared intervals.
Whittle, "Curve and periodogram smoothing", J. Royal Stat. Soc. B 19 (1957) 38: likelihood of a periodogram.
Riedel and Sidorenko, IEEE Trans. Signal Process. 43 (1995) 188: sine taper, by which little power of a random
walk leaks to higher frequencies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.allan import (
    BIAS_INSTABILITY,
    RANDOM_WALK,
    RATE_WALK,
    WHITE_ANGLE,
    AllanVariance,
    RateNoise,
    allan_variance,
    fit_rate_noise,
    goodness_of_fit,
    mean_ramp,
    nonnegative_least_squares,
)
from gyrobench.bench.characteristics.results import Coefficient, Curve, TestResult, coefficient
from gyrobench.bench.foundations.arrays import (
    ARCSEC_TO_RAD,
    DEG_PER_SQRT_H_TO_SI,
    DPH_TO_RADPS,
    S_PER_H,
    FloatArray,
)
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import AXES

#: Name, unit and its size in SI of each coefficient.
_TERMS = {
    WHITE_ANGLE: ("quantisation Q", "arcsec", ARCSEC_TO_RAD),
    RANDOM_WALK: ("angle random walk N", "deg/sqrt(h)", DEG_PER_SQRT_H_TO_SI),
    BIAS_INSTABILITY: ("bias instability B", "deg/h", DPH_TO_RADPS),
    RATE_WALK: ("rate random walk K", "deg/h/sqrt(h)", DPH_TO_RADPS / np.sqrt(S_PER_H)),
}
_NORMAL_95 = 1.96
#: The terms do not explain the Allan variance if its p-value is smaller.
_MIN_P_VALUE = 1e-5
#: Period of a rate in units of the averaging time at which its Allan variance is largest.
_PERIOD_PER_TAU = 2.7
#: Numbers of periods in the record that are tested; with more periods the Allan variance detects the effect.
_PERIODS = np.arange(3.0, 40.5, 0.5)
#: Number of frequencies of the periodogram, in units of one over the record.
_ORDINATES = 200
#: Sum of the correlations of an ordinate with its neighbours, due to the taper.
_CORRELATION_SUM = 1.5
#: Twice the logarithm of the likelihood ratio that noise exceeds in less than 1 of 2,000 records.
MIN_RATIO = 25.0
_ITERATIONS = 8


@dataclass(frozen=True, eq=False)
class RateRecord:
    """Integrated rates of three gyros at rest."""

    interval_s: float  #: Time between two samples.
    segments: list[FloatArray]  #: Shapes (n, 3). Angles, rad, in body axes; segments can't be joined.


def allan_test(records: Sequence[RateRecord]) -> TestResult:
    """Noise coefficients of each gyro from records at one sample rate.

    Raises MeasurementError if there are none, or they are too short.
    """
    if not records:
        raise MeasurementError("no undisturbed navigation with purpose: noise")
    interval_s = records[0].interval_s
    coefficients: list[Coefficient] = []
    curves, notes = [], []
    for axis, gyro in enumerate(AXES):
        segments = [segment[:, axis] for record in records for segment in record.segments]
        allan = allan_variance(segments, interval_s)
        fit = fit_rate_noise(allan, with_instability=True)
        for term, (name, unit, size) in _TERMS.items():
            low, high = square_interval(float(fit.terms[term]), float(fit.sigmas[term]))
            value, low, high = (np.sqrt(each) / size for each in (float(fit.terms[term]), low, high))
            coefficients.append(coefficient(gyro, name, unit, float(value), float(low), float(high)))
        ramp, sigma = (each * S_PER_H / DPH_TO_RADPS for each in mean_ramp(segments, interval_s, fit))
        interval = ramp - _NORMAL_95 * sigma, ramp + _NORMAL_95 * sigma
        coefficients.append(coefficient(gyro, "rate ramp R", "deg/h/h", ramp, *interval))
        notes += _notes(gyro, allan, fit) or _periodic_note(gyro, max(segments, key=len), interval_s)
        curves.append(_curve(gyro, allan, fit))
    return TestResult(test="allan_variance", coefficients=coefficients, curves=curves, notes=notes)


def square_interval(square: float, sigma: float) -> tuple[float, float]:
    """95 % interval of a squared coefficient that is not below zero, by its effective degrees of freedom."""
    from scipy.stats import chi2

    if square <= _NORMAL_95 * sigma:
        return 0.0, square + _NORMAL_95 * sigma
    edf = 2.0 * (square / sigma) ** 2
    low, high = (square * edf / float(chi2.ppf(level, edf)) for level in (0.975, 0.025))
    return low, high


def _notes(gyro: str, allan: AllanVariance, fit: RateNoise) -> list[str]:
    """Note if the terms do not explain the Allan variance, with the averaging time of the largest misfit."""
    p_value = goodness_of_fit(allan, fit)
    if p_value >= _MIN_P_VALUE:
        return []
    ratio = allan.variance / fit.expected
    deviations = np.where(fit.used, np.abs(ratio - 1.0) / np.sqrt(2.0 / fit.edf + fit.excess**2), 0.0)
    index = int(np.argmax(deviations))
    tau_s = float(allan.tau_s[index])
    period_s = float(f"{_PERIOD_PER_TAU * tau_s:.2g}")
    period = f", as with a rate of period {period_s:.0f} s" if ratio[index] > 1.0 else ""
    return [
        f"{gyro.upper()} gyro: the five terms do not explain the Allan variance (p < {_MIN_P_VALUE:g}); near "
        f"{tau_s:.0f} s it is {ratio[index]:.1f} times the fit{period}. The coefficients may be those of "
        "another effect: look for it in the record."
    ]


def _periodic_note(gyro: str, segment: FloatArray, interval_s: float) -> list[str]:
    """Note about a periodic rate that the terms would take for noise."""
    periodic = periodic_rate(segment, interval_s)
    if periodic is None or periodic.ratio < MIN_RATIO:
        return []
    return [
        f"{gyro.upper()} gyro: the record has a rate of period {periodic.period_s:.2g} s and amplitude "
        f"{periodic.amplitude / DPH_TO_RADPS:.2g} deg/h beside its noise. Bias instability and rate random "
        "walk contain it: look for its cause, as heating or air conditioning, or record for longer."
    ]


def _curve(gyro: str, allan: AllanVariance, fit: RateNoise) -> Curve:
    from scipy.stats import chi2

    edf, variance = fit.edf, allan.variance
    bounds = [np.sqrt(variance * edf / chi2.ppf(level, edf)) / DPH_TO_RADPS for level in (0.8413, 0.1587)]
    return Curve(
        gyro=gyro,
        x=allan.tau_s.tolist(),
        value=(allan.deviation / DPH_TO_RADPS).tolist(),
        low=bounds[0].tolist(),
        high=bounds[1].tolist(),
        fit=(np.sqrt(fit.expected) / DPH_TO_RADPS).tolist(),
    )


@dataclass(frozen=True)
class PeriodicRate:
    """A sinusoid in a rate."""

    period_s: float
    amplitude: float  #: Unit of the integral / s.
    ratio: float  #: Twice the logarithm of the likelihood ratio.


def periodic_rate(angle: FloatArray, interval_s: float) -> PeriodicRate | None:
    """Best-fitting sinusoid in the rate, from its integral (n,) on an even grid; None for a short record.

    If samples are missing (NaN), the longest part between them is used.
    """
    longest = max(np.split(angle, np.flatnonzero(np.isnan(angle))), key=len)
    longest = longest[np.isfinite(longest)]
    factor = max(1, (len(longest) - 1) // (4 * _ORDINATES))
    rate = np.diff(longest[::factor]) / (factor * interval_s)
    count = len(rate)
    if count <= 4 * _PERIODS[-1]:
        return None
    ordinates = np.arange(1, min(_ORDINATES, count // 2) + 1)
    noise = ordinates[:, np.newaxis] ** np.array([0.0, -1.0, -2.0, 2.0])
    moments = (np.arange(count) + 0.5) / count
    trend = np.column_stack([np.ones(count), moments])
    phases = 2.0 * np.pi * _PERIODS[:, np.newaxis] * moments
    taper = np.sin(np.pi * moments)
    designs = [trend, *(np.column_stack([trend, np.sin(each), np.cos(each)]) for each in phases)]
    designs = [taper[:, np.newaxis] * each for each in designs]
    fits = [np.linalg.lstsq(design, taper * rate)[0] for design in designs]
    residuals = np.array([taper * rate - design @ fit for design, fit in zip(designs, fits, strict=True)])
    powers = np.abs(np.fft.rfft(residuals, axis=1)[:, ordinates]) ** 2 / count
    logs = np.array([_log_likelihood(each, noise) for each in powers])
    best = int(np.argmax(logs[1:]))
    return PeriodicRate(
        period_s=float(count * factor * interval_s / _PERIODS[best]),
        amplitude=float(np.hypot(*fits[best + 1][2:])),
        ratio=float(2.0 / _CORRELATION_SUM * (logs[best + 1] - logs[0])),
    )


def _log_likelihood(powers: FloatArray, noise: FloatArray) -> float:
    """Whittle log-likelihood of a periodogram (k,) for the best sum of terms (k, t)."""
    model = np.full(len(powers), powers.mean())
    best = -np.inf
    for _ in range(_ITERATIONS):
        weighted = noise / model[:, np.newaxis]
        sizes = np.sqrt((weighted**2).sum(axis=0))
        model = noise @ (nonnegative_least_squares(weighted / sizes, powers / model) / sizes)
        best = max(best, -float(np.sum(powers / model + np.log(model))))
    return best
