"""Thermal sensitivities of a bias: to temperature, to its rate of change, and hysteresis.

    ``b = constant + d t + sum a_k (T - T0)^k + c dT/dt + h s / 2``

with T the gyro's temperature in each dwell and s its history: the state of a follower with play, +1 after
sufficient cooling and -1 after sufficient heating. The play, and the state before the first dwell, which is
not measured, are the nonlinear parameters of a ``profile_fit``. Each power cycle and each position has a
constant; the drift d is common to all. The temperature sensitivity is the slope at T0. The hysteresis is the
bias after cooling minus that after heating, at the same temperature. A lag behind the temperature in
proportion to its rate, as by a gradient, is part of the ramp sensitivity.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.error_split import NONE_SHARED, SharedErrors
from gyrobench.bench.bias.statistics import indicator_columns
from gyrobench.bench.characteristics.profile_fit import (
    MAX_REFINEMENTS,
    ProfileFit,
    cell_widths,
    profile_fit,
    refine,
    shared_error_columns,
)
from gyrobench.bench.characteristics.results import Coefficient, Curve, TestResult, from_draws
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.kernels import follow_with_play
from gyrobench.bench.navigation.positions import AXES

#: Smallest span of temperatures, K.
_MIN_SPAN_C = 5.0
#: Initial grid of the half width of the play: smallest, K; largest, relative to the span of temperatures;
#: and number of points.
_MIN_WIDTH_C, _MAX_WIDTH, _WIDTHS = 0.2, 0.25, 25
#: Histories before the first dwell that are tested.
_STARTS = np.array([-1.0, 0.0, 1.0])
#: Turning points between dwells, which are not measured, as shares of the extrapolation by the rates; all are
#: tested.
_OVERSHOOT_SHARES = (0.0, 0.1, 0.3, 1.0)
#: Temperature change, K, from which a dwell after heating counts as cooling.
_REVERSAL_C = 1.0
#: Number of points of a dwell at which the history is computed.
_POINTS = 7
#: Correlation above which two sensitivities are inseparable.
_MAX_CORRELATION = 0.95
#: Smallest share of the variance due to independent errors of the dwells without a note.
_MIN_OWN_SHARE = 0.5


def thermal_sensitivity(
    rows: Sequence[DwellRow], reference_c: float | None, degree: int, shared: SharedErrors = NONE_SHARED
) -> TestResult:
    """Thermal sensitivities from dwells over temperature, heating and cooling, on ramps and after soaks.

    ``reference_c``: T0; default: the middle of each gyro's temperature range. ``degree``: of the polynomial
    in temperature. ``shared``: errors due to accelerometers that follow the temperature. Raises
    MeasurementError if there are too few dwells or temperatures.
    """
    good = sorted((row for row in rows if not row.flags), key=lambda row: row.start_s)
    constants = _constants(good)
    durations_s = np.array([row.end_s - row.start_s for row in good])
    offsets_s = np.linspace(-0.5, 0.5, _POINTS) * durations_s[:, np.newaxis]  # from the middle of each dwell
    coefficients: list[Coefficient] = []
    curves, notes, references_c = [], [], []
    for axis, gyro in enumerate(AXES):
        temperature, rate, bias, sigma = (
            np.array([getattr(row, name)[axis] for row in good])
            for name in ("gyro_c", "gyro_rate_c_per_h", "bias_dph", "sigma_dph")
        )
        span_c = float(np.ptp(temperature)) if good else 0.0
        if span_c < _MIN_SPAN_C:
            raise MeasurementError(
                f"the temperatures of the {gyro} gyro span {span_c:.1f} K; thermal sensitivities need "
                f"{_MIN_SPAN_C:g} K or more"
            )
        middle_c = 0.5 * (temperature.min() + temperature.max())
        references_c.append(middle_c if reference_c is None else reference_c)
        powers = (temperature - references_c[-1])[:, np.newaxis] ** np.arange(1, degree + 1)
        linear = np.column_stack([powers, rate / 60.0])
        path_c = temperature[:, np.newaxis] + rate[:, np.newaxis] / 3600.0 * offsets_s
        path_c = _with_turning_points(path_c, rate / 3600.0, good)
        fit = _fit(bias, sigma, linear, path_c, constants, shared_error_columns(shared, good, axis))
        names = (
            ("temperature sensitivity", "deg/h/degC", 0),
            ("ramp sensitivity", "deg/h/(degC/min)", degree),
            ("hysteresis", "deg/h", degree + 1),
        )
        coefficients += [
            from_draws(gyro, name, unit, fit.coefficients[index], fit.draws[:, index])
            for name, unit, index in names
        ]
        notes += _notes(gyro, fit, degree)
        offset = constants @ fit.coefficients[degree + 2 :]
        parts = _parts(good, temperature)
        curves.append(Curve.of(gyro, temperature, bias - offset, sigma, fit.fitted - offset, parts))
    at_c = ", ".join(f"{each:.1f}" for each in dict.fromkeys(references_c))
    notes.insert(0, f"The temperature sensitivities are those at {at_c} degC.")
    return TestResult(test="thermal_sensitivity", coefficients=coefficients, curves=curves, notes=notes)


def _constants(rows: Sequence[DwellRow]) -> FloatArray:
    """Columns (n, k) for a constant of each power cycle, of each position except one, and for the drift."""
    if not rows:
        return np.zeros((0, 1))
    power_cycles = indicator_columns([row.run for row in rows])
    positions = indicator_columns([row.position for row in rows])[:, 1:]
    start_h = np.array([row.start_s for row in rows]) / 3600.0
    return np.column_stack([power_cycles, positions, start_h - start_h.mean()])


def _with_turning_points(path_c: FloatArray, rates: FloatArray, rows: Sequence[DwellRow]) -> FloatArray:
    """Add possible extremes before and after each dwell: temperatures (f, n, 2 + p) of f histories.

    If the temperature turned between two dwells, their rates, K/s, bound the turning point: it is at most the
    intersection of their lines, or their extrapolation to half of the time between. With a lag, or after a
    soak, the temperature turned earlier.
    """
    extrapolated_c = np.zeros((len(path_c), 2))
    gap_s = np.array([after.start_s - row.end_s for row, after in pairwise(rows)])
    leaving, arriving, step_c = rates[:-1], rates[1:], path_c[1:, 0] - path_c[:-1, -1]
    opposite = leaving * arriving < 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        meeting_s = np.clip((step_c - arriving * gap_s) / (leaving - arriving), 0.0, gap_s)
    turning_s = np.where(opposite, meeting_s, 0.5 * gap_s)
    extrapolated_c[:-1, 1] = np.where(opposite | (leaving * step_c < 0.0), leaving * turning_s, 0.0)
    extrapolated_c[1:, 0] = np.where(
        opposite | (arriving * step_c < 0.0), -arriving * (gap_s - turning_s), 0.0
    )
    shares = _OVERSHOOT_SHARES if np.abs(extrapolated_c).max(initial=0.0) > _MIN_WIDTH_C else (0.0,)
    ends_c = path_c[:, [0, -1]]
    extremes_c = [ends_c + share * extrapolated_c for share in shares]
    return np.array([np.column_stack([each[:, 0], path_c, each[:, 1]]) for each in extremes_c])


def _fit(
    bias: FloatArray,
    sigma: FloatArray,
    linear: FloatArray,
    path_c: FloatArray,
    constants: FloatArray,
    shared: FloatArray | None,
) -> ProfileFit:
    """Fit with each play and each history before the first dwell.

    ``path_c`` (f, n, 2 + p): temperatures of f histories, in each dwell and at the extremes before and after.
    """
    span_c = float(np.ptp(path_c[0, :, 1:-1].mean(axis=1)))
    histories = len(path_c) * len(_STARTS)
    grid = np.linspace(np.log(_MIN_WIDTH_C), np.log(_MAX_WIDTH * span_c), _WIDTHS)
    for _ in range(MAX_REFINEMENTS):
        widths_c, starts = np.repeat(np.exp(grid), len(_STARTS)), np.tile(_STARTS, len(grid))
        states = [_play_state(each.ravel(), widths_c, starts).reshape(-1, *each.shape) for each in path_c]
        means = np.stack(states, axis=1)[..., 1:-1].mean(axis=3).reshape(-1, path_c.shape[1])
        designs = np.array([np.column_stack([linear, 0.5 * each, constants]) for each in means])
        shares = np.repeat(cell_widths(grid), histories)
        fit = profile_fit(bias, sigma, designs, shared=shared, shares=shares)
        refined_grid = refine(grid, fit.weights.reshape(-1, histories).sum(axis=1))
        if len(refined_grid) == len(grid):
            break
        grid = refined_grid
    return fit


def _notes(gyro: str, fit: ProfileFit, degree: int) -> list[str]:
    """Notes on limitations: shared errors, inseparable coefficients, scatter."""
    pair = fit.draws[:, degree : degree + 2]
    shared_part = fit.shared @ np.linalg.lstsq(fit.shared, pair - pair.mean(axis=0))[0]
    own_covariance = np.cov(pair - shared_part, rowvar=False)
    correlation = float(own_covariance[0, 1] / np.sqrt(own_covariance[0, 0] * own_covariance[1, 1]))
    notes = []
    if own_covariance[0, 0] < _MIN_OWN_SHARE * pair[:, 0].var():
        notes.append(
            f"{gyro.upper()} gyro: accelerometers that follow the temperature make most of the "
            "uncertainty of its ramp sensitivity (ins.uncertainty.accelerometer_slope_ug_per_c). Measure "
            "with this gyro vertical, where they do not act, or declare the slope of this unit."
        )
    if abs(correlation) > _MAX_CORRELATION:
        notes.append(
            f"{gyro.upper()} gyro: ramp sensitivity and hysteresis are inseparable in these dwells "
            f"(correlation {correlation:.2f}). Measure on ramps of two rates and after soaks."
        )
    if fit.scale > 1.5:
        notes.append(
            f"{gyro.upper()} gyro: the dwells scatter {fit.scale:.1f} times their uncertainties; the "
            "intervals include this, but something else acts on the bias. Try gyrobench close."
        )
    return notes


def _parts(rows: Sequence[DwellRow], temperature: FloatArray) -> list[str]:
    """Part of the temperature profile of each dwell: heating or cooling, and the cycle."""
    is_cooling = _play_state(temperature, np.array([_REVERSAL_C]), np.zeros(1))[0] > 0.0
    return [
        f"{'cooling' if cooling else 'heating'}, cycle {row.cycle}"
        for cooling, row in zip([is_cooling[1], *is_cooling[1:]], rows, strict=True)
    ]


def _play_state(temperature_c: FloatArray, half_widths_c: FloatArray, starts: FloatArray) -> FloatArray:
    """Histories (d, n) of temperatures in the order of time, for each play and initial history (d,).

    -1 after sufficient heating, +1 after sufficient cooling.
    """
    courses_c = np.tile(temperature_c, (len(starts), 1))
    followers_c = follow_with_play(courses_c, half_widths_c, temperature_c[0] + starts * half_widths_c)
    return (followers_c - courses_c) / half_widths_c[:, np.newaxis]
