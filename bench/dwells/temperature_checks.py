"""Which temperature sensors can't be believed in one dwell.

A sensor at the end of its signal's range gives no number at all (:mod:`gyrobench.drivers.ins.signal_map`).
What is left here is what no part of a gyro can do: be hotter than its electronics bear, change faster
than its mass allows, or keep still to the last bit while its neighbours move.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.positions import AXES
from gyrobench.drivers.ins.navigation_data import NavigationData

#: Temperatures, degC, that an INS survives.
_PLAUSIBLE_C = (-80.0, 150.0)
#: From one reading to the next a sensor may change by this much, K, and this much more a second.
_STEP_K, _STEP_K_PER_S = 1.0, 0.25
#: Readings of one moment may differ by this much, K.
_SPREAD_K = 0.5
#: A sensor that stands still to the bit is stuck if a neighbour moves by this much, K.
STUCK_K = 3.0
#: Readings that may be missing: their share, and the longest time without any as a share of all.
_LEAST_TOLD, _LONGEST_GAP = 0.9, 0.25


def believed_temperatures(
    navigation: NavigationData, first_row: int, end_row: int
) -> tuple[NavigationData, tuple[str, ...]]:
    """Leave out the sensors that can't be believed between two frames.

    Returns
    -------
    NavigationData
        With NaN throughout for each such sensor.
    tuple of str
        What is wrong with those of the gyros' optics: without them a bias belongs to no bin. The other
        sensors are merely not measured.
    """
    series = navigation.temperatures
    epochs = (navigation.row >= first_row) & (navigation.row < end_row)
    if not epochs.any():
        return navigation, ()
    begin_s, end_s = navigation.ins_time_s[epochs][[0, -1]].tolist()
    inside = (series.ins_time_s >= begin_s) & (series.ins_time_s <= end_s)
    values_c = np.column_stack([series.optics_c, series.electronics_c, series.case_c])
    dwell_c = values_c[inside]
    faults = [
        _fault(series.ins_time_s[inside], each, begin_s, end_s) or _contradiction(spread_k)
        for each, spread_k in zip(dwell_c.T, series.spread_k[inside].T, strict=True)
    ]
    moved_k = np.array(
        [0.0 if fault else np.ptp(_told(each)) for fault, each in zip(faults, dwell_c.T, strict=True)]
    )
    for sensor in np.flatnonzero(moved_k == 0.0):
        if moved_k.max() > STUCK_K and not faults[sensor]:
            faults[sensor] = (
                f"keeps still to the last bit while another one of the INS moves by {moved_k.max():.1f} K"
            )
    believed_c = np.where([not fault for fault in faults], values_c, np.nan)
    believed = replace(
        series, optics_c=believed_c[:, :3], electronics_c=believed_c[:, 3:6], case_c=believed_c[:, 6]
    )
    return replace(navigation, temperatures=believed), tuple(
        f"no temperature of the {axis} gyro, so its bias belongs to no bin: its sensor {fault}"
        for axis, fault in zip(AXES, faults[:3], strict=True)
        if fault
    )


def _told(values_c: FloatArray) -> FloatArray:
    return values_c[np.isfinite(values_c)]


def _fault(time_s: FloatArray, values_c: FloatArray, begin_s: float, end_s: float) -> str:
    """What is wrong with one sensor by itself; empty where nothing is."""
    told = np.isfinite(values_c)
    if not told.any():
        return "tells nothing, or is at the end of its range"
    if np.count_nonzero(told) < _LEAST_TOLD * len(told):
        return f"gives a number in {np.count_nonzero(told)} of {len(told)} readings only"
    time_s, values_c = time_s[told], values_c[told]
    low_c, high_c = _PLAUSIBLE_C
    wild = (values_c < low_c) | (values_c > high_c)
    if wild.any():
        return f"says {values_c[wild][0]:.1f} degC, which no INS survives"
    gap_s = float(np.diff(np.concatenate([[begin_s], time_s, [end_s]])).max())
    if gap_s > max(_LONGEST_GAP * (end_s - begin_s), 10.0):
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
