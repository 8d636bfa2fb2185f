"""Compares the change of the measured biases with the change that the loaded compensation should make.

If the INS does not apply the compensation, or applies it with the wrong sign, twice or to another gyro, the
measured change differs from the loaded one, for any residual.

Errors of latitude, gyro misalignments and scale factors belong to the site and the unit: they are the same
in the same dwells of all runs. They cancel in the change, but neither in the sum of two runs nor in a sum of
squares.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import itemgetter

import numpy as np
from scipy.stats import f, norm

from gyrobench.bench.bias.dwell_table import DwellRow, noise_and_common
from gyrobench.bench.closure.campaign import common_errors
from gyrobench.bench.closure.temperature_record import followed_with_play
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray
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
    gyro_c = np.array([row.gyro_c for row in rows]).reshape(-1, 3)
    limited_c = np.clip(gyro_c, compensation.low_c, compensation.high_c)
    above_optics_k = np.array([row.board_c for row in rows]).reshape(-1, 3) - gyro_c
    above_optics_k = np.clip(above_optics_k, compensation.difference_low_k, compensation.difference_high_k)
    rate = np.array([row.gyro_rate_c_per_h for row in rows]).reshape(-1, 3)
    rate = np.clip(rate, -compensation.rate_limit_c_per_h, compensation.rate_limit_c_per_h)
    up_body = np.array([POSITIONS[row.position].C_nb()[2] for row in rows]).reshape(-1, 3)
    middle_s = np.array([row.since_power_on_s + 0.5 * (row.end_s - row.start_s) for row in rows])[
        :, np.newaxis
    ]
    total = np.zeros_like(limited_c)
    for power_coefficients in compensation.polynomial_dph.T[::-1]:
        total = total * limited_c + power_coefficients
    cold = (compensation.onset_c - limited_c) / np.where(
        compensation.onset_width_c > 0.0, compensation.onset_width_c, np.inf
    )
    factor = (
        compensation.gradient_dph_per_k
        + up_body @ compensation.saturating_dph_per_k.T / (1.0 + np.exp(np.clip(-cold, -500.0, 500.0)))
        + up_body @ compensation.growing_dph_per_k.T * np.logaddexp(0.0, cold)
    )
    decay = np.exp(-middle_s / np.where(compensation.warm_up_s > 0.0, compensation.warm_up_s, np.inf))
    terms = (
        (compensation.rate_dph_per_c_per_h, rate),
        (factor, above_optics_k),
        (compensation.warm_up_dph, decay),
        (
            compensation.hysteresis_dph_per_k,
            _play_k([row.run for row in rows], limited_c, compensation.half_width_k),
        ),
    )
    for size, driver in terms:
        total = total + np.where(size == 0.0, 0.0, size * driver)
    return np.asarray(total + up_body @ compensation.gravity_dph_per_g.T)


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
    expected = np.zeros((len(after), 3))
    for sign, rows, compensation in zip((-1.0, 1.0), (before, after), loaded, strict=True):
        if compensation is not None:
            gyro_c = np.array([row.gyro_c for row in rows]).reshape(-1, 3)
            is_known = is_limited | ((gyro_c >= compensation.low_c) & (gyro_c <= compensation.high_c))
            expected += sign * np.where(is_known, subtracted_dph(compensation, rows), np.nan)
    first, second = (np.array([row.bias_dph for row in rows]).reshape(-1, 3) for rows in (before, after))
    is_comparable = np.isfinite(first + second + expected).all(axis=1)
    if is_comparable.sum() < 2 or not np.any(expected[is_comparable]):
        return None
    noise, common = error_parts([*before, *after])
    cycles = _cycle_pairs(before, after)[is_comparable]
    variance = (noise[: len(before)] ** 2 + noise[len(before) :] ** 2)[is_comparable]
    common_of_total = (common[:, : len(before)] + common[:, len(before) :])[:, is_comparable]
    weights = 1.0 / variance
    total = (first + second)[is_comparable]
    expected, change = (
        without_cycle_means(each[is_comparable], weights, cycles, np.ones(len(cycles), dtype=bool))
        for each in (expected, first - second)
    )
    information = np.sum(weights * expected**2, axis=0)
    fits = [_fit(expected, change[:, gyro], weights[:, gyro], gyro) for gyro in range(3)]
    scatter, contradicts = map(np.array, zip(*fits, strict=True))
    # Scatter beyond the noise increases all uncertainties.
    with np.errstate(divide="ignore", invalid="ignore"):
        factors = np.sum(weights * expected * change, axis=0) / information
        errors = scatter * information**-0.5
    is_determined = errors < _MAX_SIGMA
    of_change = weights / scatter.max() ** 2 * expected
    metric = sum_of_squares_metric(scatter.max() ** 2 * variance, common_of_total, cycles)
    of_total = (metric @ expected.ravel()).reshape(-1, 3)
    is_applied, is_smaller = (
        bool(norm.sf(np.sum(each * values) / math.sqrt(np.sum(each * expected))) < SIGNIFICANT_P)
        for each, values in ((of_change, change), (of_total, total))
    )
    return MeasuredChange(
        factors=np.where(is_determined, factors, np.nan),
        sigmas=np.where(is_determined, errors, np.nan),
        contradicts=is_determined & contradicts,
        is_applied=is_applied,
        is_smaller=is_smaller,
    )


def _fit(expected: FloatArray, change: FloatArray, weights: FloatArray, gyro: int) -> tuple[float, bool]:
    """F-test of a gyro's own loaded change against any linear combination of those of all gyros.

    Returns the rms residual of the combination in standard deviations, at least 1, and whether the gyro's own
    loaded change does not explain its change.
    """
    roots = np.sqrt(weights)
    columns, values = expected * roots[:, np.newaxis], change * roots
    solution, _, rank, _ = np.linalg.lstsq(columns, values, rcond=1e-6)
    residual_square = float(np.sum((values - columns @ solution) ** 2))
    excess = float(np.sum((values - columns[:, gyro]) ** 2)) - residual_square
    dof = max(len(values) - 1 - int(rank), 1)
    variance = max(residual_square / dof, 1.0)
    own_square = float(np.sum(columns[:, gyro] ** 2))
    is_unlikely = f.sf(excess / max(int(rank), 1) / variance, max(int(rank), 1), dof) < _CONTRADICTION_P
    return math.sqrt(variance), bool(is_unlikely and excess > _EVALUATION_ERROR**2 * own_square)


def error_parts(rows: Sequence[DwellRow]) -> tuple[FloatArray, FloatArray]:
    """Noise (n, 3) of biases, and biases (c, n, 3) for one standard uncertainty of each error in common."""
    noise, common_sigma_dph = noise_and_common(rows)
    errors = common_errors(
        [row.position for row in rows], [row.azimuth_deg for row in rows], common_sigma_dph
    )
    of_each_gyro = np.einsum("gnc,gh->gcnh", errors, np.eye(3)).reshape(-1, len(rows), 3)
    # Along Up, the latitude gives all gyros one error, and scale factors give each its own.
    return noise, np.concatenate([of_each_gyro, errors[:, :, -1].T[np.newaxis]])


def sum_of_squares_metric(
    noise_variance: FloatArray, deviations: FloatArray, cycles: IntArray | None
) -> FloatArray:
    """Matrix ``A`` (3n, 3n) of the sum of squares ``b' A b`` of biases, in units of their uncertainty.

    It is the inverse of the covariance. The mean of each gyro in each power cycle does not count: under noise
    alone, the sum has a chi2 distribution with 3n degrees of freedom minus three for each power cycle.

    Parameters
    ----------
    noise_variance : ndarray, shape (n, 3)
        Variance of the errors that are independent from dwell to dwell.
    deviations : ndarray, shape (N, n, 3)
        Other errors: biases for one standard uncertainty of each.
    cycles : ndarray, shape (n,), optional
        Power cycle of each dwell. If not given, the means count too.
    """
    columns = deviations.reshape(len(deviations), noise_variance.size)
    inverse = np.linalg.inv(np.diag(noise_variance.ravel()) + columns.T @ columns)
    if cycles is None:
        return np.asarray(inverse)
    in_cycle = np.array([cycles == each for each in np.unique(cycles)], dtype=np.float64)
    constants = np.kron(in_cycle.T, np.eye(3))
    weighted = inverse @ constants
    return np.asarray(inverse - weighted @ np.linalg.solve(constants.T @ weighted, weighted.T))


@dataclass(frozen=True)
class BiasGrowth:
    """Increase of the sum of squared biases from one run to another, in its standard deviations."""

    varying: float = 0.0  #: Of the varying biases.
    whole: float = 0.0  #: Of the biases with the constants of the power cycles.


def bias_growth(before: Sequence[DwellRow], after: Sequence[DwellRow]) -> BiasGrowth:
    """Compare the sums of squared biases of the same dwells of two runs, weighted by their uncertainty.

    Notes
    -----
    With the biases ``b`` of both runs, their covariance ``C``, and ``K`` the metric of the sum of squares,
    with a minus sign for the first run, noise adds ``tr K C`` to the difference ``b' K b``. About true biases
    ``m``, the difference has the variance ``2 tr K C K C + 4 m' K C K m``.
    """
    if not before:
        return BiasGrowth()
    noise, common = error_parts([*before, *after])
    count, biases = 3 * len(before), np.array([row.bias_dph for row in (*before, *after)]).ravel()
    columns = common.reshape(len(common), -1).T
    covariance = np.diag(noise.ravel() ** 2) + columns @ columns.T
    variance = 0.5 * (noise[: len(before)] ** 2 + noise[len(before) :] ** 2)
    deviations = np.concatenate([common[:, : len(before)], common[:, len(before) :]]) / math.sqrt(2.0)

    def growth(cycles: IntArray | None) -> float:
        metric = sum_of_squares_metric(variance, deviations, cycles)
        difference = np.zeros_like(covariance)
        difference[:count, :count], difference[count:, count:] = -metric, metric
        weighted = difference @ covariance
        of_noise = 2.0 * float(np.sum(weighted * weighted.T))
        of_biases = 4.0 * float(biases @ weighted @ (difference @ biases)) - 2.0 * of_noise
        increase = float(biases @ difference @ biases) - float(np.trace(weighted))
        return increase / math.sqrt(of_noise + max(of_biases, 0.0)) if of_noise > 0.0 else 0.0

    return BiasGrowth(growth(_cycle_pairs(before, after)), growth(None))


def _cycle_pairs(before: Sequence[DwellRow], after: Sequence[DwellRow]) -> IntArray:
    """Number of the pair of power cycles of each dwell, (n,)."""
    pairs = [(row.run, other.run) for row, other in zip(before, after, strict=True)]
    return np.array([pairs.index(each) for each in pairs])


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
