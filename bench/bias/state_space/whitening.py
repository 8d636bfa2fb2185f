"""The Kalman filter that makes the INS's output white, for the data and for each cause at once.

What the sensors' noise does to velocity and heading is strongly correlated from epoch to epoch. A
filter that knows only the noise turns data into innovations that are white with unit variance;
sent through the same filter, the response to each possible cause becomes a column of an ordinary
least-squares problem. That is generalised least squares without its large matrix.
"""

from __future__ import annotations

import numba
import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray

#: Columns of a window: state at its start, constant inputs, a constant of the heading, inputs that
#: follow the temperature of each gyro, the data.
STATE, INPUT, HEADING, SLOPE, DATA = 0, 6, 11, 12, 15
COLUMNS = 16


@numba.njit(cache=True)
def whiten(
    columns: FloatArray,
    covariance: FloatArray,
    measured: FloatArray,
    variances: FloatArray,
    transitions: FloatArray,
    responses: FloatArray,
    covariances: FloatArray,
    C_nb: FloatArray,
    temperatures: FloatArray,
) -> FloatArray:
    """Filter the next epochs of one window; ``columns`` and ``covariance`` are changed in place.

    Parameters
    ----------
    columns : ndarray, shape (6, 16)
        The part of the state that the filter does not know, for each column.
    covariance : ndarray, shape (6, 6)
        Of the filter's estimate, from the noise alone.
    measured : ndarray, shape (n, 3)
        Velocity error East and North, attitude error about Up.
    variances : ndarray, shape (3,)
        Of the noise of each of them.
    transitions, responses, covariances : ndarray, shape (n, 6, 6), (n, 6, 5), (n, 6, 6)
        The interval that leads to each epoch; :class:`gyrobench.bench.navigation.error_model.Intervals`.
    C_nb : ndarray, shape (3, 3)
        Attitude in the window.
    temperatures : ndarray, shape (n, 3)
        Of the gyros in the interval that leads to each epoch, K from where the slopes count.

    Returns
    -------
    ndarray, shape (n, 3, 16)
        White rows with unit variance.
    """
    rows = np.empty((measured.shape[0], 3, COLUMNS))
    moved = np.empty((6, COLUMNS))
    for k in range(measured.shape[0]):
        transition, response = transitions[k], responses[k]
        for i in range(6):
            for c in range(COLUMNS):
                moved[i, c] = 0.0
            for j in range(6):
                factor = transition[i, j]
                for c in range(COLUMNS):
                    moved[i, c] += factor * columns[j, c]
            for j in range(5):
                moved[i, INPUT + j] += response[i, j]
            for axis in range(3):
                for j in range(3):
                    moved[i, SLOPE + axis] += response[i, j] * C_nb[j, axis] * temperatures[k, axis]
        columns[:] = moved
        covariance[:] = transition @ covariance @ transition.T + covariances[k]
        for m in range(3):
            h = 3 + m if m < 2 else 2
            variance = covariance[h, h] + variances[m]
            gain = covariance[h] / variance
            row = rows[k, m]
            for c in range(COLUMNS):
                row[c] = columns[h, c]
            row[DATA] += measured[k, m]
            if m == 2:
                row[HEADING] += 1.0
            for i in range(6):
                for c in range(COLUMNS):
                    columns[i, c] -= gain[i] * row[c]
                for j in range(6):
                    covariance[i, j] -= gain[i] * gain[j] * variance
            scale = 1.0 / np.sqrt(variance)
            for c in range(COLUMNS):
                row[c] *= scale
    return rows
