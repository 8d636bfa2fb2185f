"""Temperatures of the unit in a dwell, and the sensors that are not valid.

A sensor at the end of its signal's range gives no number (:mod:`gyrobench.drivers.ins.signal_map`). What
remains is what no part of a gyro can do: be hotter than its electronics survive, change faster than its
mass allows, or stay constant to the last bit while its neighbours change. Soaked gyros hardly change in one
dwell, but from dwell to dwell the whole INS follows the chamber: a sensor that is constant to the last bit
in a dwell, and has not followed the others since an earlier dwell, is stuck. A power cycle may not free it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.bias.dwell_table import NOT_MEASURED, DwellRow
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, Triple, triple
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import AXES
from gyrobench.drivers.ins.navigation_data import NavigationData, Temperatures

#: Fewest samples of a channel, and the share of them that must be numbers.
_MIN_SAMPLES = 2
_MIN_FINITE = 0.9


@dataclass(frozen=True)
class DwellTemperatures:
    """Means over a dwell, and the slope of the gyros' optics."""

    gyro_c: Triple = NOT_MEASURED
    gyro_rate_c_per_h: Triple = NOT_MEASURED
    board_c: Triple = NOT_MEASURED
    case_c: float = math.nan


def dwell_temperatures(navigation: NavigationData, first_row: int, end_row: int) -> DwellTemperatures:
    """Temperatures between two frames of a recording; those that are seldom a number are not measured.

    Raises MeasurementError if there are no epochs or no temperatures between them.
    """
    series = navigation.temperatures
    time_s = navigation.ins_time_s[navigation.between(first_row, end_row)]
    if not len(time_s):
        raise MeasurementError("no navigation frames in the dwell. Check the CAN cable and the station's DBC")
    first_s, last_s = time_s[[0, -1]]
    inside = (series.ins_time_s >= first_s) & (series.ins_time_s <= last_s)
    if np.count_nonzero(inside) < _MIN_SAMPLES:
        raise MeasurementError("no gyro temperatures in the dwell. Check the station's temperature signals")
    return DwellTemperatures(
        triple(_means(series.optics_c[inside])),
        triple(_slopes(series.ins_time_s[inside], series.optics_c[inside])),
        triple(_means(series.electronics_c[inside])),
        float(_means(series.case_c[inside][:, np.newaxis])[0]),
    )


def slopes_c_per_h(time_s: FloatArray, values_c: FloatArray) -> FloatArray:
    """Least-squares slopes (m,) of temperatures (n, m) over times (n,)."""
    hours = (time_s - time_s.mean()) / 3600.0
    return np.asarray(hours @ values_c / (hours @ hours))


def temperatures_at(time_s: FloatArray, series: Temperatures) -> tuple[FloatArray | None, FloatArray | None]:
    """Temperatures at epochs of the gyros' optics (n, 3) and of the accelerometers (n,).

    None where the INS does not send them all. The accelerometers have the temperature of the case; where that
    is never sent, the mean of the gyros.
    """
    optics = [_at(time_s, series.ins_time_s, axis_c) for axis_c in series.optics_c.T]
    known = [each for each in optics if each is not None]
    gyro_c = np.column_stack(known) if len(known) == len(optics) else None
    case_c = _at(time_s, series.ins_time_s, series.case_c)
    is_sent = bool(np.isfinite(series.case_c).any())
    return gyro_c, case_c if is_sent or gyro_c is None else gyro_c.mean(axis=1)


def _at(time_s: FloatArray, sample_s: FloatArray, values_c: FloatArray) -> FloatArray | None:
    """A channel's temperatures (n,) at epochs; None where it has too few."""
    valid = _valid(values_c)
    if np.count_nonzero(valid) < _MIN_SAMPLES:
        return None
    return np.interp(time_s, sample_s[valid], values_c[valid])


def _valid(values_c: FloatArray) -> BoolArray:
    """Which samples (n,) of a channel are numbers; none of them where too few are."""
    finite = np.isfinite(values_c)
    return finite & (np.count_nonzero(finite) >= _MIN_FINITE * len(finite))


def _means(values_c: FloatArray) -> FloatArray:
    valid = [(column_c, _valid(column_c)) for column_c in values_c.T]
    return np.array([column_c[each].mean() if each.any() else math.nan for column_c, each in valid])


def _slopes(time_s: FloatArray, values_c: FloatArray) -> FloatArray:
    valid = [(column_c, _valid(column_c)) for column_c in values_c.T]
    return np.array(
        [
            slopes_c_per_h(time_s[each], column_c[each])
            if np.count_nonzero(each) >= _MIN_SAMPLES
            else math.nan
            for column_c, each in valid
        ]
    )


#: Temperatures, degC, that an INS survives.
_PLAUSIBLE_C = (-80.0, 150.0)
#: From one reading to the next a sensor may change by this much, K, and this much more a second.
_STEP_K, _STEP_K_PER_S = 1.0, 0.25
#: Readings of one moment may differ by this much, K.
_SPREAD_K = 0.5
#: A sensor that stands still to the bit is stuck if a neighbour moves by this much, K.
_STUCK_K = 3.0
#: Longest time without any reading, as a share of all.
_MAX_GAP = 0.25


def valid_temperatures(
    navigation: NavigationData, first_row: int, end_row: int
) -> tuple[NavigationData, tuple[str, ...]]:
    """Mask the sensors that are not valid between two frames.

    Returns
    -------
    NavigationData
        With NaN throughout for each such sensor.
    tuple of str
        What is wrong with those of the gyros' optics: without them a bias belongs to no bin. The other
        sensors are merely not measured.
    """
    series = navigation.temperatures
    time_s = navigation.ins_time_s[navigation.between(first_row, end_row)]
    if not len(time_s):
        return navigation, ()
    begin_s, end_s = time_s[[0, -1]].tolist()
    inside = (series.ins_time_s >= begin_s) & (series.ins_time_s <= end_s)
    values_c = np.column_stack([series.optics_c, series.electronics_c, series.case_c])
    dwell_c = values_c[inside]
    faults = [
        _fault(series.ins_time_s[inside], each, begin_s, end_s) or _contradiction(spread_k)
        for each, spread_k in zip(dwell_c.T, series.spread_k[inside].T, strict=True)
    ]
    moved_k = np.array(
        [0.0 if fault else np.ptp(_finite(each)) for fault, each in zip(faults, dwell_c.T, strict=True)]
    )
    for sensor in np.flatnonzero(moved_k == 0.0):
        if moved_k.max() > _STUCK_K and not faults[sensor]:
            faults[sensor] = (
                f"is constant to the last bit while another one of the INS changes by {moved_k.max():.1f} K"
            )
    valid_c = np.where([not fault for fault in faults], values_c, np.nan)
    valid = replace(series, optics_c=valid_c[:, :3], electronics_c=valid_c[:, 3:6], case_c=valid_c[:, 6])
    return replace(navigation, temperatures=valid), tuple(
        f"no temperature of the {axis} gyro, so its bias belongs to no bin: its sensor {fault}"
        for axis, fault in zip(AXES, faults[:3], strict=True)
        if fault
    )


def _finite(values_c: FloatArray) -> FloatArray:
    return values_c[np.isfinite(values_c)]


def _fault(time_s: FloatArray, values_c: FloatArray, begin_s: float, end_s: float) -> str:
    """What is wrong with one sensor by itself; empty where nothing is."""
    valid = np.isfinite(values_c)
    if not valid.any():
        return "gives no reading, or is at the end of its range"
    if np.count_nonzero(valid) < _MIN_FINITE * len(valid):
        return f"gives a number in {np.count_nonzero(valid)} of {len(valid)} readings only"
    time_s, values_c = time_s[valid], values_c[valid]
    low_c, high_c = _PLAUSIBLE_C
    wild = (values_c < low_c) | (values_c > high_c)
    if wild.any():
        return f"reads {values_c[wild][0]:.1f} degC, which no INS survives"
    gap_s = float(np.diff(np.concatenate([[begin_s], time_s, [end_s]])).max())
    if gap_s > max(_MAX_GAP * (end_s - begin_s), 10.0):
        return f"was silent for {gap_s:.0f} s"
    steps_k = np.abs(np.diff(values_c))
    jumps = np.flatnonzero(steps_k > _STEP_K + _STEP_K_PER_S * np.diff(time_s))
    if len(jumps):
        return f"jumps by {steps_k[jumps[0]]:.1f} K at {time_s[jumps[0] + 1]:.0f} s on the clock of the INS"
    return ""


def _contradiction(spread_k: FloatArray) -> str:
    if not (spread_k > _SPREAD_K).any():
        return ""
    return f"gives readings at a time that differ by {spread_k.max():.1f} K: does a second node send them?"


#: Slope of a sensor that stands still, K/h: nothing but rounding of the arithmetic.
_STILL_C_PER_H = 1e-6
_SAME_C = 1e-6
#: From one dwell to another a sensor may change by this much more or less than the rest of the INS, K.
_FROM_INS_K = 5.0
#: No sensor shows the same in two dwells between which the chamber's air changed by this much, K.
_FROM_CHAMBER_K = 15.0


def stuck_sensors(rows: Sequence[DwellRow]) -> Iterator[tuple[int, str]]:
    """Find sensors of the gyros' optics that are stuck at the end of a run.

    ``rows``: of one run so far, in the order of time.

    Yields
    ------
    int, str
        Index of a dwell whose temperature is invalid, and why.
    """
    if not rows:
        return
    for axis in range(3):
        since = _still_since(rows, axis)
        earlier = [row for row in rows[_last_reading(rows, since, axis) : -1] if row.unit == rows[-1].unit]
        apart_k = [_apart_k(row, rows[-1], axis) for row in earlier if np.isfinite(row.gyro_c[axis])]
        if since < len(rows) and max(apart_k, default=0.0) > 1.0:
            for index in range(since, len(rows)):
                yield (
                    index,
                    f"the temperature of the {AXES[axis]} gyro is constant to the last bit at "
                    f"{rows[index].gyro_c[axis]:.2f} degC while the other temperatures change, so its bias "
                    "belongs to no bin: its sensor is stuck",
                )


def _still_since(rows: Sequence[DwellRow], axis: int) -> int:
    """Index of the first of the last dwells in which a sensor stood still at one value."""
    since = len(rows)
    while since and _is_still(rows[since - 1], axis) and _is_same(rows[since - 1], rows[-1], axis):
        since -= 1
    return since


def _last_reading(rows: Sequence[DwellRow], since: int, axis: int) -> int:
    """Index of the last dwell before ``since`` with a reading of a sensor; 0 for none."""
    before = max(since - 1, 0)
    while before and not np.isfinite(rows[before].gyro_c[axis]):
        before -= 1
    return before


def _apart_k(earlier: DwellRow, later: DwellRow, axis: int) -> float:
    """How far a sensor went another way than the rest, as a share of what it may."""
    changes = np.subtract(later.gyro_c, earlier.gyro_c)
    moving = [changes[k] for k in range(3) if k != axis and not _is_still(later, k)]
    rest = np.array([*moving, later.board_c[axis] - earlier.board_c[axis], later.case_c - earlier.case_c])
    rest = rest[np.isfinite(rest)]
    apart = abs(changes[axis] - float(np.median(rest))) / _FROM_INS_K if len(rest) else 0.0
    chamber_k = abs(later.chamber_c - earlier.chamber_c)
    if _is_still(earlier, axis) and _is_same(earlier, later, axis) and chamber_k > _FROM_CHAMBER_K:
        apart = max(apart, chamber_k / _FROM_CHAMBER_K)
    return apart


def _is_still(row: DwellRow, axis: int) -> bool:
    return abs(row.gyro_rate_c_per_h[axis]) < _STILL_C_PER_H


def _is_same(one: DwellRow, other: DwellRow, axis: int) -> bool:
    return one.unit == other.unit and abs(one.gyro_c[axis] - other.gyro_c[axis]) < _SAME_C
