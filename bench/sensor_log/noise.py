"""Noise of window means, from changes that no slow drift explains."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.sensor_log.windows import BLOCKS, Window

#: Median of the square of a standard normal value.
_MEDIAN_OF_SQUARE = 0.45494
#: Mean square of a standard normal value within three standard deviations.
_MEAN_WITHIN = 0.97334
#: Mean square of a second difference of means by noise white in the rate, over the variance of a mean.
_OF_WHITE_RATE = 6.0
#: The same by noise white in the angle, over the variance of the angle at one end.
_OF_WHITE_ANGLE = 20.0
#: Second differences that an averaging time needs, and above which more do not count.
_LEAST_DIFFERENCES, _MOST_DIFFERENCES = 8, 2000
#: Excess over the noise that is drift, times the root of the number of differences.
_TOLERANCE = 6.0


def noise_of_means(logs: Sequence[Sequence[Window]]) -> FloatArray:
    """Standard uncertainty of a window's mean by its noise, deg/h, shape (3,).

    Second differences of neighbouring means hold no constant and no slope. Their mean square over
    averaging time, from parts of windows to whole ones, is split into what is white in the angle
    (a ring laser's dither, quantisation), white in the rate (angle random walk) and independent of
    the averaging time (bias instability), as one does with an Allan variance. Averaging times that
    show more than these can explain hold drift and do not count. What lies far out, as a
    knock in one window, is left out. A mean is never known better than the resolution of the rate allows.

    Parameters
    ----------
    logs : sequence of sequences of Window
        Good windows, log by log.

    Raises
    ------
    MeasurementError
        A gyro's rate never changes, or there are too few windows.
    """
    windows = [window for log in logs for window in log]
    differences = {
        part: each
        for part, each in (*_within(windows), (1.0, _between(logs)))
        if len(each) >= _LEAST_DIFFERENCES
    }
    if not differences:
        raise MeasurementError(
            f"{len(windows)} good windows of {windows[0].samples} samples are too few to tell the noise. "
            "Take longer or more windows"
        )
    squares = np.array([_mean_square(each) for each in differences.values()]) / _OF_WHITE_RATE
    parts = np.array(list(differences))
    counts = np.minimum([len(each) for each in differences.values()], _MOST_DIFFERENCES)
    # A rate whose differences are mostly zero changes by its resolution alone.
    noise = [_without_drift(parts, square, counts) if (square > 0.0).all() else 0.0 for square in squares.T]
    sigma = np.sqrt(np.maximum(noise, _resolution_variance(windows)))
    if not (sigma > 0.0).all():
        raise MeasurementError("a gyro's rate never changes. Check its column in the mapping, and the gyro")
    return np.asarray(sigma)


def _without_drift(parts: FloatArray, squares: FloatArray, counts: NDArray[np.intp]) -> float:
    """Variance of a whole window's mean.

    Parameters
    ----------
    parts : ndarray, shape (n,)
        Averaging times in windows, rising.
    squares : ndarray, shape (n,)
        Size of the second differences there, as variance of white noise.
    counts : ndarray, shape (n,)
        Number of differences, which is their weight.
    """
    weights = np.sqrt(counts) / squares
    # A drift that bends leaves second differences as the square of the time, so squares as its fourth power.
    powers = (-2.0, -1.0, 0.0, 4.0) if len(parts) > 3 else (-2.0, -1.0, 0.0)
    design = parts[:, np.newaxis] ** powers
    terms, _ = nnls(design * weights[:, np.newaxis], squares * weights)
    if len(parts) > 2 and squares[-1] > design[-1] @ terms * (1.0 + _TOLERANCE / np.sqrt(counts[-1])):
        return _without_drift(parts[:-1], squares[:-1], counts[:-1])
    angle, rate, instability = terms[:3]
    return float(2.0 * _OF_WHITE_RATE / _OF_WHITE_ANGLE * angle + rate + instability)


def _within(windows: Sequence[Window]) -> Iterator[tuple[float, FloatArray]]:
    """Second differences of the means of parts of a window, for each size of part."""
    finest = min(len(each.blocks_dph) for each in windows)
    for count in BLOCKS:
        if count <= finest:
            means = np.array([each.blocks_dph.reshape(count, -1, 3).mean(axis=1) for each in windows])
            yield 1.0 / count, np.diff(means, n=2, axis=1).reshape(-1, 3)


def _between(logs: Sequence[Sequence[Window]]) -> FloatArray:
    """Second differences of the means of three windows that follow one another."""
    triples = [
        first.rate_dph - 2.0 * middle.rate_dph + last.rate_dph
        for log in logs
        for first, middle, last in zip(log, log[1:], log[2:], strict=False)
        if first.end_s == middle.start_s and middle.end_s == last.start_s
    ]
    return np.array(triples).reshape(-1, 3)


def _mean_square(differences: FloatArray) -> FloatArray:
    """Mean square by column without what lies beyond three standard deviations."""
    squares = differences**2
    limit = 9.0 * np.median(squares, axis=0) / _MEDIAN_OF_SQUARE
    return np.asarray(np.nanmean(np.where(squares <= limit, squares, np.nan), axis=0) / _MEAN_WITHIN)


def _resolution_variance(windows: Sequence[Window]) -> FloatArray:
    step = np.min([each.rate_step_dph for each in windows], axis=0)
    step = np.where(np.isfinite(step), step, 0.0)
    scatter = np.median([each.scatter_dph for each in windows], axis=0)
    samples = float(np.median([each.samples for each in windows]))
    # Steps average out where noise takes the rate over several of them.
    return np.asarray(step**2 / 12.0 / np.where(scatter >= 0.5 * step, samples, 1.0))
