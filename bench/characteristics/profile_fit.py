"""Warm-up and thermal sensitivities: least squares with one nonlinear parameter on a grid.

For each value of the nonlinear parameter (a time constant, a width) the other coefficients are linear. The
likelihood of the values, each with its best coefficients, weighs them; draws take a value by its weight and
coefficients from the normal distribution of its fit. Quantities that follow from all of these get their
intervals from the draws, also where they are no linear function of the coefficients.

The thermal sensitivities of a bias are to temperature, to its rate of change, and hysteresis:

    ``b = constant + d t + sum a_k (T - T0)^k + c dT/dt + h s / 2``

with T the gyro's temperature in each dwell and s its history: a follower with play, +1 after enough cooling
and -1 after enough heating. Its play is the nonlinear parameter. Each power cycle and each position has a
constant, all a common drift d. The temperature sensitivity is the slope at T0; the hysteresis is the bias
after cooling less that after heating, at one temperature. What lags behind the temperature in proportion to
its rate, as a gradient does, is in the ramp sensitivity.

In the warm-up, the bias after power-on is a constant and one or two exponentials, between which the data
decide: both have the weight of their likelihood with the penalty of the Bayesian information criterion. Each
dwell counts with the mean of the exponentials over its time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.error_split import NONE_SHARED, SharedErrors
from gyrobench.bench.characteristics.results import Coefficient, Curve, TestResult, from_draws
from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import AXES

_DRAWS = 2000
#: Normal equations with a larger condition number do not separate their coefficients.
_MAX_CONDITION = 1e12
_TINY = 1e-300


@dataclass(frozen=True, eq=False)
class _ProfileFit:
    """The best of several linear fits to the same values, and draws over all of them."""

    best: int  #: Index of the best design.
    coefficients: FloatArray  #: Shape (k,). Its coefficients.
    fitted: FloatArray  #: Shape (n,). Values of the best fit.
    scale: float  #: Factor on the standard uncertainties that explains the scatter; 1 or more.
    designs: IntArray  #: Shape (m,). Index of the design of each draw.
    draws: FloatArray  #: Shape (m, k). Coefficients of each draw.
    shared: FloatArray  #: Shape (m, s). Shared errors of each draw, in standard uncertainties.


def _profile_fit(
    values: FloatArray,
    sigmas: FloatArray,
    designs: FloatArray,
    penalties: FloatArray | None = None,
    shared: FloatArray | None = None,
) -> _ProfileFit:
    """Fit values (n,) with standard uncertainties (n,) by each of the designs (d, n, k).

    A design lacks a coefficient whose column is zero. ``penalties`` (d,) are added to each design's chi2 in
    comparisons. ``shared`` (n, s): errors of all values by one standard uncertainty of each of s sources,
    part of ``sigmas``. Raises MeasurementError if there are too few values, or no design separates its
    coefficients.
    """
    (count, size), sources = designs.shape[1:], 0 if shared is None else shared.shape[1]
    dof = count - size - 1
    if dof < 1:
        raise MeasurementError(
            f"{count} dwells without flags are too few for {count - dof} parameters. Measure more dwells"
        )
    if shared is not None:
        # Shared errors are further parameters, each known to be 0 ± 1.
        known = np.hstack([np.zeros((sources, size)), np.eye(sources)])
        designs = np.array([np.vstack([np.hstack([each, shared]), known]) for each in designs])
        own = np.sqrt(np.maximum(sigmas**2 - (shared**2).sum(axis=1), _TINY))
        values, sigmas = np.append(values, np.zeros(sources)), np.append(own, np.ones(sources))
    white, target = designs / sigmas[:, np.newaxis], values / sigmas
    sizes = np.sqrt((white**2).sum(axis=1))
    unit = np.eye(designs.shape[2])
    # A coefficient that is lacking is zero for sure: one on the diagonal, and no size.
    normal = np.swapaxes(white, 1, 2) @ white / np.maximum(sizes[:, :, None] * sizes[:, None], _TINY)
    normal = np.where(sizes[:, :, None] > 0.0, normal, unit)
    spread = np.linalg.eigvalsh(normal)
    separable = spread[:, 0] * _MAX_CONDITION > spread[:, -1]
    if not separable.any():
        raise MeasurementError(
            "the dwells do not separate the coefficients of this test. Vary what they depend on: "
            "temperature, its rate and direction, time since power-on"
        )
    inverse = np.zeros_like(normal)
    inverse[separable] = np.linalg.inv(normal[separable])
    shrink = np.where(sizes > 0.0, 1.0 / np.maximum(sizes, _TINY), 0.0)
    covariance = inverse * shrink[:, :, None] * shrink[:, None]
    solved = (covariance @ (np.swapaxes(white, 1, 2) @ target)[:, :, None])[:, :, 0]
    chi2 = ((target - (white @ solved[:, :, None])[:, :, 0]) ** 2).sum(axis=1)
    deviance = np.where(separable, chi2 if penalties is None else chi2 + penalties, np.inf)
    best = int(np.argmin(deviance))
    scale = float(np.sqrt(max(1.0, chi2[best] / dof)))
    weights = np.exp(-0.5 * (deviance - deviance[best]) / scale**2)
    random = np.random.default_rng(0)  # the same data give the same intervals
    chosen = np.sort(random.choice(len(designs), _DRAWS, p=weights / weights.sum()))
    draws = scale * random.standard_normal((_DRAWS, len(unit)))
    for index in np.unique(chosen):
        rows = chosen == index
        root = np.linalg.cholesky(inverse[index]) * shrink[index][:, None]
        draws[rows] = solved[index] + draws[rows] @ root.T
    coefficients = solved[best, :size]
    return _ProfileFit(
        best,
        coefficients,
        designs[best, :count, :size] @ coefficients,
        scale,
        chosen,
        *np.split(draws, [size], 1),
    )


def indicators(groups: Sequence[object]) -> FloatArray:
    """Columns (n, g) of ones and zeros, one for each different group in the order of appearance."""
    names = list(dict.fromkeys(groups))
    return np.array([[float(group == name) for name in names] for group in groups])


#: Smallest span of temperatures, K.
_MIN_SPAN_C = 5.0
#: Half widths of the play that are tried, K; the largest relative to the span of temperatures.
_NARROWEST_C, _WIDEST, _WIDTHS = 0.2, 0.25, 25
#: Change, K, by which a temperature that was heated begins to be cooled.
_REVERSAL_C = 1.0
#: Points of a dwell at which the history is followed.
_POINTS = 7
#: Correlation above which two sensitivities are inseparable.
_MAX_CORRELATION = 0.95
#: Smallest share of the dwells' own errors in a variance that they dominate.
_MIN_OWN = 0.5


def _shared_by(shared: SharedErrors, rows: Sequence[DwellRow], axis: int) -> FloatArray | None:
    return np.array([shared[row.dwell][axis] for row in rows]) if shared else None


def thermal_sensitivity(
    rows: Sequence[DwellRow], reference_c: float | None, degree: int, shared: SharedErrors = NONE_SHARED
) -> TestResult:
    """Thermal sensitivities from dwells over temperature, heating and cooling, on ramps and after soaks.

    ``reference_c``: T0; by default the middle of each gyro's temperatures. ``degree``: of the polynomial in
    temperature. ``shared``: by accelerometers that follow the temperature. Raises MeasurementError if there
    are too few dwells or temperatures.
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
        states = [_play_state(path_c.ravel(), each).reshape(path_c.shape).mean(axis=1) for each in widths]
        designs = np.array([np.column_stack([linear, 0.5 * state, constants]) for state in states])
        fit = _profile_fit(bias, sigma, designs, shared=_shared_by(shared, good, axis))
        zeros_c.append(zero_c)
        names = (
            ("temperature sensitivity", "deg/h/degC", 0),
            ("ramp sensitivity", "deg/h/(degC/min)", degree),
            ("hysteresis", "deg/h", degree + 1),
        )
        coefficients += [
            from_draws(gyro, name, unit, fit.coefficients[index], fit.draws[:, index])
            for name, unit, index in names
        ]
        pair = fit.draws[:, degree : degree + 2]
        by_shared = fit.shared @ np.linalg.lstsq(fit.shared, pair - pair.mean(axis=0))[0]
        own = np.cov(pair - by_shared, rowvar=False)
        correlation = float(own[0, 1] / np.sqrt(own[0, 0] * own[1, 1]))
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
        offset = constants @ fit.coefficients[degree + 2 :]
        is_cooling = _play_state(temperature, _REVERSAL_C) > 0.0
        parts = [
            f"{'cooling' if cooling else 'heating'}, cycle {row.cycle}"
            for cooling, row in zip([is_cooling[1], *is_cooling[1:]], good, strict=True)
        ]
        curves.append(Curve.of(gyro, temperature, bias - offset, sigma, fit.fitted - offset, parts))
    at_c = ", ".join(f"{each:.1f}" for each in dict.fromkeys(zeros_c))
    notes.insert(0, f"The temperature sensitivities are those at {at_c} degC.")
    return TestResult(test="thermal_sensitivity", coefficients=coefficients, curves=curves, notes=notes)


def _play_state(temperature_c: FloatArray, half_width_c: float) -> FloatArray:
    """History (n,) of temperatures in the order of time: -1 after enough heating, +1 after enough cooling."""
    states = np.empty(len(temperature_c))
    follower_c = temperature_c[0] if len(states) else 0.0
    for index, value_c in enumerate(temperature_c):
        follower_c = min(max(follower_c, value_c - half_width_c), value_c + half_width_c)
        states[index] = (follower_c - value_c) / half_width_c
    return states


_TIME_CONSTANTS = 25
#: Dwells beyond the constants from which two exponentials are fitted.
_DWELLS_FOR_TWO = 8
#: Smallest ratio of two time constants.
_APART = 3.0
#: Shortest and longest time constant, relative to the time from power-on to the first and the last dwell.
_SHORTEST, _LONGEST = 0.5, 1.0
#: Times at which settling is looked for, and how far beyond the last dwell.
_TIMES, _BEYOND = 200, 2.0


def warm_up(rows: Sequence[DwellRow], within_dph: float, shared: SharedErrors = NONE_SHARED) -> TestResult:
    """Warm-up from dwells after one or more cold starts, each with a constant.

    ``within_dph``: a gyro has settled when its bias is this near to its final value. ``shared``: see
    :func:`thermal_sensitivity`. Raises MeasurementError if there are too few dwells.
    """
    good = sorted((row for row in rows if not row.flags), key=lambda row: row.since_power_on_s)
    start_s = np.array([row.since_power_on_s for row in good])
    end_s = start_s + np.array([row.end_s - row.start_s for row in good])
    if not good:
        raise MeasurementError("0 dwells without flags are too few. Measure more dwells")
    positions = indicators([row.position for row in good])[:, 1:]
    offsets = np.hstack([indicators([row.run for row in good]), positions])
    coefficients: list[Coefficient] = []
    curves, notes = [], []
    for axis, gyro in enumerate(AXES):
        bias = np.array([row.bias_dph[axis] for row in good])
        sigma = np.array([row.sigma_dph[axis] for row in good])
        fit, time_constants = _fit(bias, sigma, offsets, start_s, end_s, _shared_by(shared, good, axis))
        own, note = _of_gyro(gyro, fit, time_constants, offsets.shape[1], start_s, end_s, within_dph)
        coefficients += own
        notes += note
        settled = bias - offsets @ fit.coefficients[: offsets.shape[1]]
        model = fit.fitted - offsets @ fit.coefficients[: offsets.shape[1]]
        middle_h = 0.5 * (start_s + end_s) / 3600.0
        curves.append(Curve.of(gyro, middle_h, settled, sigma, model))
    return TestResult(test="warm_up", coefficients=coefficients, curves=curves, notes=notes)


def _fit(
    bias: FloatArray,
    sigma: FloatArray,
    offsets: FloatArray,
    start_s: FloatArray,
    end_s: FloatArray,
    shared: FloatArray | None,
) -> tuple[_ProfileFit, FloatArray]:
    """Fit of one or two exponentials, and the time constants (g, 2) of its designs."""
    grid = (
        np.geomspace(_SHORTEST * max(start_s.min(), 30.0), _LONGEST * end_s.max(), _TIME_CONSTANTS)
        if len(bias)
        else np.ones(1)
    )
    decays = [_mean_decay(start_s, end_s, tau_s) for tau_s in grid]
    none = np.zeros(len(bias))
    pairs: list[tuple[int, int | None]] = [(i, None) for i in range(len(grid))]
    if len(bias) >= offsets.shape[1] + _DWELLS_FOR_TWO:
        pairs += [(i, j) for i, j in combinations(range(len(grid)), 2) if grid[j] > _APART * grid[i]]
    designs = np.array(
        [np.column_stack([offsets, decays[i], none if j is None else decays[j]]) for i, j in pairs]
    )
    # All pairs together weigh what all single ones do, but for the penalty of two more parameters.
    for_pair = 2.0 * np.log(max(1, len(pairs) - len(grid)) / len(grid)) + 3.0 * np.log(len(bias))
    penalties = np.array([0.0 if j is None else for_pair for _, j in pairs])
    taus = np.array([(grid[i], np.inf if j is None else grid[j]) for i, j in pairs])
    return _profile_fit(bias, sigma, designs, penalties, shared), taus


def _mean_decay(start_s: FloatArray, end_s: FloatArray, tau_s: float | FloatArray) -> FloatArray:
    """Mean of exp(-t / tau) from start to end; 1 for an infinite time constant."""
    spans = np.maximum((end_s - start_s) / tau_s, 1e-9)
    return np.asarray(np.exp(-start_s / tau_s) * -np.expm1(-spans) / spans)


def _of_gyro(
    gyro: str,
    fit: _ProfileFit,
    time_constants: FloatArray,
    skipped: int,
    start_s: FloatArray,
    end_s: FloatArray,
    within_dph: float,
) -> tuple[list[Coefficient], list[str]]:
    last_s = float(end_s.max())
    taus = np.vstack([time_constants[fit.best], time_constants[fit.designs]])
    sizes = np.vstack([fit.coefficients[skipped:], fit.draws[:, skipped:]])
    times = np.linspace(0.0, _BEYOND * last_s, _TIMES)
    decayed = np.einsum("dk,dkt->dt", sizes, np.exp(-times / taus[:, :, np.newaxis]))
    outside = np.abs(decayed) > within_dph
    last = np.where(outside.any(axis=1), _TIMES - np.argmax(outside[:, ::-1], axis=1), 0)
    settled_s = np.where(last >= _TIMES, np.inf, times[np.minimum(last, _TIMES - 1)])
    settled_s[settled_s > last_s] = np.inf
    decays = sizes * _mean_decay(start_s[:1], end_s[:1], taus)
    drop = decays.sum(axis=1)
    larger = np.argmax(np.abs(decays), axis=1)[:, np.newaxis]
    tau_s = np.take_along_axis(taus, larger, axis=1)[:, 0]
    found = [
        from_draws(gyro, "first bias less final bias", "deg/h", drop[0], drop[1:]),
        from_draws(gyro, "time constant", "s", tau_s[0], tau_s[1:]),
        from_draws(gyro, f"time until within {within_dph:g} deg/h", "s", settled_s[0], settled_s[1:]),
    ]
    drop_low, drop_high = found[0].low, found[0].high
    if drop_low is not None and drop_high is not None and drop_low <= 0.0 <= drop_high:
        return found[:1], [f"{gyro.upper()} gyro: no warm-up is significant."]
    notes = []
    if found[2].value is None:
        notes.append(f"{gyro.upper()} gyro: not settled within {last_s / 3600.0:.2g} h. Measure for longer.")
    if fit.scale > 1.5:
        notes.append(
            f"{gyro.upper()} gyro: the dwells scatter {fit.scale:.1f} times their uncertainties; the "
            "intervals include this."
        )
    return found, notes
