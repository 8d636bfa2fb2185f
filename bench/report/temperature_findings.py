"""Sentences about implausible temperatures of the gyros, the same in report and terminal.

The settled dwells show sensors with a wrong unit, a wrong scale, or an offset far beyond the self-heating.
The readings of the bench between the dwells show more about a single sensor:

* When a unit is switched on that has the temperature of the chamber's air, all its sensors must agree.
* Three gyros of one unit follow the chamber alike. One that stays behind the others on all ramps is mounted
  differently, or its sensor lags; one that changes by another share in settled air has a wrong sensor.
* Heat that the electronics of a gyro lose to its optics, more in one position than in another, warms these.
  Where the heat of each gyro's electronics arrives at the optics of another, their signals are exchanged.

A lag of all sensors and an offset in a unit that was warm at power-on leave no trace here, nor do exchanged
gyros where optics and electronics are exchanged alike, or the electronics heat several gyros.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from itertools import permutations
from typing import Any

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.foundations.arrays import S_PER_H, BoolArray, FloatArray
from gyrobench.bench.foundations.text import listed, plural
from gyrobench.bench.navigation.positions import AXES

#: Rate, K/h, below which the temperature of a gyro has settled; least number and temperature range of settled
#: dwells; plausible change of a gyro temperature for each kelvin of the chamber (0.86 to 1.06 in simulated
#: units).
_SETTLED_C_PER_H, _MIN_SETTLED, _MIN_RANGE_K, _FOLLOWING_RANGE = 12.0, 4, 20.0, (0.7, 1.3)
#: Key of the station file and its default. Optics that are warmer than their electronics by more than the
#: next value, K, are implausible (in simulated units they are at least 5 K colder). Last: largest plausible
#: excess over the declared self-heating, and largest plausible temperature below that of the air, K.
_SELF_HEATING_KEY, _DEFAULT_HEATING_K, _ABOVE_BOARD_K, _OFFSET_K = "self_heating_c", 15.0, 2.0, 5.0
#: Columns of the telemetry that :func:`sensors_sentence` reads.
SENSOR_COLUMNS = (
    "time_s", "chamber_c", *(f"{part}_{axis}_c" for part in ("gyro", "board") for axis in AXES), "case_c"
)  # fmt: skip
#: A unit is cold at power-on if all its sensors but one, and the chamber's air, agree within the first value,
#: K; fewest such temperatures; largest plausible deviation of the one, K. If the gyros agree within the first
#: value, but not with the air, the unit must have been off for the last value, s, before.
_COLD_K, _MIN_COLD, _MAX_DEVIATION_K, _COOLED_S = 1.5, 3, 2.5, 7200.0
#: Length of the blocks over which readings are averaged, and time after a power-on in which they are ignored,
#: since gyros warm up differently, s; fewest blocks, and least steady rate of ramps in some of them, K/h.
_BLOCK_S, _WARM_UP_S, _MIN_BLOCKS, _MIN_RAMP_C_PER_H = 300.0, 3600.0, 12, 8.0
#: Largest plausible differences between gyros: of their lags, h, and of the shares by which their settled
#: temperatures follow the unit's. In 180 runs of simulated units whose heat capacities and conductances
#: scatter by 10 % from gyro to gyro the largest were 0.14 h and 0.012.
_MAX_LAG_H, _MAX_SHARE = 0.2, 0.08
#: Length of the windows of the heat balance, s; fewest windows; least resolved residual, K; least ratio of
#: residuals that shows an exchange. In 64 simulated units whose gyros also heat one another it was 1.9.
_BALANCE_S, _MIN_WINDOWS, _MIN_RESIDUAL_K, _MIN_BALANCE_RATIO = 900.0, 24, 1e-3, 3.0


def temperatures_sentence(rows: Iterable[DwellRow], station: Mapping[str, Any]) -> str:
    """Implausible gyro temperatures that a wrong scale, offset or signal map explains; else empty.

    ``station``: content of the station file.
    """
    settled = [
        (row.chamber_c, *row.gyro_c, *row.board_c)  # values, not rows: rows of long runs are read one by one
        for row in rows
        if math.isfinite(row.chamber_c) and np.abs(row.gyro_rate_c_per_h).max() < _SETTLED_C_PER_H
    ]
    if len(settled) < _MIN_SETTLED:
        return ""
    chamber_c, gyro_c, board_c = np.split(np.array(settled), [1, 4], axis=1)
    declared_k = station.get("unit", {}).get("thermal", {}).get(_SELF_HEATING_KEY, _DEFAULT_HEATING_K)
    return (
        _scale_sentence(chamber_c, gyro_c)
        or _exchanged_signals_sentence(gyro_c - board_c)
        or _offset_sentence(gyro_c - chamber_c, declared_k)
    )


def _scale_sentence(chamber_c: FloatArray, gyro_c: FloatArray) -> str:
    """Gyros that do not follow the chamber. Temperatures: ``chamber_c`` (n, 1), ``gyro_c`` (n, 3)."""
    if np.ptp(chamber_c) < _MIN_RANGE_K:
        return ""
    min_slope, max_slope = _FOLLOWING_RANGE
    slopes = np.polyfit(chamber_c[:, 0], gyro_c, 1)[0]
    out_of_range = [
        f"that of the {axis} gyro by {slope:.2f} K"
        for axis, slope in zip(AXES, slopes, strict=True)
        if not min_slope < slope < max_slope
    ]
    if not out_of_range:
        return ""
    return (
        f"In settled dwells temperatures change for each kelvin of the chamber: {listed(out_of_range)}. "
        "Check scale and unit of the temperature signals in the DBC file: bins and plateaus are at wrong "
        "temperatures."
    )


def _exchanged_signals_sentence(above_board_k: FloatArray) -> str:
    """Optics that are warmer than the electronics: differences (n, 3), NaN without a signal."""
    least_k = above_board_k.min(axis=0)  # comparisons with NaN are False
    exchanged = [axis for axis, above_k in zip(AXES, least_k, strict=True) if above_k > _ABOVE_BOARD_K]
    if not exchanged:
        return ""
    return (
        f"In all settled dwells the optics are warmer than the electronics, by {np.nanmax(least_k):.1f} "
        f"K or more ({plural(len(exchanged), 'gyro', 'gyros')} {listed(exchanged)}). Unless the optics "
        "are heated, the two signals are exchanged in signal map or DBC file, and bins are at the "
        "temperatures of the electronics."
    )


def _offset_sentence(above_air_k: FloatArray, declared_k: float) -> str:
    """Gyros whose temperatures above the air (n, 3) differ far from the declared self-heating."""
    least_k, most_k = above_air_k.min(), above_air_k.max()
    if not (least_k > declared_k + _OFFSET_K or most_k < -_OFFSET_K):
        return ""
    return (
        f"In all settled dwells the gyros are {least_k:.1f} to {most_k:.1f} K above the chamber's air; "
        f"unit.thermal.{_SELF_HEATING_KEY} of the station is {declared_k:g} K. Correct it if that is so; "
        "else check the offset of the temperature signals in the DBC file and the chamber's sensor."
    )


def sensors_sentence(readings: Mapping[str, FloatArray]) -> str:
    """A gyro's temperature that contradicts the other temperatures of the unit; else empty.

    ``readings``: telemetry with :data:`SENSOR_COLUMNS`; may be empty.
    """
    if any(name not in readings for name in SENSOR_COLUMNS):
        return ""
    time_s, air_c, *sensors_c, case_c = (readings[name] for name in SENSOR_COLUMNS)
    gyro_c, board_c = np.split(np.column_stack(sensors_c), 2, axis=1)
    is_on = np.asarray(np.isfinite(gyro_c).all(axis=1))
    power_ons = np.flatnonzero(is_on & ~np.append(False, is_on[:-1]))
    for index in power_ons:
        if text := _cold_unit_sentence(gyro_c[index], case_c[index], air_c[index]) or _cooled_unit_sentence(
            gyro_c[index], _air_since_off(time_s[: index + 1], air_c, is_on)
        ):
            return (
                f"At the power-on {time_s[index] / S_PER_H:.1f} h after the start of the run {text} Check "
                "its scale and offset in the DBC file, and the sensor: bins are at wrong temperatures."
            )
    above_c = np.hstack([gyro_c, board_c]) - case_c[:, np.newaxis]
    residuals_k = _balance_residuals(time_s, above_c, case_c)
    return _exchanged_gyros_sentence(residuals_k) or _ramps_sentence(time_s, gyro_c, is_on, time_s[power_ons])


def _cold_unit_sentence(gyro_c: FloatArray, case_c: float, air_c: float) -> str:
    """A gyro (3,) that deviates from all else although the unit has the temperature of the air."""
    for index, axis in enumerate(AXES):
        others_c = np.array([*np.delete(gyro_c, index), case_c, air_c])
        others_c = others_c[np.isfinite(others_c)]
        deviation_k = gyro_c[index] - np.median(others_c)
        is_cold = np.isfinite(air_c) and len(others_c) >= _MIN_COLD and np.ptp(others_c) <= _COLD_K
        if is_cold and abs(deviation_k) > _MAX_DEVIATION_K:
            return (
                f"the unit had the temperature of the chamber's air, {air_c:.1f} degC, but the sensor of the "
                f"{axis} gyro read {gyro_c[index]:.1f} degC: it seems to be off by {deviation_k:+.1f} K."
            )
    return ""


def _air_since_off(time_s: FloatArray, air_c: FloatArray, is_on: BoolArray) -> FloatArray:
    """Air temperatures while the unit was off until the last of some times; empty if it may still be warm."""
    was_on = np.flatnonzero(is_on[: len(time_s) - 1])
    since = slice(was_on[-1] + 1 if len(was_on) else 0, len(time_s))
    since_c = air_c[since][time_s[since] > time_s[-1] - _COOLED_S]
    has_cooled = time_s[-1] - time_s[since][0] > _COOLED_S and np.isfinite(since_c).mean() > 0.5
    return since_c[np.isfinite(since_c)] if has_cooled else np.empty(0)


def _cooled_unit_sentence(gyro_c: FloatArray, air_c: FloatArray) -> str:
    """Gyros (3,) that agree, but not with the air (n,) while the unit cooled down."""
    if not len(air_c) or max(np.ptp(air_c), np.ptp(gyro_c)) > _COLD_K:
        return ""
    deviation_k = float(np.median(gyro_c) - np.median(air_c))
    if abs(deviation_k) <= _MAX_DEVIATION_K:
        return ""
    return (
        f"the unit had been off for more than {_COOLED_S / S_PER_H:.0f} h in air of "
        f"{np.median(air_c):.1f} degC, but its gyros read {np.median(gyro_c):.1f} degC: they, or the "
        f"chamber's sensor, seem to be off by {deviation_k:+.1f} K."
    )


def _ramps_sentence(time_s: FloatArray, gyro_c: FloatArray, is_on: BoolArray, power_on_s: FloatArray) -> str:
    """A gyro that follows the temperature of the unit later than the other two, or by another share."""
    block = (time_s[is_on] // _BLOCK_S).astype(int)
    numbers, places, counts = np.unique(block, return_inverse=True, return_counts=True)
    means_c = np.column_stack([np.bincount(places, each) for each in gyro_c[is_on].T]) / counts[:, np.newaxis]
    unit_c = means_c.mean(axis=1)
    is_warm = np.ones(len(numbers), bool)
    for each_s in power_on_s:
        is_warm &= ~((numbers + 1.0 > each_s / _BLOCK_S) & (numbers < (each_s + _WARM_UP_S) / _BLOCK_S))
    inner = np.flatnonzero((numbers[2:] - numbers[:-2] == 2) & is_warm[1:-1]) + 1
    rate_c_per_h = (unit_c[inner + 1] - unit_c[inner - 1]) / (2.0 * _BLOCK_S / S_PER_H)
    unit_c, deviations_k = unit_c[inner], means_c[inner] - unit_c[inner, np.newaxis]
    is_ramp = np.abs(rate_c_per_h) > _MIN_RAMP_C_PER_H
    lags_h, shares = np.zeros((2, 3))
    if _is_enough(unit_c[is_ramp]):
        design = np.column_stack([np.ones(len(unit_c)), unit_c - unit_c.mean(), -rate_c_per_h])
        lags_h = np.linalg.lstsq(design, deviations_k)[0][2]
    if _is_enough(unit_c[~is_ramp]):
        shares = np.polyfit(unit_c[~is_ramp], deviations_k[~is_ramp], 1)[0]
    lag, share = _odd_one(lags_h), _odd_one(shares)
    if lags_h[lag] - np.median(lags_h) > _MAX_LAG_H:
        behind_h = float(lags_h[lag] - np.mean(np.delete(lags_h, lag)))
        return (
            f"The temperature of the {AXES[lag]} gyro follows that of the other two about "
            f"{60.0 * behind_h:.0f} min later, up to {behind_h * np.abs(rate_c_per_h).max():.0f} K behind on "
            "ramps. Unless that gyro warms up so slowly, its sensor lags: check its mounting and filter, and "
            "measure its biases after soaks only."
        )
    if abs(shares[share] - np.median(shares)) > _MAX_SHARE:
        factor = (1.0 + shares[share]) / (1.0 + np.mean(np.delete(shares, share)))
        return (
            f"The temperature of the {AXES[share]} gyro changes by {factor:.2f} times as much as those of "
            "the other two. Check scale and unit of that temperature signal in the DBC file, and its sensor."
        )
    return ""


def _exchanged_gyros_sentence(residuals_k: FloatArray) -> str:
    """Gyros whose electronics heat the optics of another: result of :func:`_balance_residuals`."""
    gyros = np.arange(len(AXES))
    ratios = {
        order: float(
            min(residuals_k[own, own] / residuals_k[own, order[own]] for own in gyros[gyros != order])
        )
        for order in permutations(range(len(AXES)))
        if any(gyros != order)
    }
    order = max(ratios, key=lambda each: ratios[each])
    if not ratios[order] > _MIN_BALANCE_RATIO:  # also without residuals, which are NaN
        return ""
    pairs = [f"of {AXES[order[own]]} at {AXES[own]}" for own in gyros[gyros != order]]
    return (
        f"Heat that leaves the electronics arrives at the optics of another gyro: {listed(pairs)}. The "
        "temperature signals of their optics or electronics seem to be exchanged: check signal map, DBC file "
        "and harness. If it is the optics, bins and compensation are at the temperatures of another gyro."
    )


def _balance_residuals(time_s: FloatArray, above_c: FloatArray, case_c: FloatArray) -> FloatArray:
    """Residuals, K, of the heat balance of optics (row) with electronics (column), (3, 3); NaN without data.

    ``above_c``: temperatures of three optics and three electronics above that of the case, (n, 6). The heat
    that electronics and optics of one gyro together store and lose is constant, however it flows between
    them; heat capacities and conductances, also between the optics, are fitted. Weighted by a window that
    begins and ends with zero, rates become temperatures weighted by its derivative.
    """
    residuals_k = np.full((len(AXES), len(AXES)), math.nan)
    is_valid = np.isfinite(above_c).all(axis=1)
    time_s, above_c, case_c = time_s[is_valid], above_c[is_valid], case_c[is_valid]
    windows = []
    for start_s in np.arange(time_s[0], time_s[-1], 0.5 * _BALANCE_S) if len(time_s) else ():
        part = slice(*np.searchsorted(time_s, [start_s, start_s + _BALANCE_S]))
        angle = 2.0 * np.pi * (time_s[part] - start_s) / _BALANCE_S
        if len(angle) < 2 or max(angle[0], np.diff(angle).max(), 2.0 * np.pi - angle[-1]) > 0.5:
            continue
        step_s = np.gradient(time_s[part])
        weights, slopes = (1.0 - np.cos(angle)) * step_s, np.sin(angle) * step_s
        weights, slopes = weights / weights.sum(), slopes - slopes.mean()
        rates = slopes @ (above_c[part] + case_c[part, np.newaxis]) / _BALANCE_S
        windows.append(np.concatenate([weights @ above_c[part], rates]))
    if len(windows) < _MIN_WINDOWS:
        return residuals_k
    optics, electronics, optics_rate, electronics_rate = np.split(np.array(windows), 4, axis=1)
    for own, other in np.ndindex(residuals_k.shape):
        stored = np.column_stack([optics_rate[:, own], electronics_rate[:, other]])
        design = np.column_stack([np.ones(len(windows)), optics, stored])
        solution = np.linalg.lstsq(design, electronics[:, other])[0]
        rms_k = np.sqrt(np.mean((electronics[:, other] - design @ solution) ** 2))
        residuals_k[own, other] = max(rms_k, _MIN_RESIDUAL_K)
    return residuals_k


def _is_enough(unit_c: FloatArray) -> bool:
    """Whether temperatures (n,) of blocks have a sufficient range."""
    return len(unit_c) >= _MIN_BLOCKS and float(np.ptp(unit_c)) >= _MIN_RANGE_K


def _odd_one(values: FloatArray) -> int:
    """Index of the value (3,) farthest from the median."""
    return int(np.argmax(np.abs(values - np.median(values))))
