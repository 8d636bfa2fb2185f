"""Tests of a model's errors in held-out dwells: lack of fit, and confirmation of effects."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.bias.statistics import chi2_p_value, f_p_value
from gyrobench.bench.closure.noise import MEDIAN_ABS_NORMAL, OUTLIER_SHARE, OUTLIER_SIGMA, Outlier
from gyrobench.bench.closure.problem import Problem
from gyrobench.bench.closure.validation import LACK_OF_FIT_P
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, rms

#: Deviations with the same sign in this number of consecutive dwells are a change of the gyro, not outliers.
_CONSECUTIVE = 3
#: Degree of the polynomial in time, including its constant, that the errors are tested for.
_DEGREE = 3
#: Directions shorter than this share of their original length count as dependent.
_MIN_SHARE = 1e-3
#: Limits of a ratio of variances, against division by zero.
_MIN_VARIANCE, _MAX_RATIO = 1e-300, 1e12


@dataclass(frozen=True)
class HeldOutTest:
    """Outcome of the tests; all p-values are 1 without held-out dwells."""

    #: Smallest p-value of each gyro, corrected for the number of tests of all gyros.
    p_values: tuple[float, ...] = (1.0, 1.0, 1.0)
    #: Outliers by the same limit as in a search; they count as one standard deviation.
    outliers: tuple[Outlier, ...] = ()

    @property
    def p_value(self) -> float:
        """Smallest p-value of all gyros."""
        return min(self.p_values)

    @property
    def is_significant(self) -> bool:
        """Whether the held-out dwells differ from the model."""
        return self.p_value < LACK_OF_FIT_P

    @property
    def gyros(self) -> list[int]:
        """Indices of the gyros that differ from the model."""
        return [gyro for gyro, p_value in enumerate(self.p_values) if p_value < LACK_OF_FIT_P]


def held_out_test(problem: Problem, errors_dph: FloatArray, deviations_dph: FloatArray) -> HeldOutTest:
    """Test the errors of each gyro in the held-out dwells.

    Tested are the sum of squares, a slow course in time, a step at any time, and terms of attitude and
    temperature rate.

    Parameters
    ----------
    problem : Problem
        The dwells searched, after a fit of the model.
    errors_dph : ndarray, shape (n, 3)
        Measured minus predicted bias in all dwells; NaN if not measured.
    deviations_dph : ndarray, shape (N, n, 3)
        Bias for each draw of the model's parameters minus the predicted bias.

    Notes
    -----
    The covariance of the errors is the sum of those of the noise and of the draws. The constant of a power
    cycle that was not searched is free. The sum of squares omits the largest error, so that no difference
    rests on one dwell. Each p-value is the larger of two, one with the stated noise and one with the scatter
    of the dwells searched, since either may be too small.
    """
    campaign, held_out = problem.campaign, ~problem.searched
    if not held_out.any():
        return HeldOutTest()
    errors_dph, deviations_dph = errors_dph[held_out], deviations_dph[:, held_out]
    noise_dph = campaign.sigma_dph[held_out] * problem.noise_scale
    run = campaign.run[held_out]
    unsearched = np.setdiff1d(run, campaign.run[problem.searched])
    constants = np.asarray(run[:, np.newaxis] == unsearched, dtype=np.float64)
    time_polynomial = np.column_stack([np.ones(len(run)), campaign.part(held_out).slow_time(_DEGREE)])
    up_body, rate = campaign.up_body[held_out], np.nan_to_num(campaign.rate_c_per_h[held_out])
    prediction_dph = np.sqrt(np.mean(deviations_dph**2, axis=0))
    centred_dph = _without_medians(errors_dph, constants)
    expected_dph = np.sqrt(noise_dph**2 + campaign.common_sigma_dph[held_out] ** 2 + prediction_dph**2)
    deviations_sigma = np.nan_to_num(centred_dph / expected_dph)
    is_outlier = _are_outliers(deviations_sigma)
    sigma_dph = noise_dph * np.where(is_outlier, np.abs(deviations_sigma), 1.0)
    p_values = []
    for gyro, is_measured in enumerate(~np.isnan(errors_dph).T):
        common_dph = campaign.common_errors_dph[gyro, held_out][is_measured]
        drawn_dph = deviations_dph[:, is_measured, gyro]
        covariance = np.diag(sigma_dph[is_measured, gyro] ** 2) + common_dph @ common_dph.T
        covariance += drawn_dph.T @ drawn_dph / len(drawn_dph)
        regressors = [time_polynomial[is_measured], np.column_stack([up_body, rate[:, gyro]])[is_measured]]
        errors = errors_dph[is_measured, gyro], covariance
        p_values.append(_p_values(problem, gyro, *errors, constants[is_measured], regressors))
    test_count = sum(map(len, p_values))
    dwells, axes = campaign.dwell[held_out], campaign.quantity.axes
    return HeldOutTest(
        tuple(min(1.0, test_count * min(each, default=1.0)) for each in p_values),
        tuple(
            Outlier(int(dwells[dwell]), axes[gyro], float(deviations_sigma[dwell, gyro]))
            for dwell, gyro in np.argwhere(is_outlier)
        ),
    )


def _without_medians(errors_dph: FloatArray, constants: FloatArray) -> FloatArray:
    """Errors (n, 3) minus their median in each power cycle of ``constants`` (n, r).

    The median, since an outlier would shift the mean.
    """
    centred_dph = errors_dph.copy()
    for gyro, in_cycle in itertools.product(range(3), constants.T > 0.0):
        is_used = in_cycle & ~np.isnan(errors_dph[:, gyro])
        if is_used.any():
            centred_dph[is_used, gyro] -= np.median(errors_dph[is_used, gyro])
    return centred_dph


def _are_outliers(deviations_sigma: FloatArray) -> BoolArray:
    """Which deviations (n, 3), in standard deviations, are outliers.

    None if there are fewer than three dwells. If a gyro has improbably many or consecutive ones, the gyro has
    changed and none of them is an outlier.
    """
    dwells = len(deviations_sigma)
    if dwells < _CONSECUTIVE:
        return np.zeros(deviations_sigma.shape, dtype=bool)
    scale = max(1.0, float(np.median(np.abs(deviations_sigma))) / MEDIAN_ABS_NORMAL)
    sign = np.where(np.abs(deviations_sigma) > OUTLIER_SIGMA * scale, np.sign(deviations_sigma), 0.0)
    sign_sums = np.lib.stride_tricks.sliding_window_view(sign, _CONSECUTIVE, axis=0).sum(axis=2)
    has_changed = np.any(np.abs(sign_sums) == _CONSECUTIVE, axis=0)
    counts = np.count_nonzero(sign, axis=0).tolist()
    has_too_many = np.array([_outlier_count_p_value(count, dwells) < LACK_OF_FIT_P for count in counts])
    return np.asarray((sign != 0.0) & ~has_changed & ~has_too_many)


def _outlier_count_p_value(count: int, dwells: int) -> float:
    """Probability of at least this number of outliers of one gyro."""
    fewer = (
        math.comb(dwells, each) * OUTLIER_SHARE**each * (1.0 - OUTLIER_SHARE) ** (dwells - each)
        for each in range(count)
    )
    return 1.0 - sum(fewer)


def _p_values(
    problem: Problem,
    gyro: int,
    errors_dph: FloatArray,
    covariance: FloatArray,
    constants: FloatArray,
    regressors: Sequence[FloatArray],
) -> list[float]:
    """p-values of those tests of one gyro for which its k held-out values suffice.

    ``covariance`` (k, k): of the errors. ``constants`` (k, r): flags of the power cycles that were not
    searched. ``regressors``: columns (k, c) for one test each.
    """
    if not len(errors_dph):
        return []
    covariance_root = np.linalg.cholesky(covariance)
    steps = np.tri(len(errors_dph))[:, _CONSECUTIVE : len(errors_dph) - _CONSECUTIVE + 1]
    whitened = [
        np.linalg.solve(covariance_root, each)
        for each in (errors_dph[:, np.newaxis], constants, steps, *regressors)
    ]
    free_basis = _independent_basis(whitened[1], whitened[1])
    errors, _, steps, *columns = (each - free_basis @ (free_basis.T @ each) for each in whitened)
    projections = [
        _independent_basis(remaining, original).T @ errors
        for remaining, original in zip(columns, whitened[3:], strict=True)
    ]
    residuals = problem.residuals[:, gyro]
    gyro_dof = int(problem.campaign.is_measured[problem.searched, gyro].sum()) - problem.bases[gyro].shape[1]
    gyro_variance = float(residuals @ residuals) / max(gyro_dof, 1)
    variance = max(problem.chi2 / max(problem.dof, 1), gyro_variance, _MIN_VARIANCE)

    def p_value(count: int, chi2: float) -> float:
        ratio = min(chi2 / count / variance, _MAX_RATIO)
        p_scatter = f_p_value(count, problem.dof, ratio) if problem.dof > 0 else 0.0
        return max(chi2_p_value(count, chi2), p_scatter)

    squares = errors**2
    tests = [
        (len(errors) - free_basis.shape[1] - 1, float(squares.sum() - squares.max())),
        *((len(each), float(np.sum(each**2))) for each in projections),
    ]
    p_values = [p_value(count, chi2) for count, chi2 in tests if count > 0]
    lengths = np.linalg.norm(steps, axis=0)
    steps = steps[:, lengths > _MIN_SHARE] / lengths[lengths > _MIN_SHARE]
    if steps.size:
        p_values.append(min(1.0, steps.shape[1] * p_value(1, float(np.max((steps.T @ errors) ** 2)))))
    return p_values


def _independent_basis(columns: FloatArray, originals: FloatArray) -> FloatArray:
    """Orthonormal basis (k, r) of columns, without those much shorter than their ``originals``."""
    lengths = np.maximum(np.linalg.norm(originals, axis=0), _MIN_VARIANCE)
    directions, singular_values, _ = np.linalg.svd(columns / lengths, full_matrices=False)
    return np.asarray(directions[:, singular_values > _MIN_SHARE])


#: Held-out dwells confirm a prediction if its fitted size is at least this many standard deviations. A gyro
#: in which the prediction is this many times as large must also confirm it by itself.
_MIN_T, _SINGLE_GYRO_FACTOR = 3.0, 3.0
#: Accepted range of the fitted size of the prediction; 1 if the effects are right.
_MIN_SIZE, _MAX_SIZE = 0.5, 2.0
#: Errors beyond this many standard deviations are outliers. Largest ratio of the errors to the noise with
#: which held-out dwells can confirm anything.
_MAX_ERROR, _MAX_HELD_OUT_NOISE = 5.0, 2.0
_SIZE_ITERATIONS = 30


def are_effects_confirmed(problem: Problem, before_dph: FloatArray, after_dph: FloatArray) -> bool:
    """Whether the held-out dwells confirm effects, see :func:`is_confirmed`.

    ``problem``: of the dwells searched. ``before_dph``, ``after_dph`` (n, 3): measured minus predicted bias
    in all dwells, without and with the effects; NaN if not measured.
    """
    of_held_out = replace(problem, searched=~problem.searched)
    before, after = (
        of_held_out.whitened(np.nan_to_num(each[~problem.searched]).T[..., None])[..., 0].T
        for each in (before_dph, after_dph)
    )
    return is_confirmed(before, after, problem.correlation_factor)


def is_confirmed(before: FloatArray, after: FloatArray, correlation_factor: float = 1.0) -> bool:
    """Whether effects reduce the errors in held-out dwells by more than chance, down to the noise.

    Required of all gyros together, and of each gyro in which the effects predict enough. ``before``,
    ``after`` (n, 3): measured minus predicted bias without and with the effects, as of
    :meth:`~gyrobench.bench.closure.problem.Problem.whitened`; NaN if not measured. ``correlation_factor``:
    :attr:`Problem.correlation_factor`.

    Notes
    -----
    The size of the prediction is fitted to the errors without the effects, with a lower weight for outliers:
    it is 1 if the effects are right, and 0 if these dwells do not show them. Its standard deviation follows
    from the remaining errors. The sum of squared errors, with outliers clipped at :data:`_MAX_ERROR`, must
    decrease too.
    """
    before, after = np.nan_to_num(before), np.nan_to_num(after)
    predicted_sizes = np.linalg.norm(before - after, axis=0)
    decisive = np.flatnonzero(predicted_sizes > _SINGLE_GYRO_FACTOR * _MIN_T)
    single_gyros = ((before[:, each], after[:, each], _MIN_T) for each in decisive)
    together = before.ravel(), after.ravel(), _MIN_T * math.sqrt(correlation_factor)
    return all(_is_reduced(*each) for each in (together, *single_gyros))


def _is_reduced(before: FloatArray, after: FloatArray, min_t: float) -> bool:
    """Whether errors (n,), in units of the noise, decrease by more than chance, down to the noise."""
    predicted = before - after
    noise = max(1.0, float(np.median(np.abs(after))) / MEDIAN_ABS_NORMAL)
    if not predicted.any() or noise > _MAX_HELD_OUT_NOISE:
        return False
    limit, size = _MAX_ERROR * noise, 1.0
    for _ in range(_SIZE_ITERATIONS):
        weighted_prediction = predicted * limit / np.maximum(np.abs(before - size * predicted), limit)
        size = float(weighted_prediction @ before / (weighted_prediction @ predicted))
    remaining = np.clip(before - size * predicted, -limit, limit)
    is_observed = size * float(np.linalg.norm(predicted)) > min_t * max(1.0, rms(remaining))
    is_smaller = rms(np.clip(after, -limit, limit)) < rms(np.clip(before, -limit, limit))
    return is_observed and is_smaller and _MIN_SIZE < size < _MAX_SIZE
