"""Temperatures of the unit in a dwell, and tests that find faulty temperature sensors.

A sensor at the end of its signal's range gives no number (:mod:`gyrobench.drivers.ins.signal_map`). The tests
here find readings that are physically impossible: hotter than the electronics survive, a change faster than
the mass of the gyro allows, or a reading that is constant to the last bit while its neighbours change. Soaked
gyros hardly change in one dwell, but from dwell to dwell the whole INS follows the chamber: a sensor is stuck
if it is constant to the last bit in a dwell, and has not followed the others since an earlier dwell. A power
cycle may not free it.
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
    """Mean temperatures over a dwell, and the slopes of those of the gyros' optics."""

    gyro_c: Triple = NOT_MEASURED
    gyro_rate_c_per_h: Triple = NOT_MEASURED
    board_c: Triple = NOT_MEASURED
    case_c: float = math.nan


def dwell_temperatures(navigation: NavigationData, first_row: int, end_row: int) -> DwellTemperatures:
    """Temperatures between two frames of a recording; NaN for a sensor that rarely gives a number.

    Raises MeasurementError if there are no epochs or no temperatures between the frames.
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
    """Temperatures of the gyros' optics (n, 3) and of the accelerometers (n,) at epochs (n,).

    None if the INS does not send them all. The accelerometers have the temperature of the case; if that is
    never sent, the mean of the gyros.
    """
    optics = [_interpolated(time_s, series.ins_time_s, axis_c) for axis_c in series.optics_c.T]
    sent = [each for each in optics if each is not None]
    gyro_c = np.column_stack(sent) if len(sent) == len(optics) else None
    case_c = _interpolated(time_s, series.ins_time_s, series.case_c)
    is_sent = bool(np.isfinite(series.case_c).any())
    return gyro_c, case_c if is_sent or gyro_c is None else gyro_c.mean(axis=1)


def _interpolated(time_s: FloatArray, sample_s: FloatArray, values_c: FloatArray) -> FloatArray | None:
    """Temperatures (n,) of a channel, interpolated at epochs; None if it has too few samples."""
    valid = _valid(values_c)
    if np.count_nonzero(valid) < _MIN_SAMPLES:
        return None
    return np.interp(time_s, sample_s[valid], values_c[valid])


def _valid(values_c: FloatArray) -> BoolArray:
    """Mask (n,) of the samples of a channel that are numbers; all false if too few are."""
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


#: Lowest and highest temperature, degC, that an INS survives.
_SURVIVABLE_C = (-80.0, 150.0)
#: Largest change from one reading to the next: a constant, K, and a rate, K/s.
_MAX_STEP_K, _MAX_STEP_K_PER_S = 1.0, 0.25
#: Largest difference of readings sent at the same time, K.
_MAX_SPREAD_K = 0.5
#: A sensor that is constant to the last bit is stuck if a neighbour changes by more than this, K.
_MIN_NEIGHBOUR_CHANGE_K = 3.0
#: Longest gap between readings, as a share of the dwell.
_MAX_GAP = 0.25


def valid_temperatures(
    navigation: NavigationData, first_row: int, end_row: int
) -> tuple[NavigationData, tuple[str, ...]]:
    """Mask the sensors that are faulty between two frames.

    Returns the navigation with NaN at all times for each faulty sensor, and a flag for each faulty sensor of
    the gyros' optics: without it a bias belongs to no bin. The other sensors are not needed.
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
        _sensor_fault(series.ins_time_s[inside], each, spread_k, begin_s, end_s)
        for each, spread_k in zip(dwell_c.T, series.spread_k[inside].T, strict=True)
    ]
    ranges_k = np.zeros(len(faults))
    for index, (fault, each) in enumerate(zip(faults, dwell_c.T, strict=True)):
        if not fault:
            ranges_k[index] = np.ptp(each[np.isfinite(each)])
    for sensor in np.flatnonzero(ranges_k == 0.0):
        if ranges_k.max() > _MIN_NEIGHBOUR_CHANGE_K and not faults[sensor]:
            faults[sensor] = (
                f"is constant to the last bit while another one of the INS changes by {ranges_k.max():.1f} K"
            )
    valid_c = np.where([not fault for fault in faults], values_c, np.nan)
    valid = replace(series, optics_c=valid_c[:, :3], electronics_c=valid_c[:, 3:6], case_c=valid_c[:, 6])
    return replace(navigation, temperatures=valid), tuple(
        f"no temperature of the {axis} gyro, so its bias belongs to no bin: its sensor {fault}"
        for axis, fault in zip(AXES, faults[:3], strict=True)
        if fault
    )


def _sensor_fault(
    time_s: FloatArray, values_c: FloatArray, spread_k: FloatArray, begin_s: float, end_s: float
) -> str:
    """Fault of a sensor by its own readings; empty if there is none."""
    valid = np.isfinite(values_c)
    if not valid.any():
        return "gives no reading, or is at the end of its range"
    if np.count_nonzero(valid) < _MIN_FINITE * len(valid):
        return f"gives a number in {np.count_nonzero(valid)} of {len(valid)} readings only"
    time_s, values_c = time_s[valid], values_c[valid]
    low_c, high_c = _SURVIVABLE_C
    implausible = (values_c < low_c) | (values_c > high_c)
    if implausible.any():
        return f"reads {values_c[implausible][0]:.1f} degC, which no INS survives"
    gap_s = float(np.diff(np.concatenate([[begin_s], time_s, [end_s]])).max())
    if gap_s > max(_MAX_GAP * (end_s - begin_s), 10.0):
        return f"was silent for {gap_s:.0f} s"
    steps_k = np.abs(np.diff(values_c))
    jumps = np.flatnonzero(steps_k > _MAX_STEP_K + _MAX_STEP_K_PER_S * np.diff(time_s))
    if len(jumps):
        return f"jumps by {steps_k[jumps[0]]:.1f} K at {time_s[jumps[0] + 1]:.0f} s on the clock of the INS"
    if (spread_k > _MAX_SPREAD_K).any():
        return (
            f"gives readings at a time that differ by {spread_k.max():.1f} K: does a second node send them?"
        )
    return ""


#: Largest slope of a sensor that is constant, K/h: only rounding of the arithmetic.
_MAX_CONSTANT_SLOPE_C_PER_H = 1e-6
_SAME_C = 1e-6
#: Largest difference between the change of a sensor from dwell to dwell and that of the rest of the INS, K.
_MAX_FROM_INS_K = 5.0
#: Largest change of the chamber air between two dwells in which a sensor reads the same, K.
_MAX_CHAMBER_CHANGE_K = 15.0


def stuck_sensors(rows: Sequence[DwellRow]) -> Iterator[tuple[int, str]]:
    """Find sensors of the gyros' optics that are stuck in the last of some dwells of one run, in time order.

    Yields the index of a dwell whose temperature is invalid, and its flag.
    """
    if not rows:
        return
    for axis in range(3):
        first_stuck = _constant_since(rows, axis)
        earlier = [
            row
            for row in rows[_last_reading_before(rows, first_stuck, axis) : -1]
            if row.unit == rows[-1].unit
        ]
        divergences = [_divergence(row, rows[-1], axis) for row in earlier if np.isfinite(row.gyro_c[axis])]
        if first_stuck < len(rows) and max(divergences, default=0.0) > 1.0:
            for index in range(first_stuck, len(rows)):
                yield (
                    index,
                    f"the temperature of the {AXES[axis]} gyro is constant to the last bit at "
                    f"{rows[index].gyro_c[axis]:.2f} degC while the other temperatures change, so its bias "
                    "belongs to no bin: its sensor is stuck",
                )


def _constant_since(rows: Sequence[DwellRow], axis: int) -> int:
    """Index of the first of the latest dwells in which a sensor was constant at one value."""
    for index in reversed(range(len(rows))):
        if not (_is_constant(rows[index], axis) and _have_same_reading(rows[index], rows[-1], axis)):
            return index + 1
    return 0


def _last_reading_before(rows: Sequence[DwellRow], first_stuck: int, axis: int) -> int:
    """Index of the last dwell before ``first_stuck`` with a reading of a sensor; 0 if there is none."""
    before = range(first_stuck)
    return max((index for index in before if np.isfinite(rows[index].gyro_c[axis])), default=0)


def _divergence(earlier: DwellRow, later: DwellRow, axis: int) -> float:
    """Difference between the change of a sensor and that of the rest of the INS, relative to its limit."""
    changes = np.subtract(later.gyro_c, earlier.gyro_c)
    other_changes = [changes[k] for k in range(3) if k != axis and not _is_constant(later, k)]
    others = np.array(
        [*other_changes, later.board_c[axis] - earlier.board_c[axis], later.case_c - earlier.case_c]
    )
    others = others[np.isfinite(others)]
    divergence = abs(changes[axis] - float(np.median(others))) / _MAX_FROM_INS_K if len(others) else 0.0
    chamber_k = abs(later.chamber_c - earlier.chamber_c)
    if (
        _is_constant(earlier, axis)
        and _have_same_reading(earlier, later, axis)
        and chamber_k > _MAX_CHAMBER_CHANGE_K
    ):
        divergence = max(divergence, chamber_k / _MAX_CHAMBER_CHANGE_K)
    return divergence


def _is_constant(row: DwellRow, axis: int) -> bool:
    return abs(row.gyro_rate_c_per_h[axis]) < _MAX_CONSTANT_SLOPE_C_PER_H


def _have_same_reading(first: DwellRow, second: DwellRow, axis: int) -> bool:
    return first.unit == second.unit and abs(first.gyro_c[axis] - second.gyro_c[axis]) < _SAME_C
