"""Temperatures of the unit over one dwell."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.dwell_table import NOT_MEASURED, Triple
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.drivers.ins.navigation_data import NavigationData, Temperatures

#: Fewest samples of a channel, and the share of them that must be numbers.
_FEWEST = 2
_LEAST_FINITE = 0.9


@dataclass(frozen=True)
class DwellTemperatures:
    """Means over a dwell, and the slope of the gyros' optics."""

    gyro_c: Triple = NOT_MEASURED
    gyro_rate_c_per_h: Triple = NOT_MEASURED
    board_c: Triple = NOT_MEASURED
    case_c: float = math.nan


def dwell_temperatures(navigation: NavigationData, first_row: int, end_row: int) -> DwellTemperatures:
    """Temperatures between two frames of a recording; those that are seldom a number are not measured.

    Raises
    ------
    MeasurementError
        There are no epochs or no temperatures between them.
    """
    series = navigation.temperatures
    epochs = (navigation.row >= first_row) & (navigation.row < end_row)
    if not epochs.any():
        raise MeasurementError("no navigation frames in the dwell. Check the CAN cable and the station's DBC")
    first_s, last_s = navigation.ins_time_s[epochs][[0, -1]]
    inside = (series.ins_time_s >= first_s) & (series.ins_time_s <= last_s)
    if np.count_nonzero(inside) < _FEWEST:
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


def gyro_temperatures_at(time_s: FloatArray, series: Temperatures) -> FloatArray | None:
    """Temperatures (n, 3) of the gyros' optics at epochs; None where the INS does not tell them all."""
    told = [_told(axis_c) for axis_c in series.optics_c.T]
    if any(np.count_nonzero(each) < _FEWEST for each in told):
        return None
    return np.column_stack(
        [
            np.interp(time_s, series.ins_time_s[each], axis_c[each])
            for each, axis_c in zip(told, series.optics_c.T, strict=True)
        ]
    )


def _told(values_c: FloatArray) -> BoolArray:
    """Which samples (n,) of a channel are numbers; none of them where too few are."""
    finite = np.isfinite(values_c)
    return finite & (np.count_nonzero(finite) >= _LEAST_FINITE * len(finite))


def _means(values_c: FloatArray) -> FloatArray:
    told = [(column_c, _told(column_c)) for column_c in values_c.T]
    return np.array([column_c[each].mean() if each.any() else math.nan for column_c, each in told])


def _slopes(time_s: FloatArray, values_c: FloatArray) -> FloatArray:
    told = [(column_c, _told(column_c)) for column_c in values_c.T]
    return np.array(
        [
            slopes_c_per_h(time_s[each], column_c[each]) if np.count_nonzero(each) >= _FEWEST else math.nan
            for column_c, each in told
        ]
    )


def triple(values: FloatArray) -> Triple:
    """Values of the x, y and z gyro as plain numbers."""
    x, y, z = (float(value) for value in values)
    return x, y, z
