"""The gyros' temperatures over the whole time, for effects that depend on how a temperature came about."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from gyrobench.bench.foundations.arrays import BoolArray, FloatArray

_STEPS_A_DWELL = 6
_MOST_STEPS = 20_000
_S_PER_H = 3600.0
#: Corrections of a smooth course until its means are the measured ones.
_ROUNDS = 3


@dataclass(frozen=True)
class TemperatureRecord:
    """Temperatures at equal steps of time.

    Attributes
    ----------
    time_s : ndarray, shape (m,)
        Equally spaced, m at least 2, on the clock of the dwells.
    gyro_c : ndarray, shape (m, 3)
        Temperature of each gyro's optics.
    is_of_dwells : bool
        Whether it was made from the dwells' means and slopes.
    """

    time_s: FloatArray
    gyro_c: FloatArray
    is_of_dwells: bool = False

    @property
    def step_s(self) -> float:
        """Distance of the times."""
        return float(self.time_s[1] - self.time_s[0])

    def mean_over(self, values: FloatArray, start_s: FloatArray, end_s: FloatArray) -> FloatArray:
        """Mean of something known at the record's times (m, 3) from each start to each end, shape (n, 3)."""
        area = np.zeros_like(values)
        area[1:] = np.cumsum(0.5 * (values[1:] + values[:-1]) * self.step_s, axis=0)
        spans = np.maximum(end_s - start_s, 1e-9)
        return np.stack(
            [
                (np.interp(end_s, self.time_s, each) - np.interp(start_s, self.time_s, each)) / spans
                for each in area.T
            ],
            axis=1,
        )


def record_of_dwells(
    start_s: FloatArray,
    end_s: FloatArray,
    gyro_c: FloatArray,
    rate_c_per_h: FloatArray,
    held_out: BoolArray | None = None,
) -> TemperatureRecord:
    """Record with the dwells' mean temperatures and, in their middles, the dwells' slopes.

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
    step_s = max(float(np.median(end_s - start_s)) / _STEPS_A_DWELL, length_s / _MOST_STEPS, 1e-3)
    # Steps are counted from the begin, so that dwells added at the end do not move them.
    steps = np.arange(max(2, math.ceil(length_s / step_s) + 1), dtype=np.float64)
    time_s = first_s + step_s * steps
    if len(middle_s) == 1:
        return TemperatureRecord(time_s, np.repeat(gyro_c[index], len(time_s), axis=0))
    rates = rate_c_per_h[index] / _S_PER_H
    nodes_c, means_c = gyro_c[index].copy(), gyro_c[index]
    record = _through(time_s, middle_s, nodes_c, rates)
    for _ in range(_ROUNDS):
        nodes_c += means_c - record.mean_over(record.gyro_c, start_s[index], end_s[index])
        record = _through(time_s, middle_s, nodes_c, rates)
    return record


def _without_influence(
    start_s: FloatArray, end_s: FloatArray, gyro_c: FloatArray, rate_c_per_h: FloatArray, held_out: BoolArray
) -> TemperatureRecord:
    """Record of all dwells, but within those not held out the record of these alone."""
    every = record_of_dwells(start_s, end_s, gyro_c, rate_c_per_h)
    seen = ~held_out
    alone = record_of_dwells(start_s[seen], end_s[seen], gyro_c[seen], rate_c_per_h[seen])
    dwell = np.clip(np.searchsorted(start_s, every.time_s, side="right") - 1, 0, len(start_s) - 1)
    inside = seen[dwell] & (every.time_s <= end_s[dwell])
    own_c = np.stack([np.interp(every.time_s, alone.time_s, each) for each in alone.gyro_c.T], axis=1)
    return replace(every, gyro_c=np.where(inside[:, np.newaxis], own_c, every.gyro_c))


def _through(
    time_s: FloatArray, middle_s: FloatArray, nodes_c: FloatArray, rates: FloatArray
) -> TemperatureRecord:
    """Record through nodes (k, 3) at times (k,) with slopes in K/s, straight beyond them."""
    inside_s = np.clip(time_s, middle_s[0], middle_s[-1])
    before = np.minimum(time_s - middle_s[0], 0.0)[:, np.newaxis] * rates[0]
    after = np.maximum(time_s - middle_s[-1], 0.0)[:, np.newaxis] * rates[-1]
    curve_c = CubicHermiteSpline(middle_s, nodes_c, rates)(inside_s)
    return TemperatureRecord(time_s, curve_c + before + after, is_of_dwells=True)
