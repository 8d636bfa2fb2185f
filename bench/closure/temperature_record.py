"""The course of temperatures over a campaign: each gyro at all times, the set point within dwells."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from gyrobench.bench.foundations.arrays import S_PER_H, BoolArray, FloatArray, IntArray, true_spans

_STEPS_A_DWELL = 6
_MAX_STEPS = 20_000
#: Iterations that match the means of the smooth course to the measured ones.
_ITERATIONS = 3
#: Of a lag, a share of the past below this is neglected.
_FORGOTTEN = 1e-12
#: Steps of a record differ by less than this share of them where they differ by rounding alone.
_SAME_STEP = 1e-9
#: Instants in one of the blocks in which decaying sums are computed, and the most in a single one.
_BLOCK, _MAX_BLOCK = 32, 128


@dataclass(frozen=True)
class TemperatureRecord:
    """Temperatures over time, a straight line from each instant to the next."""

    time_s: FloatArray  #: Shape (m,). Increasing, m at least 2, on the clock of the dwells.
    gyro_c: FloatArray  #: Shape (m, 3). Temperature of each gyro's optics.
    is_of_dwells: bool = False  #: Whether it was interpolated from the dwells' means and slopes.
    #: Shape (m,). Temperature of the chamber air; None where it is not recorded between the dwells.
    air_c: FloatArray | None = None
    parts: tuple[TemperatureRecord, ...] = ()  #: The records that it was joined of; empty for one.

    @classmethod
    def joined(cls, parts: Sequence[TemperatureRecord]) -> TemperatureRecord:
        """One record of several in the order of time; between them a straight line."""
        if len(parts) == 1:
            return parts[0]
        ends_s = [*(after.time_s[0] for after in parts[1:]), np.inf]
        own = [part.time_s < end_s for part, end_s in zip(parts, ends_s, strict=True)]
        time_s, gyro_c = (
            np.concatenate([getattr(part, name)[mine] for part, mine in zip(parts, own, strict=True)])
            for name in ("time_s", "gyro_c")
        )
        air = [part.air_c[mine] for part, mine in zip(parts, own, strict=True) if part.air_c is not None]
        air_c = np.concatenate(air) if len(air) == len(parts) else None
        return cls(time_s, gyro_c, any(part.is_of_dwells for part in parts), air_c, tuple(parts))

    def means_over(self, start_s: FloatArray, end_s: FloatArray) -> Callable[[FloatArray], FloatArray]:
        """Function of values at the record's times (m, k): their means (n, k) from each start to each end."""
        instants_s = np.concatenate([start_s, end_s])
        before = np.clip(np.searchsorted(self.time_s, instants_s, "right") - 1, 0, len(self.time_s) - 2)
        steps_s = np.diff(self.time_s)
        share = np.clip((instants_s - self.time_s[before]) / steps_s[before], 0.0, 1.0)
        half_steps_s = 0.5 * steps_s
        per_s = 1.0 / np.maximum(end_s - start_s, 1e-9)

        def means(values: FloatArray) -> FloatArray:
            course = np.ascontiguousarray(values.T)
            areas = (course[:, 1:] + course[:, :-1]) * half_steps_s
            until_step = np.cumsum(areas, axis=1) - areas
            until = until_step.take(before, axis=1) + share * areas.take(before, axis=1)
            return np.asarray(((until[:, len(per_s) :] - until[:, : len(per_s)]) * per_s).T)

        return means

    def through_dwells(
        self, start_s: FloatArray, end_s: FloatArray, means: FloatArray, seen: BoolArray
    ) -> FloatArray:
        """Means of dwells (n, k) interpolated to the record's times; within dwells seen, from these alone."""
        middle_s = 0.5 * (start_s + end_s)

        def through(chosen: BoolArray) -> FloatArray:
            columns = means[chosen].T
            return np.stack([np.interp(self.time_s, middle_s[chosen], each) for each in columns], axis=1)

        values = through(np.ones_like(seen))
        if seen.any() and not seen.all():
            inside = self._inside(start_s, end_s, seen)[:, np.newaxis]
            values = np.where(inside, through(seen), values)
        return values

    def _inside(self, start_s: FloatArray, end_s: FloatArray, seen: BoolArray) -> BoolArray:
        """Times of the record within dwells seen."""
        dwell = np.clip(np.searchsorted(start_s, self.time_s, side="right") - 1, 0, len(start_s) - 1)
        inside: BoolArray = seen[dwell] & (self.time_s <= end_s[dwell])
        return inside


def lag(values: FloatArray, time_s: FloatArray, tau_s: float) -> FloatArray:
    """First-order lag of values (m, k) minus these values, at rest before the first of the times (m,).

    Exact for values that are a straight line from each instant to the next.
    """
    steps_s, step_s = time_s[1:] - time_s[:-1], time_s[1] - time_s[0]
    course = np.ascontiguousarray(values.T)
    behind = np.zeros_like(course)
    np.subtract(course[:, :-1], course[:, 1:], out=behind[:, 1:])
    if np.abs(steps_s - step_s).max() < _SAME_STEP * step_s:
        keep_each = math.exp(-step_s / tau_s)
        behind *= (1.0 - keep_each) * tau_s / step_s
        return _decaying_sum(behind, keep_each).T
    keep = np.exp(-np.append(0.0, steps_s) / tau_s)
    behind[:, 1:] *= (1.0 - keep[1:]) * tau_s / steps_s
    # Sums over the last 1, 2, 4, ... steps, as far back as something is kept of them.
    reach = 1
    while reach < len(keep) and np.any(keep[reach:] > _FORGOTTEN):
        behind[:, reach:] += keep[reach:] * behind[:, :-reach]
        keep[reach:] *= keep[:-reach]
        reach *= 2
    return np.asarray(behind.T)


def _decaying_sum(added: FloatArray, keep: float) -> FloatArray:
    """Sums (k, m) of which each is what was added (k, m) and the share ``keep`` of the one before.

    Those within blocks are products with one matrix; those at the ends of blocks are such sums again.
    """
    width, count = added.shape
    size = _BLOCK if count > _MAX_BLOCK else count
    number = -(-count // size)
    powers = keep ** np.arange(size + 1.0)
    matrix = np.concatenate([np.zeros(size - 1), powers[:-1]])[_ages(size)]
    blocks = np.zeros((width, number * size))
    blocks[:, :count] = added
    sums = blocks.reshape(width, number, size) @ matrix
    if number > 1:
        sums[:, 1:] += _decaying_sum(sums[:, :-1, -1], powers[-1])[..., np.newaxis] * powers[1:]
    return np.asarray(sums.reshape(width, -1)[:, :count])


@cache
def _ages(size: int) -> IntArray:
    """How many steps before each of ``size`` instants (columns) each other one is, plus size - 1."""
    instants = np.arange(size)
    return np.asarray(instants - instants[:, np.newaxis] + size - 1)


def followed_with_play(values: FloatArray, half_width: FloatArray | float, first: FloatArray) -> FloatArray:
    """Follower with play of a quantity (m, k): it moves where the quantity is a half width ahead of it.

    ``first`` (k,): where it stands before the first instant. NaN from an instant on at which the quantity is.

    Notes
    -----
    Each instant limits the follower of the one before; limits of limits are limits, so that those of 2, 4,
    8, ... instants follow from each other. From one turn of the quantity to the next, those of the last
    instant are enough.
    """
    course, half = np.ascontiguousarray(values.T), np.reshape(half_width, (-1, 1))
    steps = course[:, 1:] - course[:, :-1]
    turns = np.flatnonzero(~(steps[:, 1:] * steps[:, :-1] > 0.0).all(axis=0)) + 1
    turns = np.concatenate([[0], turns])
    low, high = course - half, course + half
    limits = np.stack([low[:, turns], high[:, turns]])
    reach = 1
    while reach < len(turns):
        earlier = np.maximum(limits[..., :-reach], limits[0, :, reach:])
        np.minimum(earlier, limits[1, :, reach:], out=earlier)
        limits[..., reach:] = earlier
        if (earlier[0] == earlier[1]).all():  # where both limits are one, instants before do not matter
            break
        reach *= 2
    at_turns = np.minimum(np.maximum(first[:, np.newaxis], limits[0]), limits[1])
    follower = np.repeat(at_turns, np.diff(turns, append=len(values)), axis=1)
    return np.asarray(np.minimum(np.maximum(follower, low), high).T)


def record_of_dwells(
    start_s: FloatArray,
    end_s: FloatArray,
    gyro_c: FloatArray,
    rate_c_per_h: FloatArray,
    held_out: BoolArray | None = None,
) -> TemperatureRecord:
    """Record with the mean temperatures of the dwells and their slopes at mid-dwell.

    Parameters
    ----------
    start_s, end_s : ndarray, shape (n,)
        Times of the dwells, in order.
    gyro_c, rate_c_per_h : ndarray, shape (n, 3)
        Mean temperatures of the dwells and their slopes.
    held_out : ndarray of bool, shape (n,), optional
        Dwells that must not influence the record within the others.
    """
    if held_out is not None and held_out.any() and not held_out.all():
        return _without_influence(start_s, end_s, gyro_c, rate_c_per_h, held_out)
    middle_s, index = np.unique(0.5 * (start_s + end_s), return_index=True)
    first_s, last_s = float(start_s.min()), float(end_s.max())
    length_s = max(last_s - first_s, 1.0)
    step_s = max(float(np.median(end_s - start_s)) / _STEPS_A_DWELL, length_s / _MAX_STEPS, 1e-3)
    # Steps are counted from the start, so that dwells added at the end do not shift them.
    steps = np.arange(max(2, math.ceil(length_s / step_s) + 1), dtype=np.float64)
    time_s = first_s + step_s * steps
    if len(middle_s) == 1:
        return TemperatureRecord(time_s, np.repeat(gyro_c[index], len(time_s), axis=0))
    rates = rate_c_per_h[index] / S_PER_H
    nodes_c, means_c = gyro_c[index].copy(), gyro_c[index]
    record = _through(time_s, middle_s, nodes_c, rates)
    means = record.means_over(start_s[index], end_s[index])
    for _ in range(_ITERATIONS):
        nodes_c += means_c - means(record.gyro_c)
        record = _through(time_s, middle_s, nodes_c, rates)
    return record


def _without_influence(
    start_s: FloatArray, end_s: FloatArray, gyro_c: FloatArray, rate_c_per_h: FloatArray, held_out: BoolArray
) -> TemperatureRecord:
    """Record of all dwells; within those not held out, the record of these alone."""
    all_dwells = record_of_dwells(start_s, end_s, gyro_c, rate_c_per_h)
    seen = ~held_out
    alone = record_of_dwells(start_s[seen], end_s[seen], gyro_c[seen], rate_c_per_h[seen])
    inside = all_dwells._inside(start_s, end_s, seen)  # noqa: SLF001
    own_c = np.stack([np.interp(all_dwells.time_s, alone.time_s, each) for each in alone.gyro_c.T], axis=1)
    return replace(all_dwells, gyro_c=np.where(inside[:, np.newaxis], own_c, all_dwells.gyro_c))


def _through(
    time_s: FloatArray, middle_s: FloatArray, nodes_c: FloatArray, rates: FloatArray
) -> TemperatureRecord:
    """Record through nodes (k, 3) at times (k,) with slopes in K/s, linear beyond them."""
    from scipy.interpolate import CubicHermiteSpline

    inside_s = np.clip(time_s, middle_s[0], middle_s[-1])
    before = np.minimum(time_s - middle_s[0], 0.0)[:, np.newaxis] * rates[0]
    after = np.maximum(time_s - middle_s[-1], 0.0)[:, np.newaxis] * rates[-1]
    curve_c = CubicHermiteSpline(middle_s, nodes_c, rates)(inside_s)
    return TemperatureRecord(time_s, curve_c + before + after, is_of_dwells=True)


#: Samples of the set point in each dwell.
SAMPLES = 60
#: Maximum difference of the means of one hold, and of the air from the set point of a hold.
_SAME_C = 0.02
_AT_SET_POINT_C = 0.1
#: More than the lag of the air behind a ramped set point.
_FAR_FROM_SET_POINT_C = 6.0
#: Largest pause between consecutive dwells, as a share of the dwell.
_MAX_PAUSE = 0.05


def set_point_path(
    start_s: FloatArray, end_s: FloatArray, set_c: FloatArray, air_c: FloatArray
) -> FloatArray:
    """Set point at :data:`SAMPLES` equally spaced instants of each dwell, shape (n, SAMPLES), degC.

    A dwell holds the set point if its mean equals that of a neighbour or its air is at the set point. Between
    two holds is a ramp of constant rate; the means of the dwells at its ends determine when it begins and
    ends. A ramp within a single dwell gets the rate of the nearest other one. The set point of a chamber that
    ramps by itself is the end of the ramp; the ramp is then taken from the air. ``start_s``, ``end_s`` (n,):
    times of the dwells, in order. ``set_c``, ``air_c`` (n,): means of set point and air over each dwell; NaN
    allowed for the air.
    """
    count = len(set_c)
    length_s = np.maximum(end_s - start_s, 1e-9)
    off_c = np.abs(set_c - air_c)
    holds = off_c < _AT_SET_POINT_C
    if np.any(off_c > _FAR_FROM_SET_POINT_C):
        set_c = air_c
    path = np.repeat(set_c[:, np.newaxis], SAMPLES, axis=1)
    same = np.abs(np.diff(set_c)) < _SAME_C
    holds[:-1] |= same
    holds[1:] |= same
    ramps = _ramps(holds)
    rates = {ramp: rate for ramp in ramps if (rate := _rate(start_s, end_s, set_c, *ramp)) > 0.0}
    for first, last in ramps if rates else ():
        rate = rates.get((first, last)) or rates[min(rates, key=lambda ramp: abs(ramp[0] - first))]
        for dwell in range(first, last + 1):
            before, after = max(dwell - 1, 0), min(dwell + 1, count - 1)
            fall = rate * length_s[dwell] * np.sign(set_c[after] - set_c[before])
            from_c = set_c[before] if dwell == first > 0 else None
            to_c = set_c[after] if dwell == last < count - 1 else None
            path[dwell] = _course(set_c[dwell], from_c, to_c, fall)
    return path


def _ramps(holds: BoolArray) -> list[tuple[int, int]]:
    """First and last dwell of each interval without a hold."""
    return [(begin, end - 1) for begin, end in true_spans(~holds)]


def _rate(start_s: FloatArray, end_s: FloatArray, set_c: FloatArray, first: int, last: int) -> float:
    """Rate of a ramp, K/s, from the means of its dwells; 0 if they do not determine it."""
    if first == last:
        return 0.0
    stretch = slice(max(first - 1, 0), last + 2)
    lengths_s = end_s[stretch] - start_s[stretch]
    pauses_s = start_s[stretch][1:] - end_s[stretch][:-1]
    if first == 0 or last == len(set_c) - 1 or np.any(pauses_s > _MAX_PAUSE * lengths_s[1:]):
        middles_s = 0.5 * (start_s + end_s)[first : last + 1]
        return float(np.abs(np.diff(set_c[first : last + 1]) / np.diff(middles_s)).max())
    # At each end the ramp occupies the fraction f of a dwell and changes its mean by rate * f**2 / 2.
    total = abs(set_c[last + 1] - set_c[first - 1])
    ends = np.sqrt(2.0 * abs(set_c[first] - set_c[first - 1])) + np.sqrt(
        2.0 * abs(set_c[last + 1] - set_c[last])
    )
    inner = last - first - 1
    root = (
        (np.sqrt(ends**2 + 4.0 * inner * total) - ends) / (2.0 * inner) if inner else total / max(ends, 1e-9)
    )
    return float(root**2 / np.mean(lengths_s))


def _course(mean_c: float, from_c: float | None, to_c: float | None, change_c: float) -> FloatArray:
    """Set point within one dwell of a ramp that changes by ``change_c`` per dwell.

    ``from_c`` and ``to_c`` are the temperatures of a hold before and after it.
    """
    instants = (np.arange(SAMPLES) + 0.5) / SAMPLES
    if from_c is not None and to_c is not None:
        length = min(abs(to_c - from_c) / max(abs(change_c), 1e-9), 1.0)
        middle = (mean_c - to_c) / (from_c - to_c) if from_c != to_c else 0.5
        begin = min(max(middle - 0.5 * length, 0.0), 1.0 - length)
        return np.asarray(
            from_c + (to_c - from_c) * np.clip((instants - begin) / max(length, 1e-9), 0.0, 1.0)
        )
    hold_c = from_c if to_c is None else to_c
    part = 1.0 if hold_c is None else np.sqrt(2.0 * abs(mean_c - hold_c) / max(abs(change_c), 1e-9))
    if hold_c is None or part >= 1.0:
        return np.asarray(mean_c + change_c * (instants - 0.5))
    if to_c is None:
        return np.asarray(hold_c + change_c * np.maximum(instants - 1.0 + part, 0.0))
    return np.asarray(hold_c - change_c * np.maximum(part - instants, 0.0))
