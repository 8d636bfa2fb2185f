"""Thermal sensitivities of a bias: to temperature, to its rate of change, and hysteresis.

    ``b = constant + d t + sum a_k (T - T0)^k + c dT/dt + h s / 2``

with T the gyro's temperature in each dwell and s its history: a follower with play, +1 after enough cooling
and -1 after enough heating. Its play and its state before the first dwell, which no dwell shows, are the
nonlinear parameters of a ``profile_fit``. Each power cycle and
each position has a constant, all a common drift d. The temperature sensitivity is the slope at T0; the
hysteresis is the bias after cooling less that after heating, at one temperature. What lags behind the
temperature in proportion to its rate, as a gradient does, is in the ramp sensitivity.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.error_split import NONE_SHARED, SharedErrors
from gyrobench.bench.characteristics.profile_fit import (
    MAX_REFINEMENTS,
    ProfileFit,
    cells,
    indicators,
    profile_fit,
    refined,
    shared_by,
)
from gyrobench.bench.characteristics.results import Coefficient, Curve, TestResult, from_draws
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import AXES

#: Smallest span of temperatures, K.
_MIN_SPAN_C = 5.0
#: Half widths of the play from which their grid is refined, K; the largest relative to the span of
#: temperatures.
_MIN_WIDTH_C, _MAX_WIDTH, _WIDTHS = 0.2, 0.25, 25
#: Histories before the first dwell that are tried.
_STARTS = np.array([-1.0, 0.0, 1.0])
#: Shares of the way that rates lead to between dwells, to turning points that no dwell shows; all are tried.
_REACHED = (0.0, 0.1, 0.3, 1.0)
#: Change, K, by which a temperature that was heated begins to be cooled.
_REVERSAL_C = 1.0
#: Points of a dwell at which the history is followed.
_POINTS = 7
#: Correlation above which two sensitivities are inseparable.
_MAX_CORRELATION = 0.95
#: Smallest share of the dwells' own errors in a variance that they dominate.
_MIN_OWN = 0.5


def thermal_sensitivity(
    rows: Sequence[DwellRow], reference_c: float | None, degree: int, shared: SharedErrors = NONE_SHARED
) -> TestResult:
    """Thermal sensitivities from dwells over temperature, heating and cooling, on ramps and after soaks.

    ``reference_c``: T0; by default the middle of each gyro's temperatures. ``degree``: of the polynomial in
    temperature. ``shared``: by accelerometers that follow the temperature. Raises MeasurementError if there
    are too few dwells or temperatures.
    """
    good = sorted((row for row in rows if not row.flags), key=lambda row: row.start_s)
    constants = _constants(good)
    lasted_s = np.array([row.end_s - row.start_s for row in good])
    away_s = np.linspace(-0.5, 0.5, _POINTS) * lasted_s[:, np.newaxis]  # from the middle of each dwell
    coefficients: list[Coefficient] = []
    curves, notes, zeros_c = [], [], []
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
        zeros_c.append(middle_c if reference_c is None else reference_c)
        powers = (temperature - zeros_c[-1])[:, np.newaxis] ** np.arange(1, degree + 1)
        linear = np.column_stack([powers, rate / 60.0])
        path_c = temperature[:, np.newaxis] + rate[:, np.newaxis] / 3600.0 * away_s
        path_c = _with_turning_points(path_c, rate / 3600.0, good)
        fit = _fit(bias, sigma, linear, path_c, constants, shared_by(shared, good, axis))
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
    at_c = ", ".join(f"{each:.1f}" for each in dict.fromkeys(zeros_c))
    notes.insert(0, f"The temperature sensitivities are those at {at_c} degC.")
    return TestResult(test="thermal_sensitivity", coefficients=coefficients, curves=curves, notes=notes)


def _constants(rows: Sequence[DwellRow]) -> FloatArray:
    """Columns (n, k) of the constant of each power cycle and of each position but one, and of the drift."""
    if not rows:
        return np.zeros((0, 1))
    power_cycles = indicators([row.run for row in rows])
    positions = indicators([row.position for row in rows])[:, 1:]
    begun_h = np.array([row.start_s for row in rows]) / 3600.0
    return np.column_stack([power_cycles, positions, begun_h - begun_h.mean()])


def _with_turning_points(path_c: FloatArray, rates: FloatArray, rows: Sequence[DwellRow]) -> FloatArray:
    """Temperatures (f, n, 2 + p) with what the gyro may have reached between dwells, in f ways.

    Where the temperature turned between two dwells their rates, K/s, bound the turning point: the lines
    through them meet there, or lead away for half of the time between. A gyro with lag, or one that soaked,
    turned earlier.
    """
    away_c = np.zeros((len(path_c), 2))
    gap_s = np.array([after.start_s - row.end_s for row, after in pairwise(rows)])
    leaving, arriving, step_c = rates[:-1], rates[1:], path_c[1:, 0] - path_c[:-1, -1]
    opposite = leaving * arriving < 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        meeting_s = np.clip((step_c - arriving * gap_s) / (leaving - arriving), 0.0, gap_s)
    until_s = np.where(opposite, meeting_s, 0.5 * gap_s)
    away_c[:-1, 1] = np.where(opposite | (leaving * step_c < 0.0), leaving * until_s, 0.0)
    away_c[1:, 0] = np.where(opposite | (arriving * step_c < 0.0), -arriving * (gap_s - until_s), 0.0)
    shares = _REACHED if np.abs(away_c).max(initial=0.0) > _MIN_WIDTH_C else (0.0,)
    ends_c = path_c[:, [0, -1]]
    reached_c = [ends_c + share * away_c for share in shares]
    return np.array([np.column_stack([each[:, 0], path_c, each[:, 1]]) for each in reached_c])


def _fit(
    bias: FloatArray,
    sigma: FloatArray,
    linear: FloatArray,
    path_c: FloatArray,
    constants: FloatArray,
    shared: FloatArray | None,
) -> ProfileFit:
    """Fit with each play and history before the dwells; ``path_c`` (f, n, 2 + p): temperatures.

    Those of each of f histories, in each dwell and of the turning points before and after it.
    """
    span_c = float(np.ptp(path_c[0, :, 1:-1].mean(axis=1)))
    kinds = len(path_c) * len(_STARTS)
    grid = np.linspace(np.log(_MIN_WIDTH_C), np.log(_MAX_WIDTH * span_c), _WIDTHS)
    for _ in range(MAX_REFINEMENTS):
        widths_c, starts = np.repeat(np.exp(grid), len(_STARTS)), np.tile(_STARTS, len(grid))
        states = [_play_state(each.ravel(), widths_c, starts).reshape(-1, *each.shape) for each in path_c]
        means = np.stack(states, axis=1)[..., 1:-1].mean(axis=3).reshape(-1, path_c.shape[1])
        designs = np.array([np.column_stack([linear, 0.5 * each, constants]) for each in means])
        shares = np.repeat(cells(grid), kinds)
        fit = profile_fit(bias, sigma, designs, shared=shared, shares=shares)
        finer = refined(grid, fit.weights.reshape(-1, kinds).sum(axis=1))
        if len(finer) == len(grid):
            break
        grid = finer
    return fit


def _notes(gyro: str, fit: ProfileFit, degree: int) -> list[str]:
    """What limits the sensitivities of a gyro: shared errors, coefficients that are alike, scatter."""
    pair = fit.draws[:, degree : degree + 2]
    by_shared = fit.shared @ np.linalg.lstsq(fit.shared, pair - pair.mean(axis=0))[0]
    own = np.cov(pair - by_shared, rowvar=False)
    correlation = float(own[0, 1] / np.sqrt(own[0, 0] * own[1, 1]))
    notes = []
    if own[0, 0] < _MIN_OWN * pair[:, 0].var():
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
    """Part of the temperature profile that each dwell belongs to."""
    is_cooling = _play_state(temperature, np.array([_REVERSAL_C]), np.zeros(1))[0] > 0.0
    return [
        f"{'cooling' if cooling else 'heating'}, cycle {row.cycle}"
        for cooling, row in zip([is_cooling[1], *is_cooling[1:]], rows, strict=True)
    ]


def _play_state(temperature_c: FloatArray, half_widths_c: FloatArray, starts: FloatArray) -> FloatArray:
    """Histories (d, n) of temperatures in the order of time, for each play and history at the begin (d,).

    -1 after enough heating, +1 after enough cooling.
    """
    states = np.empty((len(starts), len(temperature_c)))
    follower_c = temperature_c[:1] + starts * half_widths_c
    for index, value_c in enumerate(temperature_c):
        follower_c = np.clip(follower_c, value_c - half_widths_c, value_c + half_widths_c)
        states[:, index] = (follower_c - value_c) / half_widths_c
    return states
