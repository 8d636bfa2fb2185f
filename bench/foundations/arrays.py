"""Array types, unit constants, and small numerical functions: RMS, block matrices, B-splines."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Array of float64; NaN where a value is missing.
FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
#: Values of the x, y and z axis, or of the gyros along them, in a row of a table.
Triple = tuple[float, float, float]

#: Standard gravity, m/s^2: the g of specifications in ug.
STANDARD_GRAVITY = 9.80665
#: Seconds of an hour, and of a day.
S_PER_H, S_PER_DAY = 3600.0, 86_400.0
#: One degree per hour in rad/s.
DPH_TO_RADPS = np.pi / 180.0 / 3600.0
#: One rad/s in degrees per hour.
RADPS_TO_DPH = 1.0 / DPH_TO_RADPS
#: One arcsec in rad.
ARCSEC_TO_RAD = np.pi / 180.0 / 3600.0
#: One rad in arcmin, and in arcsec.
RAD_TO_ARCMIN, RAD_TO_ARCSEC = 60.0 * 180.0 / np.pi, 3600.0 * 180.0 / np.pi
#: One degree per root hour (angle random walk) in rad/sqrt(s).
DEG_PER_SQRT_H_TO_SI = np.pi / 180.0 / 60.0
#: One ug (accelerometer bias) in m/s^2.
UG_TO_MPS2 = 1e-6 * STANDARD_GRAVITY
#: One ug/sqrt(Hz) (velocity random walk) in m/s/sqrt(s).
UG_PER_SQRT_HZ_TO_SI = UG_TO_MPS2


def triple(values: Iterable[float]) -> Triple:
    """Convert the values of three axes to a tuple of Python floats."""
    x, y, z = map(float, values)
    return x, y, z


def rms(values: ArrayLike) -> float:
    """Root mean square of all values; NaN if there are none."""
    squares = np.square(np.asarray(values, dtype=np.float64))
    return float(np.sqrt(np.mean(squares))) if squares.size else np.nan


def nan_rms(values: ArrayLike) -> float:
    """Root mean square of the values that are not NaN; NaN if there are none."""
    values = np.asarray(values, dtype=np.float64)
    return rms(values[~np.isnan(values)])


def true_spans(flags: BoolArray) -> IntArray:
    """Start and end indices, shape (n, 2), of each run of consecutive true values; the end is exclusive."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return np.asarray(edges, np.int64).reshape(-1, 2)


def block_diagonal(*blocks: FloatArray) -> FloatArray:
    """Block-diagonal matrix; a block may have no rows or no columns."""
    ends = np.cumsum([(0, 0), *(each.shape for each in blocks)], axis=0)
    matrix = np.zeros(ends[-1])
    for (top, left), (bottom, right), block in zip(ends, ends[1:], blocks, strict=False):
        matrix[top:bottom, left:right] = block
    return matrix


def b_splines(values: FloatArray, knots: FloatArray, degree: int) -> FloatArray:
    """Evaluate all k B-splines of a degree at n values: shape (n, k).

    ``values`` lie between the first and the last of ``knots``, in which the end knots are repeated. Recursion
    of Cox and de Boor, for some hundred knots; scipy.interpolate takes 0.3 s to import.
    """
    last = len(knots) - degree - 2
    # Clipped so that the last interval includes its end.
    intervals = np.clip(np.searchsorted(knots, values, "right") - 1, degree, last)
    splines: FloatArray = (np.arange(len(knots) - 1) == intervals[:, None]).astype(np.float64)
    for order in range(1, degree + 1):
        widths = knots[order:] - knots[:-order]
        rise = (values[:, None] - knots[:-order]) / np.where(widths > 0.0, widths, 1.0)
        splines = rise[:, :-1] * splines[:, :-1] + (1.0 - rise[:, 1:]) * splines[:, 1:]
    return splines


def integral(values: FloatArray, time_s: FloatArray) -> FloatArray:
    """Integral (n, k) of values (n, k) at times (n,) by the trapezoidal rule, from zero."""
    steps = 0.5 * (values[1:] + values[:-1]) * np.diff(time_s)[:, np.newaxis]
    return np.vstack([np.zeros_like(values[:1]), np.cumsum(steps, axis=0)])
