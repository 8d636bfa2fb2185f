"""Thermal sensitivities of a gyro's bias: to temperature, to its rate of change, and hysteresis.

    ``b = constant + d t + sum a_k (T - T0)^k + c dT/dt + h s / 2``

with T the gyro's temperature in each dwell and s its history: a follower with play, +1 after enough cooling
and -1 after enough heating. Its play is the nonlinear parameter. Each power cycle and each position has a
constant, all a common drift d. The temperature sensitivity is the slope at T0; the hysteresis is the bias
after cooling less that after heating, at one temperature. What lags behind the temperature in proportion to
its rate, as a gradient does, is in the ramp sensitivity.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.characteristics.profile_fit import indicators, profile_fit
from gyrobench.bench.characteristics.results import Coefficient, Curve, TestResult, interval
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import AXES

#: Smallest span of temperatures, K.
_MIN_SPAN_C = 5.0
#: Half widths of the play that are tried, K; the largest relative to the span of temperatures.
_NARROWEST_C, _WIDEST, _WIDTHS = 0.2, 0.25, 25
#: Points of a dwell at which the history is followed.
_POINTS = 7
#: Correlation above which two sensitivities are inseparable.
_MAX_CORRELATION = 0.95


def thermal_sensitivity(rows: Sequence[DwellRow], reference_c: float | None, degree: int) -> TestResult:
    """Thermal sensitivities from dwells over temperature, heating and cooling, on ramps and after soaks.

    ``reference_c``: T0; by default the middle of each gyro's temperatures. ``degree``: of the polynomial in
    temperature. Raises MeasurementError if there are too few dwells or temperatures.
    """
    good = sorted((row for row in rows if not row.flags), key=lambda row: row.start_s)
    constants = np.hstack(
        [indicators([row.run for row in good]), indicators([row.position for row in good])[:, 1:]]
        if good
        else [np.zeros((0, 1))]
    )
    if good:
        begun_h = np.array([row.start_s for row in good]) / 3600.0
        constants = np.column_stack([constants, begun_h - begun_h.mean()])
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
        zero_c = middle_c if reference_c is None else reference_c
        powers = (temperature - zero_c)[:, np.newaxis] ** np.arange(1, degree + 1)
        linear = np.column_stack([powers, rate / 60.0])
        widths = np.geomspace(_NARROWEST_C, _WIDEST * span_c, _WIDTHS)
        path_c = temperature[:, np.newaxis] + rate[:, np.newaxis] / 3600.0 * away_s
        states = [play_state(path_c.ravel(), each).reshape(path_c.shape).mean(axis=1) for each in widths]
        designs = np.array([np.column_stack([linear, 0.5 * state, constants]) for state in states])
        fit = profile_fit(bias, sigma, designs)
        zeros_c.append(zero_c)
        names = (
            ("temperature sensitivity", "deg/h/degC", 0),
            ("ramp sensitivity", "deg/h/(degC/min)", degree),
            ("hysteresis", "deg/h", degree + 1),
        )
        coefficients += [
            interval(gyro, name, unit, fit.coefficients[index], fit.draws[:, index])
            for name, unit, index in names
        ]
        correlation = float(np.corrcoef(fit.draws[:, degree], fit.draws[:, degree + 1])[0, 1])
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
        offset = constants @ fit.coefficients[degree + 2 :]
        curves.append(Curve.of(gyro, temperature, bias - offset, sigma, fit.fitted - offset))
    at_c = ", ".join(f"{each:.1f}" for each in dict.fromkeys(zeros_c))
    notes.insert(0, f"The temperature sensitivities are those at {at_c} degC.")
    return TestResult(test="thermal_sensitivity", coefficients=coefficients, curves=curves, notes=notes)


def play_state(temperature_c: FloatArray, half_width_c: float) -> FloatArray:
    """History (n,) of temperatures in the order of time: -1 after enough heating, +1 after enough cooling."""
    states = np.empty(len(temperature_c))
    follower_c = temperature_c[0] if len(states) else 0.0
    for index, value_c in enumerate(temperature_c):
        follower_c = min(max(follower_c, value_c - half_width_c), value_c + half_width_c)
        states[index] = (follower_c - value_c) / half_width_c
    return states
