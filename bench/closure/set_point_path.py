"""The course of the chamber's set point within dwells, from the means that a dwell table holds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

#: Samples of the course in each dwell.
SAMPLES = 60
#: Two means of one hold differ by less; the air of a hold is nearer than this to its set point.
_SAME_C = 0.02
_AT_SET_POINT_C = 0.1


def set_point_path(set_c: FloatArray, air_c: FloatArray) -> FloatArray:
    """Set point at :data:`SAMPLES` equally spaced instants of each dwell, shape (n, SAMPLES), degC.

    Dwells that share their mean with a neighbour, or whose air is at the set point, hold it. What
    lies between two holds is one ramp of constant rate that leaves the first hold and reaches the
    second at instants which the means of the dwells at its ends tell. A ramp within a single dwell
    takes the rate of the nearest other ramp; one at the table's begin or end that of its own means.

    Parameters
    ----------
    set_c, air_c : ndarray, shape (n,)
        Means of set point and air over each dwell, the dwells of about equal length and one after
        the other; the air may be NaN.
    """
    count = len(set_c)
    path = np.repeat(set_c[:, np.newaxis], SAMPLES, axis=1)
    holds = np.abs(set_c - air_c) < _AT_SET_POINT_C
    same = np.abs(np.diff(set_c)) < _SAME_C
    holds[:-1] |= same
    holds[1:] |= same
    ramps = _ramps(holds)
    rates = {ramp: rate for ramp in ramps if (rate := _rate(set_c, *ramp)) is not None}
    for first, last in ramps:
        rate = rates.get((first, last))
        if rate is None and rates:
            rate = rates[min(rates, key=lambda ramp: abs(ramp[0] - first))]
        if not rate:
            continue
        means_c = set_c[first : last + 1]
        if first > 0 and last < count - 1:
            path[first : last + 1] = _between_holds(means_c, set_c[first - 1], set_c[last + 1], rate)
        elif first > 0:
            path[first:] = _from_hold(means_c, set_c[first - 1], rate)
        elif last < count - 1:
            path[: last + 1] = _to_hold(means_c, set_c[last + 1], rate)
    return path


def _ramps(holds: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last dwell of each stretch that does not hold."""
    edges = np.diff(np.concatenate([[1], holds.astype(int), [1]]))
    return list(zip(np.flatnonzero(edges == -1), np.flatnonzero(edges == 1) - 1, strict=True))


def _rate(set_c: FloatArray, first: int, last: int) -> float | None:
    """Rate of a ramp in K a dwell, from the means of its dwells; None where they don't tell it."""
    if first == last:
        return None
    if first == 0 or last == len(set_c) - 1:
        return float(np.abs(np.diff(set_c[first : last + 1])).max())
    from_c, to_c = set_c[first - 1], set_c[last + 1]
    # At each end the ramp takes the part f of a dwell and moves its mean by rate * f**2 / 2.
    ends = np.sqrt(2.0 * abs(set_c[first] - from_c)) + np.sqrt(2.0 * abs(to_c - set_c[last]))
    inner, total = last - first - 1, abs(to_c - from_c)
    if inner == 0:
        root = total / max(ends, 1e-9)
    else:
        root = (np.sqrt(ends**2 + 4.0 * inner * total) - ends) / (2.0 * inner)
    return float(root**2)


def _part(mean_c: float, hold_c: float, rate: float) -> float:
    """Part of a dwell that a ramp takes beside a hold, from the dwell's mean."""
    return min(float(np.sqrt(2.0 * abs(mean_c - hold_c) / rate)), 1.0)


def _from_hold(means_c: FloatArray, from_c: float, rate: float) -> FloatArray:
    """Course of a ramp that leaves a hold and does not end."""
    since = _instants(len(means_c)) - 1.0 + _part(means_c[0], from_c, rate)
    return np.asarray(from_c + np.sign(means_c[-1] - from_c) * rate * np.maximum(since, 0.0))


def _to_hold(means_c: FloatArray, to_c: float, rate: float) -> FloatArray:
    """Course of a ramp without a begin that reaches a hold."""
    until = len(means_c) - 1 + _part(means_c[-1], to_c, rate) - _instants(len(means_c))
    return np.asarray(to_c - np.sign(to_c - means_c[0]) * rate * np.maximum(until, 0.0))


def _between_holds(means_c: FloatArray, from_c: float, to_c: float, rate: float) -> FloatArray:
    """Course of a ramp from one hold to another."""
    if len(means_c) == 1:
        rate = max(rate, abs(to_c - from_c))
        length = abs(to_c - from_c) / rate
        middle = (means_c[0] - to_c) / (from_c - to_c) if from_c != to_c else 0.5
        begin = min(max(middle - 0.5 * length, 0.0), 1.0 - length)
    else:
        begin = 1.0 - _part(means_c[0], from_c, rate)
    course_c = from_c + np.sign(to_c - from_c) * rate * np.maximum(_instants(len(means_c)) - begin, 0.0)
    return np.asarray(np.clip(course_c, min(from_c, to_c), max(from_c, to_c)))


def _instants(dwells: int) -> FloatArray:
    """Sampled instants (dwells, SAMPLES), in dwells."""
    return np.asarray(np.arange(dwells)[:, np.newaxis] + (np.arange(SAMPLES) + 0.5) / SAMPLES)
