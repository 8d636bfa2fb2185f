"""Temperatures over a campaign: those of each gyro at all times, and the set point within dwells."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.foundations.arrays import S_PER_H, BoolArray, FloatArray, true_spans
from gyrobench.bench.foundations.kernels import compiled, follow_with_play

_STEPS_A_DWELL = 6
_MAX_STEPS = 20_000
#: Iterations that match the means of the smooth course to the measured ones.
_ITERATIONS = 3


@dataclass(frozen=True)
class TemperatureRecord:
    """Temperatures over time, linear between instants."""

    time_s: FloatArray  #: Shape (m,). Increasing, m at least 2, on the clock of the dwells.
    gyro_c: FloatArray  #: Shape (m, 3). Temperature of each gyro's optics.
    is_of_dwells: bool = False  #: Whether it was interpolated from the dwells' means and slopes.
    #: Shape (m,). Temperature of the chamber air; None if it is not recorded between the dwells.
    air_c: FloatArray | None = None
    parts: tuple[TemperatureRecord, ...] = ()  #: The records that were joined; empty for a single one.

    @classmethod
    def joined(cls, parts: Sequence[TemperatureRecord]) -> TemperatureRecord:
        """Join records in the order of time; linear between them."""
        if len(parts) == 1:
            return parts[0]
        ends_s = [*(after.time_s[0] for after in parts[1:]), np.inf]
        masks = [part.time_s < end_s for part, end_s in zip(parts, ends_s, strict=True)]
        time_s, gyro_c = (
            np.concatenate([getattr(part, name)[mask] for part, mask in zip(parts, masks, strict=True)])
            for name in ("time_s", "gyro_c")
        )
        air_parts = [
            part.air_c[mask] for part, mask in zip(parts, masks, strict=True) if part.air_c is not None
        ]
        air_c = np.concatenate(air_parts) if len(air_parts) == len(parts) else None
        return cls(time_s, gyro_c, any(part.is_of_dwells for part in parts), air_c, tuple(parts))

    def means_over(self, start_s: FloatArray, end_s: FloatArray) -> Callable[[FloatArray], FloatArray]:
        """Function that maps values at the record's times (m, k) to their means (n, k) over n intervals."""
        instants_s = np.concatenate([start_s, end_s])
        before = np.clip(np.searchsorted(self.time_s, instants_s, "right") - 1, 0, len(self.time_s) - 2)
        steps_s = np.diff(self.time_s)
        share = np.clip((instants_s - self.time_s[before]) / steps_s[before], 0.0, 1.0)
        half_steps_s = 0.5 * steps_s
        per_s = 1.0 / np.maximum(end_s - start_s, 1e-9)

        def means(values: FloatArray) -> FloatArray:
            course = np.ascontiguousarray(values.T)
            areas = (course[:, 1:] + course[:, :-1]) * half_steps_s
            integrals_to_step = np.cumsum(areas, axis=1) - areas
            integrals = integrals_to_step.take(before, axis=1) + share * areas.take(before, axis=1)
            return np.asarray(((integrals[:, len(per_s) :] - integrals[:, : len(per_s)]) * per_s).T)

        return means

    def through_dwells(
        self, start_s: FloatArray, end_s: FloatArray, means: FloatArray, used: BoolArray
    ) -> FloatArray:
        """Means of dwells (n, k) interpolated to the record's times.

        Within dwells that are ``used`` (n,), only the means of these have influence.
        """
        middle_s = 0.5 * (start_s + end_s)

        def interpolate(chosen: BoolArray) -> FloatArray:
            columns = means[chosen].T
            return np.stack([np.interp(self.time_s, middle_s[chosen], each) for each in columns], axis=1)

        values = interpolate(np.ones_like(used))
        if used.any() and not used.all():
            inside = self._is_within(start_s, end_s, used)[:, np.newaxis]
            values = np.where(inside, interpolate(used), values)
        return values

    def _is_within(self, start_s: FloatArray, end_s: FloatArray, used: BoolArray) -> BoolArray:
        """Whether each time of the record is within a dwell that is ``used``."""
        dwell = np.clip(np.searchsorted(start_s, self.time_s, side="right") - 1, 0, len(start_s) - 1)
        inside: BoolArray = used[dwell] & (self.time_s <= end_s[dwell])
        return inside


def lag(values: FloatArray, time_s: FloatArray, tau_s: float) -> FloatArray:
    """First-order lag of values (m, k) minus these values; at rest before the first of the times (m,).

    Exact for values that are linear between instants.
    """
    steps_s = np.diff(time_s)
    keep = np.exp(-steps_s / tau_s)
    return _lag(np.ascontiguousarray(values.T), keep, (1.0 - keep) * tau_s / steps_s).T


@compiled
def _lag(course: FloatArray, keep: FloatArray, gain: FloatArray) -> FloatArray:
    """Recursion of a lag (k, m), with factors (m - 1,) of the lag and of the change in each step."""
    result = np.zeros_like(course)
    for row in range(course.shape[0]):
        for step in range(len(keep)):
            change = course[row, step + 1] - course[row, step]
            result[row, step + 1] = keep[step] * result[row, step] - gain[step] * change
    return result


def followed_with_play(values: FloatArray, half_width: FloatArray | float, first: FloatArray) -> FloatArray:
    """Follower with play of a quantity (m, k): it moves when the quantity is a half width ahead of it.

    ``first`` (k,): position of the follower before the first instant. NaN from the first instant on at which
    the quantity is NaN.
    """
    course = np.ascontiguousarray(values.T)
    return follow_with_play(course, np.full(len(course), half_width), np.ascontiguousarray(first)).T


def record_of_dwells(
    start_s: FloatArray,
    end_s: FloatArray,
    gyro_c: FloatArray,
    rate_c_per_h: FloatArray,
    held_out: BoolArray | None = None,
) -> TemperatureRecord:
    """Record that has the mean temperatures of the dwells and their slopes at mid-dwell.

    Parameters
    ----------
    start_s, end_s : ndarray, shape (n,)
        Times of the dwells, in order.
    gyro_c, rate_c_per_h : ndarray, shape (n, 3)
        Mean temperatures of the dwells and their slopes.
    held_out : ndarray of bool, shape (n,), optional
        Dwells that must not influence the record within other dwells.
    """
    if held_out is not None and held_out.any() and not held_out.all():
        return _record_without_held_out(start_s, end_s, gyro_c, rate_c_per_h, held_out)
    middle_s, index = np.unique(0.5 * (start_s + end_s), return_index=True)
    first_s, last_s = float(start_s.min()), float(end_s.max())
    length_s = max(last_s - first_s, 1.0)
    step_s = max(float(np.median(end_s - start_s)) / _STEPS_A_DWELL, length_s / _MAX_STEPS, 1e-3)
    # Times are multiples of the step from the start, so that dwells added at the end do not shift them.
    steps = np.arange(max(2, math.ceil(length_s / step_s) + 1), dtype=np.float64)
    time_s = first_s + step_s * steps
    if len(middle_s) == 1:
        return TemperatureRecord(time_s, np.repeat(gyro_c[index], len(time_s), axis=0))
    rates = rate_c_per_h[index] / S_PER_H
    nodes_c, means_c = gyro_c[index].copy(), gyro_c[index]
    record = _interpolate_nodes(time_s, middle_s, nodes_c, rates)
    means = record.means_over(start_s[index], end_s[index])
    for _ in range(_ITERATIONS):
        nodes_c += means_c - means(record.gyro_c)
        record = _interpolate_nodes(time_s, middle_s, nodes_c, rates)
    return record


def _record_without_held_out(
    start_s: FloatArray, end_s: FloatArray, gyro_c: FloatArray, rate_c_per_h: FloatArray, held_out: BoolArray
) -> TemperatureRecord:
    """Record of all dwells, replaced by that of the dwells not held out within these."""
    all_dwells = record_of_dwells(start_s, end_s, gyro_c, rate_c_per_h)
    used = ~held_out
    used_record = record_of_dwells(start_s[used], end_s[used], gyro_c[used], rate_c_per_h[used])
    inside = all_dwells._is_within(start_s, end_s, used)  # noqa: SLF001
    own_c = np.stack(
        [np.interp(all_dwells.time_s, used_record.time_s, each) for each in used_record.gyro_c.T], axis=1
    )
    return replace(all_dwells, gyro_c=np.where(inside[:, np.newaxis], own_c, all_dwells.gyro_c))


def _interpolate_nodes(
    time_s: FloatArray, middle_s: FloatArray, nodes_c: FloatArray, rates: FloatArray
) -> TemperatureRecord:
    """Record that interpolates nodes (k, 3) at times (k,) with slopes in K/s; linear outside of them."""
    from scipy.interpolate import CubicHermiteSpline

    inside_s = np.clip(time_s, middle_s[0], middle_s[-1])
    below_first = np.minimum(time_s - middle_s[0], 0.0)[:, np.newaxis] * rates[0]
    beyond_last = np.maximum(time_s - middle_s[-1], 0.0)[:, np.newaxis] * rates[-1]
    curve_c = CubicHermiteSpline(middle_s, nodes_c, rates)(inside_s)
    return TemperatureRecord(time_s, curve_c + below_first + beyond_last, is_of_dwells=True)


#: Samples of the set point in each dwell.
SAMPLES = 60
#: Maximum difference between the means of one hold, and between air and set point in a hold.
_SAME_C = 0.02
_AT_SET_POINT_C = 0.1
#: Difference between air and set point that exceeds the lag of the air behind a ramped set point.
_FAR_FROM_SET_POINT_C = 6.0
#: Largest pause between consecutive dwells, as a share of the dwell.
_MAX_PAUSE = 0.05


def set_point_path(
    start_s: FloatArray, end_s: FloatArray, set_c: FloatArray, air_c: FloatArray
) -> FloatArray:
    """Set point at :data:`SAMPLES` equally spaced instants of each dwell, shape (n, SAMPLES), degC.

    A dwell is a hold if its mean equals that of a neighbour or its air is at the set point. Between two holds
    the set point ramps at a constant rate; the means of the dwells at the ends of the ramp determine when it
    begins and ends. A ramp within a single dwell gets the rate of the nearest other ramp. If the chamber
    ramps by itself, its set point is the end of the ramp, so the ramp is taken from the air. ``start_s``,
    ``end_s`` (n,): times of the dwells, in order. ``set_c``, ``air_c`` (n,): means of set point and air over
    each dwell; NaN allowed for the air.
    """
    count = len(set_c)
    length_s = np.maximum(end_s - start_s, 1e-9)
    difference_c = np.abs(set_c - air_c)
    is_hold = difference_c < _AT_SET_POINT_C
    if np.any(difference_c > _FAR_FROM_SET_POINT_C):
        set_c = air_c
    path = np.repeat(set_c[:, np.newaxis], SAMPLES, axis=1)
    is_equal = np.abs(np.diff(set_c)) < _SAME_C
    is_hold[:-1] |= is_equal
    is_hold[1:] |= is_equal
    ramps = [(begin, end - 1) for begin, end in true_spans(~is_hold)]  # first and last dwell
    rates = {ramp: rate for ramp in ramps if (rate := _ramp_rate(start_s, end_s, set_c, *ramp)) > 0.0}
    for first, last in ramps if rates else ():
        rate = rates.get((first, last)) or rates[min(rates, key=lambda ramp: abs(ramp[0] - first))]
        for dwell in range(first, last + 1):
            before, after = max(dwell - 1, 0), min(dwell + 1, count - 1)
            fall = rate * length_s[dwell] * np.sign(set_c[after] - set_c[before])
            from_c = set_c[before] if dwell == first > 0 else None
            to_c = set_c[after] if dwell == last < count - 1 else None
            path[dwell] = _set_point_in_dwell(set_c[dwell], from_c, to_c, fall)
    return path


def _ramp_rate(start_s: FloatArray, end_s: FloatArray, set_c: FloatArray, first: int, last: int) -> float:
    """Rate of a ramp, K/s, from the means of its dwells; 0 if they do not determine it."""
    if first == last:
        return 0.0
    neighbourhood = slice(max(first - 1, 0), last + 2)
    lengths_s = end_s[neighbourhood] - start_s[neighbourhood]
    pauses_s = start_s[neighbourhood][1:] - end_s[neighbourhood][:-1]
    if first == 0 or last == len(set_c) - 1 or np.any(pauses_s > _MAX_PAUSE * lengths_s[1:]):
        middles_s = 0.5 * (start_s + end_s)[first : last + 1]
        return float(np.abs(np.diff(set_c[first : last + 1]) / np.diff(middles_s)).max())
    # At each end the ramp occupies the fraction f of a dwell and changes its mean by rate * f**2 / 2.
    total_change = abs(set_c[last + 1] - set_c[first - 1])
    end_roots = np.sqrt(2.0 * abs(set_c[first] - set_c[first - 1])) + np.sqrt(
        2.0 * abs(set_c[last + 1] - set_c[last])
    )
    inner = last - first - 1
    root = (
        (np.sqrt(end_roots**2 + 4.0 * inner * total_change) - end_roots) / (2.0 * inner)
        if inner
        else total_change / max(end_roots, 1e-9)
    )
    return float(root**2 / np.mean(lengths_s))


def _set_point_in_dwell(
    mean_c: float, from_c: float | None, to_c: float | None, change_c: float
) -> FloatArray:
    """Set point within one dwell of a ramp that changes by ``change_c`` per dwell.

    ``from_c`` and ``to_c`` are the temperatures of a hold before and after it.
    """
    instants = (np.arange(SAMPLES) + 0.5) / SAMPLES
    if from_c is not None and to_c is not None:
        length = min(abs(to_c - from_c) / max(abs(change_c), 1e-9), 1.0)
        middle = (mean_c - to_c) / (from_c - to_c) if from_c != to_c else 0.5
        ramp_start = min(max(middle - 0.5 * length, 0.0), 1.0 - length)
        return np.asarray(
            from_c + (to_c - from_c) * np.clip((instants - ramp_start) / max(length, 1e-9), 0.0, 1.0)
        )
    hold_c = from_c if to_c is None else to_c
    ramp_share = 1.0 if hold_c is None else np.sqrt(2.0 * abs(mean_c - hold_c) / max(abs(change_c), 1e-9))
    if hold_c is None or ramp_share >= 1.0:
        return np.asarray(mean_c + change_c * (instants - 0.5))
    if to_c is None:
        return np.asarray(hold_c + change_c * np.maximum(instants - 1.0 + ramp_share, 0.0))
    return np.asarray(hold_c - change_c * np.maximum(ramp_share - instants, 0.0))
