"""A periodic rate of few periods in a record, where an Allan variance can't distinguish it from noise.

The periodogram of the rate is compared with ``a + b / f + c / f^2 + d f^2``: angle random walk, bias
instability, rate random walk and quantisation, none below zero. With and without a sinusoid the terms have
their largest Whittle likelihood. The ratio of the two is taken at the best frequency.

References
----------
Whittle, "Curve and periodogram smoothing", J. Royal Stat. Soc. B 19 (1957) 38: likelihood of a periodogram.
Riedel and Sidorenko, IEEE Trans. Signal Process. 43 (1995) 188: sine taper, by which little power of a random
walk leaks to higher frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.allan import not_negative
from gyrobench.bench.foundations.arrays import FloatArray

#: Periods in the record that are tried; where there are more, the Allan variance shows them.
_PERIODS = np.arange(3.0, 40.5, 0.5)
#: Frequencies of the periodogram, in units of one over the record.
_ORDINATES = 200
#: By the taper each ordinate says part of what its neighbours do: sum of their correlations.
_REPEATED = 1.5
#: Twice the logarithm of the likelihood ratio that noise exceeds in less than 1 of 2,000 records.
MIN_RATIO = 25.0
_ROUNDS = 8


@dataclass(frozen=True)
class PeriodicRate:
    """A sinusoid in a rate."""

    period_s: float
    amplitude: float  #: Unit of the integral / s.
    ratio: float  #: Twice the logarithm of the likelihood ratio.


def periodic_rate(angle: FloatArray, interval_s: float) -> PeriodicRate | None:
    """The sinusoid that fits best the rate of its integral (n,) on an even grid; None if the record is short.

    Of several parts between samples that are missing (NaN) the longest counts.
    """
    whole = max(np.split(angle, np.flatnonzero(np.isnan(angle))), key=len)
    whole = whole[np.isfinite(whole)]
    factor = max(1, (len(whole) - 1) // (4 * _ORDINATES))
    rate = np.diff(whole[::factor]) / (factor * interval_s)
    count = len(rate)
    if count <= 4 * _PERIODS[-1]:
        return None
    places = np.arange(1, min(_ORDINATES, count // 2) + 1)
    noise = places[:, np.newaxis] ** np.array([0.0, -1.0, -2.0, 2.0])
    moments = (np.arange(count) + 0.5) / count
    trend = np.column_stack([np.ones(count), moments])
    phases = 2.0 * np.pi * _PERIODS[:, np.newaxis] * moments
    taper = np.sin(np.pi * moments)
    designs = [trend, *(np.column_stack([trend, np.sin(each), np.cos(each)]) for each in phases)]
    designs = [taper[:, np.newaxis] * each for each in designs]
    fits = [np.linalg.lstsq(design, taper * rate)[0] for design in designs]
    left = np.array([taper * rate - design @ fit for design, fit in zip(designs, fits, strict=True)])
    powers = np.abs(np.fft.rfft(left, axis=1)[:, places]) ** 2 / count
    logs = np.array([_log_likelihood(each, noise) for each in powers])
    best = int(np.argmax(logs[1:]))
    return PeriodicRate(
        period_s=float(count * factor * interval_s / _PERIODS[best]),
        amplitude=float(np.hypot(*fits[best + 1][2:])),
        ratio=float(2.0 / _REPEATED * (logs[best + 1] - logs[0])),
    )


def _log_likelihood(powers: FloatArray, noise: FloatArray) -> float:
    """Of a periodogram (k,) with the best sum of terms (k, t)."""
    model = np.full(len(powers), powers.mean())
    best = -np.inf
    for _ in range(_ROUNDS):
        weighted = noise / model[:, np.newaxis]
        sizes = np.sqrt((weighted**2).sum(axis=0))
        model = noise @ (not_negative(weighted / sizes, powers / model) / sizes)
        best = max(best, -float(np.sum(powers / model + np.log(model))))
    return best
