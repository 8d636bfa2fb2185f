"""Temperatures of the unit over one dwell."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.bias.tables.dwell_table import Triple
from bench.errors import MeasurementError
from drivers.ins.navigation_data import NavigationData, Temperatures

#: Values of three gyros that nothing was measured of.
NOT_MEASURED: Triple = (math.nan, math.nan, math.nan)

_FEWEST = 2


@dataclass(frozen=True)
class DwellTemperatures:
    """Means over a dwell, and the slope of the gyros' optics."""

    gyro_c: Triple = NOT_MEASURED
    gyro_rate_c_per_h: Triple = NOT_MEASURED
    board_c: Triple = NOT_MEASURED
    case_c: float = math.nan


def dwell_temperatures(navigation: NavigationData, first_row: int, end_row: int) -> DwellTemperatures:
    """Temperatures between two frames of a recording.

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
        triple(series.optics_c[inside].mean(axis=0)),
        triple(slopes_c_per_h(series.ins_time_s[inside], series.optics_c[inside])),
        triple(series.electronics_c[inside].mean(axis=0)),
        float(series.case_c[inside].mean()),
    )


def slopes_c_per_h(time_s: NDArray[np.float64], values_c: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least-squares slopes (m,) of temperatures (n, m) over times (n,)."""
    hours = (time_s - time_s.mean()) / 3600.0
    return np.asarray(hours @ values_c / (hours @ hours))


def gyro_temperatures_at(time_s: NDArray[np.float64], series: Temperatures) -> NDArray[np.float64] | None:
    """Temperatures (n, 3) of the gyros' optics at epochs; None where the INS does not tell them."""
    if len(series.ins_time_s) < _FEWEST or np.isnan(series.optics_c).any():
        return None
    return np.column_stack([np.interp(time_s, series.ins_time_s, axis_c) for axis_c in series.optics_c.T])


def triple(values: NDArray[np.float64]) -> Triple:
    """Values of the x, y and z gyro as plain numbers."""
    x, y, z = (float(value) for value in values)
    return x, y, z
