"""Which windows are good, and whether the temperatures can carry a bias curve."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.sensor_log.attitude import nearest_position
from gyrobench.bench.sensor_log.document import LogMap
from gyrobench.bench.sensor_log.samples import full_scale_dph
from gyrobench.bench.sensor_log.windows import MIN_SAMPLES, Window

#: Part of a window that must have been recorded, and of its samples that must be good.
_LEAST_PART = 0.9
#: Samples in a row at the largest rate of a log that are no chance, with noise over several steps.
_SATURATED_RUN = 3
_NOISY_STEPS = 3.0
#: Share of a window that a rate may stay the same.
_STUCK_PART = 0.5
#: A finer temperature never stays the same for this long, in windows and seconds.
_LIVELY_RESOLUTION_C, _STUCK_WINDOWS, _STUCK_S = 0.05, 3, 300.0
#: Coarser steps of a temperature are told; fewer than these steps in its swing are refused.
_COARSE_RESOLUTION_C, _LEAST_STEPS = 0.25, 8

_GYRO_TEMPERATURES = tuple(f"gyro_{axis}_c" for axis in AXES)


def sample_interval_s(windows: Sequence[Window]) -> float:
    """Time from one sample to the next, as most windows have it."""
    intervals = [
        each.covered_s / (each.samples + each.dropped - 1)
        for each in windows
        if each.samples + each.dropped > 1
    ]
    return float(np.median(intervals)) if intervals else 0.0


def longest_gap_s(windows: Sequence[Window], log_map: LogMap) -> float:
    """Longest time between samples of a good window."""
    if log_map.max_gap_s is not None:
        return log_map.max_gap_s
    return max(5.0 * sample_interval_s(windows), 0.01 * log_map.window_s)


def reasons_against(windows: Sequence[Window], log_map: LogMap) -> list[str]:
    """Why each window of a log is left out; empty for a good one."""
    interval_s, gap_s = sample_interval_s(windows), longest_gap_s(windows, log_map)
    saturation = _saturation_dph(windows, log_map)
    stuck = _stuck_temperature(windows, log_map)
    return [
        _reason_of_samples(each, log_map, interval_s, gap_s)
        or _reason_of_rates(each, saturation)
        or _reason_of_temperatures(each, log_map, is_stuck)
        or _reason_of_place(each, log_map)
        for each, is_stuck in zip(windows, stuck, strict=True)
    ]


def temperature_resolution_c(windows: Sequence[Window], name: str) -> float:
    """Smallest step of a temperature; infinite where it never changes."""
    return min((each.steps[name] for each in windows if name in each.steps), default=np.inf)


def temperature_warnings(rows: Sequence[DwellRow], windows: Sequence[Window], log_map: LogMap) -> list[str]:
    """Tell what the temperatures of a table can't carry.

    Raises
    ------
    MeasurementError
        They swing too little, or in too few steps, for a curve over temperature.
    """
    if log_map.temperatures.constant_c is not None:
        return [
            "all rows have the one temperature of the mapping: they give biases, no curve over temperature"
        ]
    warnings: dict[str, None] = {}
    for index, (axis, name) in enumerate(zip(AXES, _GYRO_TEMPERATURES, strict=True)):
        temperatures = np.array([row.gyro_c[index] for row in rows])
        swing = float(np.ptp(temperatures))
        _check_swing(axis, swing, temperatures, log_map)
        resolution = temperature_resolution_c(windows, name)
        if resolution <= _COARSE_RESOLUTION_C or swing == 0.0:
            continue
        if swing < _LEAST_STEPS * resolution:
            raise MeasurementError(
                f"the temperature of gyro {axis} swings by {swing:.2f} K in steps of {resolution:.3g} K: "
                "too few for a curve over temperature. Log it with 0.1 K or finer, or swing it further"
            )
        bias = np.array([row.bias_dph[index] for row in rows])
        slope = float(np.polyfit(temperatures, bias, 1)[0])
        error = abs(slope) * resolution / np.sqrt(12.0)
        noise = float(np.median([row.sigma_dph[index] for row in rows]))
        warnings[
            f"the temperature of gyro {axis} comes in steps of {resolution:.3g} K: at a slope of "
            f"{slope:.3g} deg/h per K each bias may be off its curve by {error:.2g} deg/h (noise {noise:.2g} "
            "deg/h), and slow changes of the temperature do not show. Log it with 0.1 K or finer"
        ] = None
    return list(warnings)


def _check_swing(axis: str, swing: float, temperatures: FloatArray, log_map: LogMap) -> None:
    least = log_map.temperatures.least_swing_c
    if swing < least:
        raise MeasurementError(
            f"the temperature of gyro {axis} stays between {temperatures.min():.2f} and "
            f"{temperatures.max():.2f} degC, a swing of {swing:.2f} K; {least:g} K are needed for a curve "
            "over temperature. Log a larger swing, or allow a smaller one with "
            "'temperatures: {least_swing_c: ...}' in the mapping"
        )


def _reason_of_samples(window: Window, log_map: LogMap, interval_s: float, gap_s: float) -> str:
    total = window.samples + window.dropped
    if total < MIN_SAMPLES:
        return f"fewer than {MIN_SAMPLES} samples (are 'window_s' and the unit of time right?)"
    if window.covered_s + interval_s < _LEAST_PART * log_map.window_s:
        return "not recorded to the end"
    if window.widest_step_s > gap_s:
        return f"over a gap of more than {gap_s:.3g} s"
    if window.samples < max(_LEAST_PART * total, MIN_SAMPLES):
        return "too many samples without a good rate"
    return ""


def _reason_of_rates(window: Window, saturation: FloatArray) -> str:
    for axis, stayed, extreme, limit in zip(
        AXES, window.longest_unchanged, window.extreme_dph, saturation, strict=True
    ):
        if stayed > _STUCK_PART * window.samples:
            return f"rate of gyro {axis} stuck"
        if extreme >= limit:
            return f"rate of gyro {axis} saturated"
    return ""


def _reason_of_temperatures(window: Window, log_map: LogMap, is_stuck: bool) -> str:
    if log_map.temperatures.constant_c is not None:
        return ""
    if any(np.isnan(window.slopes_per_h[name]) for name in _GYRO_TEMPERATURES):
        return "no temperature"
    return "temperature stuck" if is_stuck else ""


def _reason_of_place(window: Window, log_map: LogMap) -> str:
    for name in ("position", "cycle"):
        if name in window.means:
            if np.isnan(window.means[name]):
                return f"no {name}"
            if window.spans[name] > 0.0:
                return f"{name} changed"
    if log_map.position.accelerometers is not None:
        _, tilt_deg = nearest_position(window.force)
        if not tilt_deg <= log_map.position.accelerometers.tolerance_deg:
            return f"over {log_map.position.accelerometers.tolerance_deg:g} deg from the nearest position"
    return ""


def _saturation_dph(windows: Sequence[Window], log_map: LogMap) -> FloatArray:
    """Rate at which each gyro saturates: the declared one, or one at which it was clipped."""
    declared = full_scale_dph(log_map) * (1.0 - 1e-6)
    extremes = np.array([each.extreme_dph for each in windows])
    highest = extremes.max(axis=0)
    runs = np.array([each.longest_at_extreme for each in windows])
    clipped = ((extremes == highest) & (runs >= _SATURATED_RUN)).any(axis=0)
    scatters = np.array([each.scatter_dph for each in windows])
    known = np.isfinite(scatters).all(axis=1)
    scatter = np.median(scatters[known], axis=0) if known.any() else np.zeros(3)
    step = np.min([each.rate_step_dph for each in windows], axis=0)
    # A quiet gyro of coarse steps stays at its largest rate for long without being clipped.
    clipped &= np.isfinite(step) & (scatter > _NOISY_STEPS * step)
    return np.where(clipped, np.minimum(highest, declared), declared)


def _stuck_temperature(windows: Sequence[Window], log_map: LogMap) -> list[bool]:
    """Whether each window lies in a long stretch of one and the same temperature, which should have noise."""
    stuck = [False] * len(windows)
    for name in _GYRO_TEMPERATURES:
        if temperature_resolution_c(windows, name) > _LIVELY_RESOLUTION_C:
            continue
        same = [
            (each.means[name] if each.spans[name] == 0.0 else (index,)) for index, each in enumerate(windows)
        ]
        begin = 0
        for value, group in itertools.groupby(same):
            count = len(list(group))
            long = count >= _STUCK_WINDOWS and count * log_map.window_s >= _STUCK_S
            if long and not isinstance(value, tuple):
                stuck[begin : begin + count] = [True] * count
            begin += count
    return stuck
