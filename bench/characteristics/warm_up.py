"""Warm-up: the bias of each gyro after power-on.

It is a constant and one or two exponentials, between which the data decide: both have the weight of their
likelihood with the penalty of the Bayesian information criterion. Each dwell counts with the mean of the
exponentials over its time. The time constants are the nonlinear parameters of a ``profile_fit``. They may be
longer than the record, of which the data then show a slope and little of its bend: the rate ``1 / tau``
of the bend is what they determine, and where it may be zero, time constant and size have no upper limit.
"""

from __future__ import annotations

from collections.abc import Sequence

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
from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import AXES

#: Time constants from which the grid is refined.
_TIME_CONSTANTS = 25
#: Dwells beyond the constants from which two exponentials are fitted.
_DWELLS_FOR_TWO = 8
#: Smallest ratio of two time constants.
_APART = 3.0
#: Shortest and longest time constant, relative to the time from power-on to the first and the last dwell.
_MIN_TIME_CONSTANT, _MAX_TIME_CONSTANT = 0.5, 30.0
#: Twice the logarithm of the likelihood ratio beyond which the longest time constant is excluded (95 %).
_DROP = 3.841
#: Times at which settling is looked for, and how far beyond the last dwell.
_TIMES, _BEYOND = 200, 2.0
_TINY = 1e-12


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
    last_s = float(end_s.max())
    grid = np.linspace(
        np.log(_MIN_TIME_CONSTANT * max(start_s.min(), 30.0)),
        np.log(_MAX_TIME_CONSTANT * last_s),
        _TIME_CONSTANTS,
    )
    step, is_pair = grid[1] - grid[0], len(bias) >= offsets.shape[1] + _DWELLS_FOR_TWO
    # All pairs together weigh what all single ones do, but for the penalty of two more parameters.
    for_pair = 2.0 * np.log(max(1, len(_pairs(grid))) / len(grid)) + 3.0 * np.log(len(bias))
    for _ in range(MAX_REFINEMENTS):
        singles = np.column_stack([np.arange(len(grid)), np.full(len(grid), -1)])
        places = np.vstack([singles, _pairs(grid)]) if is_pair else singles
        has_second = places[:, 1] >= 0
        taus_s = np.exp(grid)
        decays = _mean_decay(start_s, end_s, taus_s[:, np.newaxis])
        # Short of the record time constants count evenly by their logarithm, beyond it by their rate.
        shares = cells(grid) / step / (1.0 + taus_s / last_s)
        fit = profile_fit(
            bias,
            sigma,
            _designs(offsets, decays, places),
            np.where(has_second, for_pair, 0.0),
            shared,
            shares[places[:, 0]] * np.where(has_second, shares[places[:, 1]], 1.0),
        )
        weights = np.zeros(len(grid))
        np.add.at(weights, places[:, 0], fit.weights)
        np.add.at(weights, places[has_second, 1], fit.weights[has_second])
        finer = refined(grid, weights)
        if len(finer) == len(grid):
            break
        grid = finer
    return fit, np.where(places >= 0, taus_s[places], np.inf)


def _pairs(grid: FloatArray) -> IntArray:
    """Places (p, 2) of two time constants that are far enough apart, from their logarithms (g,)."""
    return np.argwhere(grid - grid[:, np.newaxis] > np.log(_APART))


def _designs(offsets: FloatArray, decays: FloatArray, places: IntArray) -> FloatArray:
    """Designs (d, n, k) of constants (n, c) and the decays (g, n) at places (d, 2), -1 for none."""
    size = offsets.shape[1]
    designs = np.zeros((len(places), len(offsets), size + 2))
    designs[:, :, :size] = offsets
    designs[:, :, size] = decays[places[:, 0]]
    has_second = places[:, 1] >= 0
    designs[has_second, :, size + 1] = decays[places[has_second, 1]]
    return designs


def _mean_decay(start_s: FloatArray, end_s: FloatArray, tau_s: float | FloatArray) -> FloatArray:
    """Mean of exp(-t / tau) from start to end; 1 for an infinite time constant."""
    spans = np.maximum((end_s - start_s) / tau_s, 1e-9)
    return np.asarray(np.exp(-start_s / tau_s) * -np.expm1(-spans) / spans)


def _settled(sizes: FloatArray, taus_s: FloatArray, last_s: float, within_dph: float) -> FloatArray:
    """Time (d,) from which exponentials (d, 2) stay within a limit; infinite where not in the record."""
    times = np.linspace(0.0, _BEYOND * last_s, _TIMES)
    away = np.abs(np.einsum("dk,dkt->dt", sizes, np.exp(-times / taus_s[:, :, np.newaxis])))
    outside = away > within_dph
    last = np.clip(_TIMES - 1 - np.argmax(outside[:, ::-1], axis=1), 0, _TIMES - 2)
    # Between two times the logarithm is linear, for one exponential exactly.
    logs = np.log(np.maximum(np.take_along_axis(away, last[:, np.newaxis] + [0, 1], axis=1), _TINY))
    part = (logs[:, 0] - np.log(within_dph)) / np.maximum(logs[:, 0] - logs[:, 1], _TINY)
    settled_s = np.where(outside.any(axis=1), times[last] + part * times[1], 0.0)
    settled_s[outside[:, -1] | (settled_s > last_s)] = np.inf
    return settled_s


def _open_end(found: Coefficient, is_upper: bool, is_known: bool) -> Coefficient:
    """The same without its upper or its lower limit; without its value if that is unknown."""
    update = {"high" if is_upper else "low": None} | ({} if is_known else {"value": None})
    return found.model_copy(update=update)


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
    settled_s = _settled(sizes, taus, last_s, within_dph)
    decays = sizes * _mean_decay(start_s[:1], end_s[:1], taus)
    drop = decays.sum(axis=1)
    larger = np.argmax(np.abs(decays), axis=1)[:, np.newaxis]
    tau_s = np.take_along_axis(taus, larger, axis=1)[:, 0]
    found = [
        from_draws(gyro, "first bias less final bias", "deg/h", drop[0], drop[1:]),
        from_draws(gyro, "time constant", "s", tau_s[0], tau_s[1:]),
        from_draws(gyro, f"time until within {within_dph:g} deg/h", "s", settled_s[0], settled_s[1:]),
    ]
    # In the record: what would come after it is not bounded where the time constant has no limit.
    change = drop - (sizes * _mean_decay(start_s[-1:], end_s[-1:], taus)).sum(axis=1)
    in_record = from_draws(gyro, "change in the record", "deg/h", change[0], change[1:])
    longest_s = np.where(np.isfinite(time_constants), time_constants, 0.0).max(axis=1)
    is_longest = longest_s == longest_s.max()
    is_open = fit.deviance[is_longest].min() < _DROP
    if in_record.low is None or in_record.high is None or in_record.low <= 0.0 <= in_record.high:
        note = f"{gyro.upper()} gyro: no warm-up is significant"
        if not is_open:
            return [found[0], in_record], [f"{note}."]
        size = found[0].model_copy(update={"value": None, "low": None, "high": None})
        return [size, in_record], [f"{note} in the record; the record does not limit one that takes longer."]
    notes = []
    if is_open:
        is_known = not is_longest[fit.best]
        found[0] = _open_end(found[0], drop[0] > 0.0, is_known)
        found[1] = _open_end(found[1], True, is_known)
        notes.append(
            f"{gyro.upper()} gyro: the record of {last_s / 3600.0:.2g} h sets no upper limit to the time "
            "constant and the size of the warm-up. Measure for longer."
        )
    elif found[2].value is None:
        notes.append(f"{gyro.upper()} gyro: not settled within {last_s / 3600.0:.2g} h. Measure for longer.")
    if fit.scale > 1.5:
        notes.append(
            f"{gyro.upper()} gyro: the dwells scatter {fit.scale:.1f} times their uncertainties; the "
            "intervals include this."
        )
    return found, notes
