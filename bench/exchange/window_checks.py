"""Checks of windows, noise of their means, and whether the temperatures support a bias curve."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.exchange.import_map import EarthRate, LogMap
from gyrobench.bench.exchange.log_windows import BLOCKS, MIN_WINDOW_SAMPLES, Window, full_scale_dph
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, BoolArray, FloatArray, true_spans
from gyrobench.bench.foundations.csv_tables import COLDEST_C, HOTTEST_C
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.earth import earth_rate_enu
from gyrobench.bench.navigation.positions import AXES, POSITIONS


def nearest_position(force: FloatArray) -> tuple[str, float]:
    """Position whose vertical is nearest to a specific force (3,) at rest, and the angle between them, deg.

    The force is in body axes and any unit: it points up.
    """
    magnitude = float(np.linalg.norm(force))
    if not magnitude > 0.0:
        return "z_up", math.nan
    cosines = {
        name: position.up_sign * float(force[position.up_axis]) / magnitude
        for name, position in POSITIONS.items()
    }
    name = max(cosines, key=cosines.__getitem__)
    return name, math.degrees(math.acos(min(1.0, cosines[name])))


def earth_rate_dph(position: str, rule: EarthRate) -> FloatArray:
    """Earth rate sensed by the gyros, deg/h, body axes, shape (3,).

    Without an azimuth only the vertical axis has a value; the others are 0.
    """
    attitude = POSITIONS[position]
    rate = earth_rate_enu(math.radians(rule.latitude_deg)) * RADPS_TO_DPH
    if rule.azimuth_deg is None:
        rate = rate * [0.0, 0.0, 1.0]
    return np.asarray(attitude.C_nb(math.radians(rule.azimuth_deg or 0.0)).T @ rate)


#: Smallest share of a window that must be recorded, and of its samples that must be valid.
_MIN_SHARE = 0.9
#: A rate is clipped if at least this number of samples in a row have its largest value, and its noise
#: exceeds this number of resolution steps.
_MIN_SATURATED_SAMPLES = 3
_MIN_NOISE_STEPS = 3.0
#: Largest share of a window in which a rate may be constant.
_MAX_STUCK_SHARE = 0.5
#: A temperature with a finer resolution than this is stuck if it is constant this long, in windows and s.
_FINE_RESOLUTION_C, _STUCK_WINDOWS, _STUCK_S = 0.05, 3, 300.0
#: Coarser steps of a temperature cause a warning; a swing of fewer steps is rejected.
_COARSE_RESOLUTION_C, _MIN_STEPS = 0.25, 8
#: Temperatures above this, degC, are more likely in kelvin; if any is above the next, in degF.
_MIN_KELVIN, _MAX_CELSIUS = 200.0, 110.0

_GYRO_TEMPERATURES = tuple(f"gyro_{axis}_c" for axis in AXES)


def rejection_reasons(windows: Sequence[Window], log_map: LogMap) -> list[str]:
    """Reason why each window of a log is left out; empty for a valid window."""
    intervals_s = [
        each.covered_s / (each.samples + each.dropped - 1)
        for each in windows
        if each.samples + each.dropped > 1
    ]
    interval_s = float(np.median(intervals_s)) if intervals_s else 0.0
    gap_s = log_map.max_gap_s or max(5.0 * interval_s, 0.01 * log_map.averages.window_s)
    saturation = _saturation_dph(windows, log_map)
    stuck = _stuck_temperature(windows, log_map)
    return [
        _sample_problem(each, log_map, interval_s, gap_s)
        or _rate_problem(each, saturation)
        or _temperature_problem(each, log_map, is_stuck)
        or _position_problem(each, log_map)
        for each, is_stuck in zip(windows, stuck, strict=True)
    ]


def temperature_resolution_c(windows: Sequence[Window], name: str) -> float:
    """Smallest step of a temperature; infinite if it never changes."""
    return min((each.trends[name].step for each in windows if name in each.trends), default=np.inf)


def temperature_warnings(rows: Sequence[DwellRow], windows: Sequence[Window], log_map: LogMap) -> list[str]:
    """Warnings about the temperatures of a table.

    Raises MeasurementError if they swing too little, or in too few steps, for a curve over temperature.
    """
    if log_map.averages.temperatures.constant_c is not None:
        return ["all rows have the constant temperature of the import map: no curve over temperature"]
    warnings = []
    gyro_c = np.array([row.gyro_c for row in rows])
    if gyro_c.min() > _MIN_KELVIN:
        warnings.append(
            f"the gyros are at {gyro_c.min():.1f} to {gyro_c.max():.1f} degC. If they are in kelvin, give "
            "'temperatures: {offset_c: -273.15}' in the import map"
        )
    elif gyro_c.max() > _MAX_CELSIUS:
        warnings.append(
            f"the gyros are at {gyro_c.min():.1f} to {gyro_c.max():.1f} degC. If they are in degF, give "
            "'temperatures: {scale: 0.55556, offset_c: -17.778}' in the import map"
        )
    for index, (axis, name) in enumerate(zip(AXES, _GYRO_TEMPERATURES, strict=True)):
        temperatures = np.array([row.gyro_c[index] for row in rows])
        swing = float(np.ptp(temperatures))
        min_swing = log_map.averages.temperatures.min_swing_c
        if swing < min_swing:
            raise MeasurementError(
                f"the temperature of gyro {axis} is between {temperatures.min():.2f} and "
                f"{temperatures.max():.2f} degC, a swing of {swing:.2f} K; a curve needs {min_swing:g} K "
                "of swing. Log a larger swing, or allow a smaller one with "
                "'temperatures: {min_swing_c: ...}' in the import map"
            )
        resolution = temperature_resolution_c(windows, name)
        if resolution <= _COARSE_RESOLUTION_C or swing == 0.0:
            continue
        if swing < _MIN_STEPS * resolution:
            raise MeasurementError(
                f"the temperature of gyro {axis} swings by {swing:.2f} K in steps of {resolution:.3g} K: "
                "too few for a curve over temperature. Log it with 0.1 K or finer, or swing it further"
            )
        bias = np.array([row.bias_dph[index] for row in rows])
        slope = float(np.polyfit(temperatures, bias, 1)[0])
        error = abs(slope) * resolution / np.sqrt(12.0)
        noise = float(np.median([row.sigma_dph[index] for row in rows]))
        warnings.append(
            f"the temperature of gyro {axis} comes in steps of {resolution:.3g} K: at a slope of "
            f"{slope:.3g} deg/h per K each bias may be off its curve by {error:.2g} deg/h (noise {noise:.2g} "
            "deg/h), and slow changes of the temperature do not show. Log it with 0.1 K or finer"
        )
    return warnings


def _sample_problem(window: Window, log_map: LogMap, interval_s: float, gap_s: float) -> str:
    """Reason against a window by its samples; empty if there is none."""
    total = window.samples + window.dropped
    if total < MIN_WINDOW_SAMPLES:
        return f"fewer than {MIN_WINDOW_SAMPLES} samples (are 'window_s' and the unit of time right?)"
    if window.covered_s + interval_s < _MIN_SHARE * log_map.averages.window_s:
        return "not recorded to the end"
    if window.max_step_s > gap_s:
        return f"over a gap of more than {gap_s:.3g} s"
    if window.samples < max(_MIN_SHARE * total, MIN_WINDOW_SAMPLES):
        return "too many samples without a valid rate"
    return ""


def _rate_problem(window: Window, saturation: FloatArray) -> str:
    """Reason against a window by its rates; empty if there is none."""
    for axis, unchanged, extreme, limit in zip(
        AXES, window.max_samples_unchanged, window.extreme_dph, saturation, strict=True
    ):
        if unchanged > _MAX_STUCK_SHARE * window.samples:
            return f"rate of gyro {axis} stuck"
        if extreme >= limit:
            return f"rate of gyro {axis} saturated"
    return ""


def _temperature_problem(window: Window, log_map: LogMap, is_stuck: bool) -> str:
    """Reason against a window by its temperatures; empty if there is none."""
    if log_map.averages.temperatures.constant_c is not None:
        return ""
    if any(np.isnan(window.trends[name].slope_per_h) for name in _GYRO_TEMPERATURES):
        return f"no temperature from {COLDEST_C:g} to {HOTTEST_C:g} degC"
    return "temperature stuck" if is_stuck else ""


def _position_problem(window: Window, log_map: LogMap) -> str:
    """Reason against a window by its position or cycle; empty if there is none."""
    for name in ("position", "cycle"):
        if trend := window.trends.get(name):
            if np.isnan(trend.mean):
                return f"no {name}"
            if trend.span > 0.0:
                return f"{name} changed"
    if (rule := log_map.averages.position.accelerometers) is not None:
        _, tilt_deg = nearest_position(window.force)
        if not tilt_deg <= rule.tolerance_deg:
            return f"over {rule.tolerance_deg:g} deg from the nearest position"
    return ""


def _saturation_dph(windows: Sequence[Window], log_map: LogMap) -> FloatArray:
    """Rate at which each gyro saturates: the declared one, or one at which it was clipped."""
    declared = full_scale_dph(log_map) * (1.0 - 1e-6)
    extremes = np.array([each.extreme_dph for each in windows])
    highest = extremes.max(axis=0)
    runs_at_extreme = np.array([each.max_samples_at_extreme for each in windows])
    is_clipped = ((extremes == highest) & (runs_at_extreme >= _MIN_SATURATED_SAMPLES)).any(axis=0)
    scatters = np.array([each.scatter_dph for each in windows])
    is_known = np.isfinite(scatters).all(axis=1)
    scatter = np.median(scatters[is_known], axis=0) if is_known.any() else np.zeros(3)
    step = np.min([each.rate_step_dph for each in windows], axis=0)
    # A gyro with little noise and coarse steps keeps its largest rate for long without being clipped.
    is_clipped &= np.isfinite(step) & (scatter > _MIN_NOISE_STEPS * step)
    return np.where(is_clipped, np.minimum(highest, declared), declared)


def _stuck_temperature(windows: Sequence[Window], log_map: LogMap) -> BoolArray:
    """Whether each window (n,) belongs to a long series of constant temperature, which should have noise."""
    is_stuck = np.zeros(len(windows), dtype=bool)
    for name in _GYRO_TEMPERATURES:
        if temperature_resolution_c(windows, name) > _FINE_RESOLUTION_C:
            continue
        is_constant = np.array([each.trends[name].span == 0.0 for each in windows])
        is_equal = np.diff([each.trends[name].mean for each in windows]) == 0.0
        for begin, end in true_spans(is_equal & is_constant[1:] & is_constant[:-1]):
            count = 1 + end - begin
            if count >= _STUCK_WINDOWS and count * log_map.averages.window_s >= _STUCK_S:
                is_stuck[begin : end + 1] = True
    return is_stuck


#: Median of the square of a standard normal value.
_MEDIAN_SQUARE = 0.45494
#: Mean square of a standard normal value within three standard deviations.
_TRUNCATED_MEAN_SQUARE = 0.97334
#: Mean square of a second difference of means, relative to the variance of a mean, for white rate noise.
_WHITE_RATE_FACTOR = 6.0
#: The same, relative to the variance of the angle at one end, for white angle noise.
_WHITE_ANGLE_FACTOR = 20.0
#: Smallest number of second differences of an averaging time, and largest number that counts as weight.
_MIN_DIFFERENCES, _MAX_DIFFERENCES = 8, 2000
#: Relative excess over the noise that counts as drift, times the root of the number of differences.
_DRIFT_TOLERANCE = 6.0


def noise_of_means(logs: Sequence[Sequence[Window]]) -> FloatArray:
    """Standard uncertainty of a window's mean rate due to noise, deg/h, shape (3,).

    Second differences of consecutive means are free of constants and slopes. Their mean square over
    averaging time, from parts of windows to whole ones, is divided into terms that are white
    in the angle (a ring laser's dither, quantisation), white in the rate (angle random walk) and independent
    of the averaging time (bias instability), as for an Allan variance. Averaging times that exceed these
    terms contain drift and are ignored. Outliers, such as a knock in one window, are left out. The
    uncertainty of a mean is at least that of the resolution of the rate.

    ``logs``: valid windows of each log. Raises MeasurementError if a gyro's rate never changes, or there are
    too few windows.
    """
    windows = [window for log in logs for window in log]
    differences = {
        time: each
        for time, each in (*_differences_within(windows), (1.0, _differences_between(logs)))
        if len(each) >= _MIN_DIFFERENCES
    }
    if not differences:
        raise MeasurementError(
            f"{len(windows)} valid windows of {windows[0].samples} samples are too few for a noise estimate. "
            "Use more or longer windows"
        )
    squares = np.array([_mean_square(each) for each in differences.values()]) / _WHITE_RATE_FACTOR
    times = np.array(list(differences))
    counts = np.minimum([len(each) for each in differences.values()], _MAX_DIFFERENCES)
    # A rate whose differences are mostly zero changes only by its resolution.
    noise = [_mean_variance(times, square, counts) if (square > 0.0).all() else 0.0 for square in squares.T]
    sigma = np.sqrt(np.maximum(noise, _resolution_variance(windows)))
    if not (sigma > 0.0).all():
        raise MeasurementError(
            "a gyro's rate never changes. Check its column in the import map, and the gyro"
        )
    return np.asarray(sigma)


def _mean_variance(times: FloatArray, squares: FloatArray, counts: NDArray[np.intp]) -> float:
    """Variance of the mean of a whole window, without drift.

    ``times`` (n,) are ascending averaging times in windows, ``squares`` the mean squares of the second
    differences as variances of white noise, ``counts`` the numbers of differences, used as weights.
    """
    weights = np.sqrt(counts) / squares
    # Second differences of a curved drift grow as the square of the time, their squares as its fourth power.
    powers = (-2.0, -1.0, 0.0, 4.0) if len(times) > 3 else (-2.0, -1.0, 0.0)
    design = times[:, np.newaxis] ** powers
    terms, _ = nnls(design * weights[:, np.newaxis], squares * weights)
    if len(times) > 2 and squares[-1] > design[-1] @ terms * (1.0 + _DRIFT_TOLERANCE / np.sqrt(counts[-1])):
        return _mean_variance(times[:-1], squares[:-1], counts[:-1])
    angle, rate, instability = terms[:3]
    return float(2.0 * _WHITE_RATE_FACTOR / _WHITE_ANGLE_FACTOR * angle + rate + instability)


def _differences_within(windows: Sequence[Window]) -> Iterator[tuple[float, FloatArray]]:
    """Averaging time in windows, and second differences of means over it, for each part of a window."""
    finest = min(len(each.blocks_dph) for each in windows)
    for count in BLOCKS:
        if count <= finest:
            means = np.array([each.blocks_dph.reshape(count, -1, 3).mean(axis=1) for each in windows])
            yield 1.0 / count, np.diff(means, n=2, axis=1).reshape(-1, 3)


def _differences_between(logs: Sequence[Sequence[Window]]) -> FloatArray:
    """Second differences of the means of three consecutive windows."""
    triples = [
        first.rate_dph - 2.0 * middle.rate_dph + last.rate_dph
        for log in logs
        for first, middle, last in zip(log, log[1:], log[2:], strict=False)
        if first.end_s == middle.start_s and middle.end_s == last.start_s
    ]
    return np.array(triples).reshape(-1, 3)


def _mean_square(differences: FloatArray) -> FloatArray:
    """Mean square by column without outliers beyond three standard deviations."""
    squares = differences**2
    limit = 9.0 * np.median(squares, axis=0) / _MEDIAN_SQUARE
    return np.asarray(
        np.nanmean(np.where(squares <= limit, squares, np.nan), axis=0) / _TRUNCATED_MEAN_SQUARE
    )


def _resolution_variance(windows: Sequence[Window]) -> FloatArray:
    """Variance of a window's mean rate due to the resolution, shape (3,)."""
    step = np.min([each.rate_step_dph for each in windows], axis=0)
    step = np.where(np.isfinite(step), step, 0.0)
    scatter = np.median([each.scatter_dph for each in windows], axis=0)
    samples = float(np.median([each.samples for each in windows]))
    # Steps average out if the noise exceeds them.
    return np.asarray(step**2 / 12.0 / np.where(scatter >= 0.5 * step, samples, 1.0))
