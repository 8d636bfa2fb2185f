"""The unknowns of a dwell, in the order of the least-squares problem, and what is known of them.

First those that other dwells can share, then for each window those of its own.
"""

from __future__ import annotations

import numpy as np

from gyrobench.bench.bias.prior import PriorKnowledge
from gyrobench.bench.foundations.arrays import STANDARD_GRAVITY, FloatArray
from gyrobench.bench.navigation.error_model import INPUTS

#: Biases of the gyros and their slopes with temperature, accelerometer biases (body axes), rate
#: North and Up that is fixed in the navigation frame, gyro error matrix by rows.
GYRO_BIAS, GYRO_SLOPE, ACCELEROMETER_BIAS = slice(0, 3), slice(3, 6), slice(6, 9)
NAVIGATION_RATE, GYRO_MATRIX = slice(9, 11), slice(11, 20)
#: Drift of the accelerometer biases, m/s^3, body axes.
ACCELEROMETER_DRIFT = slice(20, 23)
COMMON = 23

#: Of each window: constant of the heading, jumps of velocity East and North and of the attitude
#: error East, North and Up at its start.
HEADING, VELOCITY, ATTITUDE = 0, slice(1, 3), slice(3, 6)
PER_WINDOW = 6

#: So wide a prior of a gyro's bias, rad/s, that it only keeps the problem regular.
WIDE_GYRO_BIAS = 0.01
_HEADING, _VELOCITY, _FIRST_ATTITUDE = 1.0, 10.0, 0.1


def inputs(C_nb: FloatArray, rate_body: FloatArray, count: int) -> FloatArray:
    """Input of the error model, (5, count), that a unit of each unknown makes.

    Parameters
    ----------
    C_nb : ndarray, shape (3, 3)
        Attitude.
    rate_body : ndarray, shape (3,)
        Rotation against inertial space in body axes, rad/s.
    count : int
        Number of unknowns.
    """
    result = np.zeros((INPUTS, count))
    result[:3, GYRO_BIAS] = C_nb
    result[3:, ACCELEROMETER_BIAS] = C_nb[:2]
    result[1:3, NAVIGATION_RATE] = np.eye(2)
    result[:3, GYRO_MATRIX] = np.kron(C_nb, rate_body)
    # On velocity a steady drift acts as the bias of the level gyro across it does: no fit tells them apart.
    result[0, ACCELEROMETER_DRIFT] = -C_nb[1] / STANDARD_GRAVITY
    result[1, ACCELEROMETER_DRIFT] = C_nb[0] / STANDARD_GRAVITY
    return result


def prior_root(prior: PriorKnowledge, windows: int, earth_rate: FloatArray) -> FloatArray:
    """Root ``L`` (p, p) of the unknowns' prior covariance ``L @ L.T``.

    What the data must decide alone (initial errors, headings, jumps of velocity) has a prior so
    wide that it only keeps the problem regular.

    Parameters
    ----------
    windows : int
        Number of windows.
    earth_rate : ndarray, shape (3,)
        Rotation of the Earth in ENU, rad/s: with a wrong latitude the INS takes it wrongly.
    """
    root = np.zeros((COMMON + PER_WINDOW * windows,) * 2)
    sigmas = np.diagonal(root).copy()
    sigmas[GYRO_BIAS], sigmas[GYRO_SLOPE] = WIDE_GYRO_BIAS, prior.bias_slope
    sigmas[ACCELEROMETER_BIAS] = prior.accelerometer_bias
    sigmas[ACCELEROMETER_DRIFT] = prior.accelerometer_drift
    matrix = np.full((3, 3), prior.gyro_misalignment)
    np.fill_diagonal(matrix, prior.gyro_scale_factor)
    sigmas[GYRO_MATRIX] = matrix.ravel()
    for window in range(windows):
        own = sigmas[COMMON + PER_WINDOW * window :][:PER_WINDOW]
        own[HEADING], own[VELOCITY] = _HEADING, _VELOCITY
        own[ATTITUDE] = prior.tilt_step if window else _FIRST_ATTITUDE
    np.fill_diagonal(root, sigmas)
    root[NAVIGATION_RATE, NAVIGATION_RATE.start] = prior.latitude * np.array([earth_rate[2], -earth_rate[1]])
    return root
