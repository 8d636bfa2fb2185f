"""Warm-up: the bias of each gyro after power-on.

The model is a constant and one or two exponentials; each of the two alternatives has the weight of its
likelihood with the penalty of the Bayesian information criterion. The model of a dwell is the mean of the
exponentials over its duration. The time constants are the nonlinear parameters of a ``profile_fit``. They may
be longer than the record. Then the data show a slope and only a small curvature, which determines the rate
``1 / tau``; if that may be zero, time constant and size have no upper limit.
"""

from __future__ import annotations

from collections.abc import Sequence

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
from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import AXES

#: Number of time constants of the initial grid.
_TIME_CONSTANTS = 25
#: Fewest dwells, in addition to the number of constants, with which two exponentials are fitted.
_DWELLS_FOR_TWO = 8
#: Smallest ratio of two time constants.
_MIN_TAU_RATIO = 3.0
#: Shortest and longest time constant, relative to the time from power-on to the first and the last dwell.
_MIN_TIME_CONSTANT, _MAX_TIME_CONSTANT = 0.5, 30.0
#: The longest time constant is excluded (95 %) if twice the logarithm of its likelihood ratio is larger.
_DEVIANCE_95 = 3.841
#: Number of times at which settling is evaluated, and the last one relative to the end of the last dwell.
_TIMES, _SEARCH_FACTOR = 200, 2.0
_TINY = 1e-12


def warm_up(rows: Sequence[DwellRow], within_dph: float, shared: SharedErrors = NONE_SHARED) -> TestResult:
    """Warm-up from dwells after one or more cold starts, each with a constant.

    ``within_dph``: a gyro has settled when its bias is within this of its final value. ``shared``: errors due
    to accelerometers that follow the temperature. Raises MeasurementError if there are too few dwells.
    """
    good = sorted((row for row in rows if not row.flags), key=lambda row: row.since_power_on_s)
    start_s = np.array([row.since_power_on_s for row in good])
    end_s = start_s + np.array([row.end_s - row.start_s for row in good])
    if not good:
        raise MeasurementError("0 dwells without flags are too few. Measure more dwells")
    positions = indicator_columns([row.position for row in good])[:, 1:]
    offsets = np.hstack([indicator_columns([row.run for row in good]), positions])
    coefficients: list[Coefficient] = []
    curves, notes = [], []
    for axis, gyro in enumerate(AXES):
        bias = np.array([row.bias_dph[axis] for row in good])
        sigma = np.array([row.sigma_dph[axis] for row in good])
        fit, time_constants = _fit(
            bias, sigma, offsets, start_s, end_s, shared_error_columns(shared, good, axis)
        )
        gyro_coefficients, note = _gyro_result(
            gyro, fit, time_constants, offsets.shape[1], start_s, end_s, within_dph
        )
        coefficients += gyro_coefficients
        notes += note
        change = bias - offsets @ fit.coefficients[: offsets.shape[1]]
        model = fit.fitted - offsets @ fit.coefficients[: offsets.shape[1]]
        middle_h = 0.5 * (start_s + end_s) / 3600.0
        curves.append(Curve.of(gyro, middle_h, change, sigma, model))
    return TestResult(test="warm_up", coefficients=coefficients, curves=curves, notes=notes)


def _fit(
    bias: FloatArray,
    sigma: FloatArray,
    offsets: FloatArray,
    start_s: FloatArray,
    end_s: FloatArray,
    shared: FloatArray | None,
) -> tuple[ProfileFit, FloatArray]:
    """Fit one or two exponentials; also returns the time constants (g, 2) of the designs."""
    last_s = float(end_s.max())
    grid = np.linspace(
        np.log(_MIN_TIME_CONSTANT * max(start_s.min(), 30.0)),
        np.log(_MAX_TIME_CONSTANT * last_s),
        _TIME_CONSTANTS,
    )
    step, is_pair = grid[1] - grid[0], len(bias) >= offsets.shape[1] + _DWELLS_FOR_TWO
    # All pairs together have the weight of all single ones, except for the penalty of two more parameters.
    pair_penalty = 2.0 * np.log(max(1, len(_tau_pairs(grid))) / len(grid)) + 3.0 * np.log(len(bias))
    for _ in range(MAX_REFINEMENTS):
        singles = np.column_stack([np.arange(len(grid)), np.full(len(grid), -1)])
        indices = np.vstack([singles, _tau_pairs(grid)]) if is_pair else singles
        has_second = indices[:, 1] >= 0
        taus_s = np.exp(grid)
        decays = _mean_decay(start_s, end_s, taus_s[:, np.newaxis])
        # Prior: uniform in the logarithm of time constants shorter than the record, in the rate of longer.
        shares = cell_widths(grid) / step / (1.0 + taus_s / last_s)
        fit = profile_fit(
            bias,
            sigma,
            _designs(offsets, decays, indices),
            np.where(has_second, pair_penalty, 0.0),
            shared,
            shares[indices[:, 0]] * np.where(has_second, shares[indices[:, 1]], 1.0),
        )
        weights = np.zeros(len(grid))
        np.add.at(weights, indices[:, 0], fit.weights)
        np.add.at(weights, indices[has_second, 1], fit.weights[has_second])
        refined_grid = refine(grid, weights)
        if len(refined_grid) == len(grid):
            break
        grid = refined_grid
    return fit, np.where(indices >= 0, taus_s[indices], np.inf)


def _tau_pairs(grid: FloatArray) -> IntArray:
    """Indices (p, 2) of pairs of time constants that differ enough, from their logarithms (g,)."""
    return np.argwhere(grid - grid[:, np.newaxis] > np.log(_MIN_TAU_RATIO))


def _designs(offsets: FloatArray, decays: FloatArray, indices: IntArray) -> FloatArray:
    """Designs (d, n, k) of constants (n, c) and the decays (g, n) at indices (d, 2), -1 for none."""
    size = offsets.shape[1]
    designs = np.zeros((len(indices), len(offsets), size + 2))
    designs[:, :, :size] = offsets
    designs[:, :, size] = decays[indices[:, 0]]
    has_second = indices[:, 1] >= 0
    designs[has_second, :, size + 1] = decays[indices[has_second, 1]]
    return designs


def _mean_decay(start_s: FloatArray, end_s: FloatArray, tau_s: float | FloatArray) -> FloatArray:
    """Mean of exp(-t / tau) from start to end; 1 for an infinite time constant."""
    spans = np.maximum((end_s - start_s) / tau_s, 1e-9)
    return np.asarray(np.exp(-start_s / tau_s) * -np.expm1(-spans) / spans)


def _settling_time(sizes: FloatArray, taus_s: FloatArray, last_s: float, within_dph: float) -> FloatArray:
    """Time (d,) after which exponentials (d, 2) stay within a limit; infinite if not in the record."""
    times = np.linspace(0.0, _SEARCH_FACTOR * last_s, _TIMES)
    deviations = np.abs(np.einsum("dk,dkt->dt", sizes, np.exp(-times / taus_s[:, :, np.newaxis])))
    outside = deviations > within_dph
    last = np.clip(_TIMES - 1 - np.argmax(outside[:, ::-1], axis=1), 0, _TIMES - 2)
    # Between two times the logarithm is interpolated linearly, which is exact for one exponential.
    logs = np.log(np.maximum(np.take_along_axis(deviations, last[:, np.newaxis] + [0, 1], axis=1), _TINY))
    part = (logs[:, 0] - np.log(within_dph)) / np.maximum(logs[:, 0] - logs[:, 1], _TINY)
    settled_s = np.where(outside.any(axis=1), times[last] + part * times[1], 0.0)
    settled_s[outside[:, -1] | (settled_s > last_s)] = np.inf
    return settled_s


def _without_limit(results: Coefficient, is_upper: bool, is_known: bool) -> Coefficient:
    """Coefficient without its upper or its lower limit, and without its value if that is unknown."""
    update = {"high" if is_upper else "low": None} | ({} if is_known else {"value": None})
    return results.model_copy(update=update)


def _gyro_result(
    gyro: str,
    fit: ProfileFit,
    time_constants: FloatArray,
    offset_count: int,
    start_s: FloatArray,
    end_s: FloatArray,
    within_dph: float,
) -> tuple[list[Coefficient], list[str]]:
    last_s = float(end_s.max())
    taus = np.vstack([time_constants[fit.best], time_constants[fit.designs]])
    sizes = np.vstack([fit.coefficients[offset_count:], fit.draws[:, offset_count:]])
    settled_s = _settling_time(sizes, taus, last_s, within_dph)
    decays = sizes * _mean_decay(start_s[:1], end_s[:1], taus)
    initial_deviation = decays.sum(axis=1)
    dominant = np.argmax(np.abs(decays), axis=1)[:, np.newaxis]
    tau_s = np.take_along_axis(taus, dominant, axis=1)[:, 0]
    results = [
        from_draws(gyro, "first bias less final bias", "deg/h", initial_deviation[0], initial_deviation[1:]),
        from_draws(gyro, "time constant", "s", tau_s[0], tau_s[1:]),
        from_draws(gyro, f"time until within {within_dph:g} deg/h", "s", settled_s[0], settled_s[1:]),
    ]
    # The change within the record is bounded even if the time constant has no limit.
    change = initial_deviation - (sizes * _mean_decay(start_s[-1:], end_s[-1:], taus)).sum(axis=1)
    in_record = from_draws(gyro, "change in the record", "deg/h", change[0], change[1:])
    longest_s = np.where(np.isfinite(time_constants), time_constants, 0.0).max(axis=1)
    is_longest = longest_s == longest_s.max()
    is_open = fit.deviance[is_longest].min() < _DEVIANCE_95
    if in_record.low is None or in_record.high is None or in_record.low <= 0.0 <= in_record.high:
        note = f"{gyro.upper()} gyro: no warm-up is significant"
        if not is_open:
            return [results[0], in_record], [f"{note}."]
        size = results[0].model_copy(update={"value": None, "low": None, "high": None})
        return [size, in_record], [f"{note} in the record; the record does not limit one that takes longer."]
    notes = []
    if is_open:
        is_known = not is_longest[fit.best]
        results[0] = _without_limit(results[0], initial_deviation[0] > 0.0, is_known)
        results[1] = _without_limit(results[1], True, is_known)
        notes.append(
            f"{gyro.upper()} gyro: the record of {last_s / 3600.0:.2g} h sets no upper limit to the time "
            "constant and the size of the warm-up. Measure for longer."
        )
    elif results[2].value is None:
        notes.append(f"{gyro.upper()} gyro: not settled within {last_s / 3600.0:.2g} h. Measure for longer.")
    if fit.scale > 1.5:
        notes.append(
            f"{gyro.upper()} gyro: the dwells scatter {fit.scale:.1f} times their uncertainties; the "
            "intervals include this."
        )
    return results, notes
