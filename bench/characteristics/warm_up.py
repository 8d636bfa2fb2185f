"""Warm-up: the bias of each gyro after power-on.

It is a constant and one or two exponentials, between which the data decide: both have the weight of their
likelihood with the penalty of the Bayesian information criterion. Each dwell counts with the mean of the
exponentials over its time. The time constants are the nonlinear parameters of a ``profile_fit``.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.bias.error_split import NONE_SHARED, SharedErrors
from gyrobench.bench.characteristics.profile_fit import ProfileFit, indicators, profile_fit, shared_by
from gyrobench.bench.characteristics.results import Coefficient, Curve, TestResult, from_draws
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import AXES

_TIME_CONSTANTS = 25
#: Dwells beyond the constants from which two exponentials are fitted.
_DWELLS_FOR_TWO = 8
#: Smallest ratio of two time constants.
_APART = 3.0
#: Shortest and longest time constant, relative to the time from power-on to the first and the last dwell.
_MIN_TIME_CONSTANT, _MAX_TIME_CONSTANT = 0.5, 1.0
#: Times at which settling is looked for, and how far beyond the last dwell.
_TIMES, _BEYOND = 200, 2.0


def warm_up(rows: Sequence[DwellRow], within_dph: float, shared: SharedErrors = NONE_SHARED) -> TestResult:
    """Warm-up from dwells after one or more cold starts, each with a constant.

    ``within_dph``: a gyro has settled when its bias is this near to its final value. ``shared``: by
    accelerometers that follow the temperature. Raises MeasurementError if there are too few dwells.
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
        fit, time_constants = _fit(bias, sigma, offsets, start_s, end_s, shared_by(shared, good, axis))
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
) -> tuple[ProfileFit, FloatArray]:
    """Fit of one or two exponentials, and the time constants (g, 2) of its designs."""
    grid = (
        np.geomspace(
            _MIN_TIME_CONSTANT * max(start_s.min(), 30.0), _MAX_TIME_CONSTANT * end_s.max(), _TIME_CONSTANTS
        )
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
    return profile_fit(bias, sigma, designs, penalties, shared), taus


def _mean_decay(start_s: FloatArray, end_s: FloatArray, tau_s: float | FloatArray) -> FloatArray:
    """Mean of exp(-t / tau) from start to end; 1 for an infinite time constant."""
    spans = np.maximum((end_s - start_s) / tau_s, 1e-9)
    return np.asarray(np.exp(-start_s / tau_s) * -np.expm1(-spans) / spans)


def _of_gyro(
    gyro: str,
    fit: ProfileFit,
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
