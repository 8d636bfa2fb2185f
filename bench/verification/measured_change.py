"""Compares the change of the measured biases with the change that the loaded compensation should make.

If the INS does not apply the compensation, or applies it with the wrong sign, twice or to another gyro, the
measured change differs from the loaded one, for any residual.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter

import numpy as np
from scipy.stats import f, norm

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.temperature_record import followed_with_play
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.drivers.ins.compensation import Compensation

#: The factor of a gyro is evaluated only if its standard uncertainty is below this.
_MAX_SIGMA = 0.25
#: Relative error of the subtracted bias if it is evaluated at the mean temperatures of a dwell.
_EVALUATION_ERROR = 0.1
#: The play of hysteresis is known if its unknown initial state changes it by less than this, K.
_PLAY_TOLERANCE_K = 0.1
#: p-value below which a change is significant.
SIGNIFICANT_P = 1e-3
#: p-value below which a change contradicts the loaded one.
_CONTRADICTION_P = 1e-5


@dataclass(frozen=True, eq=False)
class MeasuredChange:
    """Change of the varying biases between two runs with different compensations."""

    #: factors, sigmas: Shape (3,). Ratio of the measured to the loaded change of each gyro, and its standard
    #: uncertainty; NaN if the loaded change hardly exceeds the noise.
    factors: FloatArray
    sigmas: FloatArray
    #: is_applied, is_smaller: Whether the biases of all gyros together changed as loaded, and became smaller
    #: by it, each with p < 0.001.
    is_applied: bool
    is_smaller: bool
    contradicts: BoolArray  #: Shape (3,). Whether the change of a gyro contradicts the loaded one.


def subtracted_dph(compensation: Compensation, rows: Sequence[DwellRow]) -> FloatArray:
    """Biases (n, 3) that an INS subtracts in dwells, deg/h, from their mean temperatures.

    NaN if a temperature that a term needs is missing, and while the hysteresis depends on temperatures before
    the first dwell of a power cycle. ``rows``: in the order of time.
    """
    coefficients = compensation
    gyro_c = np.array([row.gyro_c for row in rows]).reshape(-1, 3)
    limited_c = np.clip(gyro_c, coefficients.low_c, coefficients.high_c)
    above_optics_k = np.array([row.board_c for row in rows]).reshape(-1, 3) - gyro_c
    above_optics_k = np.clip(above_optics_k, coefficients.difference_low_k, coefficients.difference_high_k)
    rate = np.array([row.gyro_rate_c_per_h for row in rows]).reshape(-1, 3)
    rate = np.clip(rate, -coefficients.rate_limit_c_per_h, coefficients.rate_limit_c_per_h)
    up_body = np.array([POSITIONS[row.position].C_nb()[2] for row in rows]).reshape(-1, 3)
    middle_s = np.array([row.since_power_on_s + 0.5 * (row.end_s - row.start_s) for row in rows])[
        :, np.newaxis
    ]
    total = np.zeros_like(limited_c)
    for power_coefficients in coefficients.polynomial_dph.T[::-1]:
        total = total * limited_c + power_coefficients
    cold = (coefficients.onset_c - limited_c) / np.where(
        coefficients.onset_width_c > 0.0, coefficients.onset_width_c, np.inf
    )
    factor = (
        coefficients.gradient_dph_per_k
        + up_body @ coefficients.saturating_dph_per_k.T / (1.0 + np.exp(np.clip(-cold, -500.0, 500.0)))
        + up_body @ coefficients.growing_dph_per_k.T * np.logaddexp(0.0, cold)
    )
    decay = np.exp(-middle_s / np.where(coefficients.warm_up_s > 0.0, coefficients.warm_up_s, np.inf))
    terms = (
        (coefficients.rate_dph_per_c_per_h, rate),
        (factor, above_optics_k),
        (coefficients.warm_up_dph, decay),
        (
            coefficients.hysteresis_dph_per_k,
            _play_k([row.run for row in rows], limited_c, coefficients.half_width_k),
        ),
    )
    for size, driver in terms:
        total = total + np.where(size == 0.0, 0.0, size * driver)
    return np.asarray(total + up_body @ coefficients.gravity_dph_per_g.T)


def _play_k(cycles: Sequence[str], gyro_c: FloatArray, half_width_k: FloatArray) -> FloatArray:
    """Play of the hysteresis minus the temperatures of dwells (n, 3), K.

    The temperature is assumed to be monotonic between dwells. NaN while the play depends on its unknown state
    before the first dwell of its power cycle.
    """
    plays_k = []
    for _, group in groupby(zip(cycles, gyro_c, strict=True), key=itemgetter(0)):
        course_c = np.array([each for _, each in group])
        lowest_c, highest_c = (
            followed_with_play(course_c, half_width_k, course_c[0] + side * half_width_k)
            for side in (-1.0, 1.0)
        )
        is_known = highest_c - lowest_c < _PLAY_TOLERANCE_K
        plays_k.append(np.where(is_known, 0.5 * (lowest_c + highest_c) - course_c, np.nan))
    return np.concatenate(plays_k) if plays_k else np.zeros_like(gyro_c)


def measured_change(
    before: Sequence[DwellRow],
    after: Sequence[DwellRow],
    loaded: tuple[Compensation | None, Compensation | None],
    *,
    is_limited: bool = True,
) -> MeasuredChange | None:
    """Compare the change between the same dwells of two runs with the loaded change; None if not comparable.

    ``loaded``: compensation in each run. ``is_limited``: whether the INS has temperature limits; without
    them, dwells beyond the limits are not compared, since the subtracted bias is unknown there. The mean of
    each gyro over the dwells of the same power cycles is removed first, as for the varying bias.
    """
    changes = [np.zeros((len(rows), 3)) for rows in (before, after)]
    for index, (rows, compensation) in enumerate(zip((before, after), loaded, strict=True)):
        if compensation is not None:
            changes[index] = subtracted_dph(compensation, rows)
            if not is_limited:
                gyro_c = np.array([row.gyro_c for row in rows]).reshape(-1, 3)
                is_known = (gyro_c >= compensation.low_c) & (gyro_c <= compensation.high_c)
                changes[index] = np.where(is_known, changes[index], np.nan)
    expected = changes[1] - changes[0]
    first, second = (np.array([row.bias_dph for row in rows]).reshape(-1, 3) for rows in (before, after))
    sigmas = [np.array([row.sigma_dph for row in rows]).reshape(-1, 3) for rows in (before, after)]
    is_comparable = np.isfinite(first + second + expected).all(axis=1)
    if is_comparable.sum() < 2 or not np.any(expected[is_comparable]):
        return None
    cycle_pairs = [(row.run, other_row.run) for row, other_row in zip(before, after, strict=True)]
    cycles = np.array([cycle_pairs.index(name) for name in cycle_pairs])[is_comparable]
    weights = (sigmas[0] ** 2 + sigmas[1] ** 2)[is_comparable] ** -1.0
    expected, change, total = (
        without_cycle_means(each[is_comparable], weights, cycles, np.ones(len(cycles), dtype=bool))
        for each in (expected, first - second, first + second)
    )
    information = np.sum(weights * expected**2, axis=0)
    fits = [_fit(expected, change[:, gyro], weights[:, gyro], gyro) for gyro in range(3)]
    scatter = np.array([fit.scatter for fit in fits])
    with np.errstate(divide="ignore", invalid="ignore"):
        factors = np.sum(weights * expected * change, axis=0) / information
        errors = scatter * information**-0.5
    is_determined = errors < _MAX_SIGMA
    # Scatter beyond the noise increases both uncertainties.
    sigma_sum = scatter.max() * math.sqrt(float(information.sum()))
    is_applied, is_smaller = (
        bool(norm.sf(float(np.sum(weights * expected * each)) / sigma_sum) < SIGNIFICANT_P)
        for each in (change, total)
    )
    return MeasuredChange(
        factors=np.where(is_determined, factors, np.nan),
        sigmas=np.where(is_determined, errors, np.nan),
        contradicts=is_determined & np.array([fit.contradicts for fit in fits]),
        is_applied=is_applied,
        is_smaller=is_smaller,
    )


@dataclass(frozen=True)
class _Fit:
    """Fit of a gyro's change by the loaded changes of all gyros."""

    scatter: float  #: Rms residual in standard deviations; at least 1.
    contradicts: bool  #: Whether its own loaded change does not explain it.


def _fit(expected: FloatArray, change: FloatArray, weights: FloatArray, gyro: int) -> _Fit:
    """F-test of a gyro's own loaded change against any linear combination of those of all gyros."""
    roots = np.sqrt(weights)
    columns, values = expected * roots[:, np.newaxis], change * roots
    solution, _, rank, _ = np.linalg.lstsq(columns, values, rcond=1e-6)
    residual_square = float(np.sum((values - columns @ solution) ** 2))
    excess = float(np.sum((values - columns[:, gyro]) ** 2)) - residual_square
    dof = max(len(values) - 1 - int(rank), 1)
    variance = max(residual_square / dof, 1.0)
    own_square = float(np.sum(columns[:, gyro] ** 2))
    is_unlikely = f.sf(excess / max(int(rank), 1) / variance, max(int(rank), 1), dof) < _CONTRADICTION_P
    return _Fit(math.sqrt(variance), bool(is_unlikely and excess > _EVALUATION_ERROR**2 * own_square))


def without_cycle_means(
    values: FloatArray, weights: FloatArray, cycles: np.ndarray, counts: BoolArray
) -> FloatArray:
    """Values (..., n, 3) minus each gyro's weighted mean in its power cycle.

    ``weights``: shape (n, 3). ``cycles``: shape (n,), power cycle of each dwell. ``counts``: shape (n,),
    whether a dwell is in the mean; if none of a power cycle is, all are.
    """
    centred = values.copy()
    for cycle in set(cycles.tolist()):
        in_cycle = cycles == cycle
        averaged = in_cycle & counts if (in_cycle & counts).any() else in_cycle
        means = (weights[averaged] * values[..., averaged, :]).sum(axis=-2) / weights[averaged].sum(axis=0)
        centred[..., in_cycle, :] -= means[..., np.newaxis, :]
    return centred
