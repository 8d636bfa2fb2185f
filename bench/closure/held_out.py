"""Do held-out dwells follow a model, and confirm effects? Its errors there, against noise and uncertainty."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.bias.statistics import chi2_p_value, f_p_value
from gyrobench.bench.closure.noise import MEDIAN, OUTLIER_SHARE, OUTLIER_SIGMA, Outlier
from gyrobench.bench.closure.problem import Problem
from gyrobench.bench.closure.validation import LACK_OF_FIT_P
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, rms

#: A gyro that is off to the same side in this number of dwells in a row has changed: these are no outliers.
_IN_A_ROW = 3
#: Degree of the slow course in time that the errors are tested for, with its constant.
_DEGREE = 3
#: A direction is independent of others that leave at least this share of its length.
_MIN_SHARE = 1e-3
#: Limits of a ratio of variances, against division by zero.
_MIN_VARIANCE, _MAX_RATIO = 1e-300, 1e12


@dataclass(frozen=True)
class HeldOutTest:
    """Outcome of the tests; without held-out dwells all p-values are 1."""

    #: For each gyro the smallest p-value of its tests, corrected for the number of tests of all gyros.
    p_values: tuple[float, ...] = (1.0, 1.0, 1.0)
    #: Biases that are off as outliers are in a search; they count as one standard deviation.
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

    The sum of squares, a slow course in time, and what follows attitude and temperature rate.

    Parameters
    ----------
    problem : Problem
        The dwells searched after a fit of the model, and the noise.
    errors_dph : ndarray, shape (n, 3)
        Measured minus predicted bias in all dwells; NaN where nothing was measured.
    deviations_dph : ndarray, shape (N, n, 3)
        Bias by each draw of the model's parameters minus the predicted one.

    Notes
    -----
    The covariance of the errors is that of the noise and of the draws. The constant of a power cycle that was
    not searched is free. The sum is without the largest error: a difference must not rest on one dwell. Each
    p-value is the larger one by the stated noise and by the scatter in the dwells searched, since either may
    be too small.
    """
    campaign, held_out = problem.campaign, ~problem.searched
    if not held_out.any():
        return HeldOutTest()
    errors_dph, deviations_dph = errors_dph[held_out], deviations_dph[:, held_out]
    noise_dph = campaign.sigma_dph[held_out] * problem.noise_scale
    run = campaign.run[held_out]
    unseen = np.setdiff1d(run, campaign.run[problem.searched])
    constants = np.asarray(run[:, np.newaxis] == unseen, dtype=np.float64)
    course = np.column_stack([np.ones(len(run)), campaign.part(held_out).slow_time(_DEGREE)])
    up_body, rate = campaign.up_body[held_out], np.nan_to_num(campaign.rate_c_per_h[held_out])
    prediction_dph = np.sqrt(np.mean(deviations_dph**2, axis=0))
    centred_dph = _without_medians(errors_dph, constants)
    off = np.nan_to_num(centred_dph / np.hypot(noise_dph, prediction_dph))
    is_outlier = _are_outliers(off)
    sigma_dph = noise_dph * np.where(is_outlier, np.abs(off), 1.0)
    p_values = []
    for gyro, known in enumerate(~np.isnan(errors_dph).T):
        followed = course[known], np.column_stack([up_body, rate[:, gyro]])[known]
        of_gyro = sigma_dph[known, gyro], deviations_dph[:, known, gyro], constants[known], followed
        p_values.append(_p_values(problem, gyro, errors_dph[known, gyro], *of_gyro))
    tests = sum(map(len, p_values))
    dwells, axes = campaign.dwell[held_out], campaign.quantity.axes
    return HeldOutTest(
        tuple(min(1.0, tests * min(each, default=1.0)) for each in p_values),
        tuple(
            Outlier(int(dwells[dwell]), axes[gyro], float(off[dwell, gyro]))
            for dwell, gyro in np.argwhere(is_outlier)
        ),
    )


def _without_medians(errors_dph: FloatArray, constants: FloatArray) -> FloatArray:
    """Errors (n, 3) minus their median in each power cycle of ``constants`` (n, r).

    An outlier shifts the mean of all others.
    """
    centred_dph = errors_dph.copy()
    for gyro, mine in itertools.product(range(3), constants.T > 0.0):
        known = mine & ~np.isnan(errors_dph[:, gyro])
        if known.any():
            centred_dph[known, gyro] -= np.median(errors_dph[known, gyro])
    return centred_dph


def _are_outliers(off: FloatArray) -> BoolArray:
    """Which errors (n, 3) are outliers as in a search; ``off``: in standard deviations.

    Of one or two dwells none is. Where those of a gyro are improbably many or follow one another, it has
    changed, and none of them is.
    """
    dwells = len(off)
    if dwells < _IN_A_ROW:
        return np.zeros(off.shape, dtype=bool)
    scale = max(1.0, float(np.median(np.abs(off))) / MEDIAN)
    side = np.where(np.abs(off) > OUTLIER_SIGMA * scale, np.sign(off), 0.0)
    rows = np.lib.stride_tricks.sliding_window_view(side, _IN_A_ROW, axis=0).sum(axis=2)
    has_changed = np.any(np.abs(rows) == _IN_A_ROW, axis=0)
    counts = np.count_nonzero(side, axis=0).tolist()
    are_many = np.array([_p_of_outliers(count, dwells) < LACK_OF_FIT_P for count in counts])
    return np.asarray((side != 0.0) & ~has_changed & ~are_many)


def _p_of_outliers(count: int, dwells: int) -> float:
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
    sigma_dph: FloatArray,
    deviations_dph: FloatArray,
    constants: FloatArray,
    followed: Sequence[FloatArray],
) -> list[float]:
    """p-values of one gyro's tests that its held-out values (k,) allow.

    ``constants`` (k, r): flags of the power cycles that were not searched. ``followed``: columns (k, c) of
    what the errors may follow, for one test each.
    """
    if not len(errors_dph):
        return []
    covariance = np.diag(sigma_dph**2) + deviations_dph.T @ deviations_dph / len(deviations_dph)
    root = np.linalg.cholesky(covariance)
    white = [np.linalg.solve(root, each) for each in (errors_dph[:, np.newaxis], constants, *followed)]
    free = _directions(white[1], white[1])
    errors, _, *columns = (each - free @ (free.T @ each) for each in white)
    along = [_directions(left, whole).T @ errors for left, whole in zip(columns, white[2:], strict=True)]
    residuals = problem.residuals[:, gyro]
    own_dof = int(problem.campaign.is_measured[problem.searched, gyro].sum()) - problem.bases[gyro].shape[1]
    own_variance = float(residuals @ residuals) / max(own_dof, 1)
    variance = max(problem.chi2 / max(problem.dof, 1), own_variance, _MIN_VARIANCE)

    def p_value(count: int, chi2: float) -> float:
        ratio = min(chi2 / count / variance, _MAX_RATIO)
        by_scatter = f_p_value(count, problem.dof, ratio) if problem.dof > 0 else 0.0
        return max(chi2_p_value(count, chi2), by_scatter)

    squares = errors**2
    tests = [
        (len(errors) - free.shape[1] - 1, float(squares.sum() - squares.max())),
        *((len(each), float(np.sum(each**2))) for each in along),
    ]
    return [p_value(count, chi2) for count, chi2 in tests if count > 0]


def _directions(columns: FloatArray, whole: FloatArray) -> FloatArray:
    """Orthonormal directions (k, r) of columns that keep a share of their ``whole`` length."""
    lengths = np.maximum(np.linalg.norm(whole, axis=0), _MIN_VARIANCE)
    left, kept, _ = np.linalg.svd(columns / lengths, full_matrices=False)
    return np.asarray(left[:, kept > _MIN_SHARE])


#: What effects predict counts as seen in held-out dwells from this many standard deviations of its size on. A
#: gyro where it is this many times as large also decides alone.
_MIN_T, _DECIDES_ALONE = 3.0, 3.0
#: Range of the size of what effects predict: 1 if they are right.
_MIN_SIZE, _MAX_SIZE = 0.5, 2.0
#: Errors beyond this many standard deviations are outliers; held-out dwells are like those searched up to
#: this ratio of their errors to the noise.
_MAX_ERROR, _MAX_HELD_OUT_NOISE = 5.0, 2.0
_STEPS_TO_SIZE = 30


def is_confirmed(before_dph: FloatArray, after_dph: FloatArray, noise_dph: FloatArray) -> bool:
    """Whether effects reduce the errors in held-out dwells by more than chance, and to their noise.

    Decided for all gyros together, and for each where the effects predict enough. ``before_dph``,
    ``after_dph`` (n, 3): measured minus predicted bias without and with the effects. ``noise_dph`` (n, 3):
    standard deviation of the noise.

    Notes
    -----
    The size of what the effects predict is fitted to the errors without them, outliers at a lower weight: it
    is 1 if they are right, and 0 if these dwells show nothing of them. Its standard deviation follows from
    the errors left. The sum of squared errors, an outlier counted as :data:`_MAX_ERROR`, must fall too.
    """
    before, after = (np.nan_to_num(each / noise_dph) for each in (before_dph, after_dph))
    lengths = np.linalg.norm(before - after, axis=0)
    decisive = np.flatnonzero(lengths > _DECIDES_ALONE * _MIN_T)
    pairs = [(before.ravel(), after.ravel()), *((before[:, each], after[:, each]) for each in decisive)]
    return all(_are_reduced(*each) for each in pairs)


def _are_reduced(before: FloatArray, after: FloatArray) -> bool:
    """Whether errors (n,) in units of the noise are reduced by more than chance, and to the noise."""
    predicted = before - after
    noise = max(1.0, float(np.median(np.abs(after))) / MEDIAN)
    if not predicted.any() or noise > _MAX_HELD_OUT_NOISE:
        return False
    limit, size = _MAX_ERROR * noise, 1.0
    for _ in range(_STEPS_TO_SIZE):
        weighted = predicted * limit / np.maximum(np.abs(before - size * predicted), limit)
        size = float(weighted @ before / (weighted @ predicted))
    left = np.clip(before - size * predicted, -limit, limit)
    is_seen = size * float(np.linalg.norm(predicted)) > _MIN_T * max(1.0, rms(left))
    is_less = rms(np.clip(after, -limit, limit)) < rms(np.clip(before, -limit, limit))
    return is_seen and is_less and _MIN_SIZE < size < _MAX_SIZE
