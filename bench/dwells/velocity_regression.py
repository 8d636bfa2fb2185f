"""Regression of the velocities of a dwell on the tilt that the INS puts out.

A tilt ``r`` since the start of a window adds a part of gravity to the accelerations, ``dV_E/dt = g r_N +
2 W_U V_N + constant`` and ``dV_N/dt = -g r_E - 2 W_U V_E + constant``. Both velocities are regressed on both
integrals of the tilt, which gives a matrix (2, 2): the identity where the velocities are right.

* Earth rate and damping by the INS are free; transient and temperature slope of the accelerometers have their
  prior uncertainty. Noise of the attitude, which makes a regression's slope smaller, is subtracted from its
  moment.
* A steady drift of each accelerometer is free in each dwell: it changes the velocity as the tilt by a bias of
  a level gyro does. From window to window it may change by its prior uncertainty, or by as much as the
  windows show where the velocities are right. The matrix then depends on the random walk of the gyros, and
  on errors whose sign a turn does not change.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.bias.damping import Damping
from gyrobench.bench.bias.dwell import Dwell, NavigationWindow
from gyrobench.bench.bias.noise_model import NoiseModel, rounding_sigma
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.bias.window_filter import EPOCH_S, TRANSIENT_S
from gyrobench.bench.foundations.arrays import FloatArray, integral
from gyrobench.bench.navigation.attitude import rotation_vector_enu
from gyrobench.bench.navigation.earth import EARTH_RATE
from gyrobench.bench.navigation.error_model import Site

#: What is left of a quartz accelerometer's 15 to 30 ug/K where they are modelled.
_USUAL_SLOPE_UG_PER_C = 2.0
#: Largest share of the tilt's moment that noise of the attitude may have.
_MAX_NOISE_SHARE = 0.1
#: Prior uncertainty of a free drift of an accelerometer, as a multiple of the declared one.
_WIDE_DRIFT = 1e4
#: Means of the epochs of a window that the regression uses.
_MEANS = 60
#: Output without any noise, m/s.
_MIN_WHITE_MPS = 1e-6
#: Parameters of a window: matrix by rows, Earth rate, damping, drift of the acceleration East and North; last
#: the velocity. Those of a dwell have the drift of each accelerometer, then its changes East and North in
#: each window. Prior uncertainty of the Earth rate about Up over its size, and of damping, 1/s.
_MATRIX, _DRIFT, _OF_WINDOW = slice(0, 4), slice(6, 8), 8
_OF_DWELL, _PRIOR_RATE, _PRIOR_DAMPING = 9, 1.0, 0.01
#: Prior uncertainty of the Earth rate where the latitude is that of the station.
_LATITUDE_RATE = 0.1


@dataclass(frozen=True, eq=False, slots=True)
class VelocityRegression:
    """What the velocities of one dwell show against the tilt."""

    #: matrix, covariance: Shapes (4,), (4, 4). By rows: velocity East and North of what the tilt leads to
    #: East and North; right velocities have the identity.
    matrix: FloatArray
    covariance: FloatArray
    #: damping, drift, drift_sigma: If the velocities are right. Drift of the accelerometers, body axes, shape
    #: (3,), m/s^3; uncertainty of the measurement, and of what is expected, shape (2, 3).
    damping: Damping
    drift: FloatArray
    drift_sigma: FloatArray


def velocity_regression(
    dwell: Dwell, site: Site, noise: NoiseModel, prior: PriorKnowledge, heading_step_rad: float
) -> VelocityRegression | None:
    """Regression of a dwell without jumps of the output; None where its attitude is too coarse.

    ``heading_step_rad``: resolution of the attitude.
    """
    # A station may declare less than a unit has.
    usual = PriorKnowledge.from_datasheet(accelerometer_slope_ug_per_c=_USUAL_SLOPE_UG_PER_C)
    wide = replace(
        prior,
        accelerometer_drift=max(prior.accelerometer_drift, usual.accelerometer_drift),
        accelerometer_transient=max(prior.accelerometer_transient, usual.accelerometer_transient),
        accelerometer_slope=max(prior.accelerometer_slope, usual.accelerometer_slope),
    )
    moments, attitude_noise, count, apart = _dwell_moments(dwell, site.gravity, noise, wide, heading_step_rad)
    if (attitude_noise > _MAX_NOISE_SHARE * np.diag(moments)[_MATRIX]).any() or not np.isfinite(
        moments
    ).all():
        return None
    values, rows, chi2 = _solved(moments, attitude_noise)
    scatter = max(1.0, chi2 / (count - _OF_WINDOW))
    if len(dwell.windows) > 1:
        scatter = max(scatter, (chi2 - apart) / (_OF_WINDOW * (len(dwell.windows) - 1)))
    covariance = np.asarray(scatter * np.linalg.inv(rows)[_MATRIX, _MATRIX])
    if not (np.linalg.eigvalsh(covariance) > 0.0).all():
        return None
    others, others_covariance = _where_right(moments, site.latitude)
    sigma = np.sqrt(scatter * np.diag(others_covariance))
    return VelocityRegression(
        matrix=values[_MATRIX],
        covariance=covariance,
        damping=Damping(float(others[1]), float(sigma[1])),
        drift=others[2:5] * wide.accelerometer_drift,
        drift_sigma=wide.accelerometer_drift * np.stack([sigma[2:5], np.ones(3)]),
    )


def _dwell_moments(
    dwell: Dwell, gravity: float, noise: NoiseModel, prior: PriorKnowledge, step_rad: float
) -> tuple[FloatArray, FloatArray, int, float]:
    """Moments (n + 1, n + 1) of the n parameters of a dwell and the velocity, white.

    And what noise of the attitude adds to those of the matrix (4,), the number of white data, and chi2 if
    each window had its own parameters.
    """
    size = _OF_DWELL + 2 * len(dwell.windows)
    moments, attitude_noise, count, apart = np.zeros((size + 1, size + 1)), np.zeros(4), 0, 0.0
    for number, window in enumerate(dwell.windows):
        of_window, added, data = _moments(window.thinned(EPOCH_S), gravity, noise, prior, step_rad)
        place = np.zeros((_OF_WINDOW + 1, size + 1))
        place[: _DRIFT.start, : _DRIFT.start] = np.eye(_DRIFT.start)
        place[_DRIFT, _DRIFT.start : _OF_DWELL] = window.C_nb[0, :2]
        place[_DRIFT, _OF_DWELL + 2 * number :][:, :2] = np.eye(2)
        place[-1, -1] = 1.0
        moments += place.T @ of_window @ place
        attitude_noise, count = attitude_noise + added, count + data
        apart += _solved(of_window, added)[2]
    return moments, attitude_noise, count, apart


def _solved(moments: FloatArray, attitude_noise: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Parameters (n,) of a window or dwell, their information (n, n), and chi2."""
    rows, left = moments[:-1, :-1] + np.diag(_prior(len(moments) - 1)), moments[:-1, -1]
    exact = rows - np.diag(np.pad(attitude_noise, (0, len(left) - 4)))
    values = np.asarray(np.linalg.solve(exact, left))
    return values, exact, float(moments[-1, -1] - 2.0 * left @ values + values @ rows @ values)


def _where_right(moments: FloatArray, latitude: float) -> tuple[FloatArray, FloatArray]:
    """Parameters (n - 4,) beside the matrix where that is the identity at this latitude; their covariance."""
    prior, right = _prior(len(moments) - 1)[4:], np.append(np.eye(2), math.sin(latitude))
    prior[0] = _LATITUDE_RATE**-2.0
    covariance = np.asarray(np.linalg.inv(moments[4:-1, 4:-1] + np.diag(prior)))
    found = covariance @ (moments[4:-1, -1] - moments[4:-1, :5] @ right)
    found[0] += right[-1]
    return found, covariance


def _prior(count: int) -> FloatArray:
    """Information (n,) on the parameters of a window or dwell that is known beforehand."""
    prior = np.full(count, _WIDE_DRIFT**-2.0)
    prior[_MATRIX], prior[4:6], prior[_OF_DWELL:] = 0.0, (_PRIOR_RATE**-2.0, _PRIOR_DAMPING**-2.0), 1.0
    return prior


def _moments(
    window: NavigationWindow, gravity: float, noise: NoiseModel, prior: PriorKnowledge, step_rad: float
) -> tuple[FloatArray, FloatArray, int]:
    """Moments (9, 9) of the parameters of a window and the velocity, white.

    And what noise of the attitude adds to those of the matrix (4,), and the number of white data.
    """
    count = len(window.time_s) // max(1, len(window.time_s) // _MEANS)
    every = len(window.time_s) // count
    time_s = window.time_s - window.time_s[0]
    rotation = rotation_vector_enu(window.C_nb, window.C_nb[0])
    velocity = window.velocity_enu_mps[:, :2]
    tilt = gravity * np.stack([rotation[:, 1], -rotation[:, 0]], axis=-1)
    turned = 2.0 * EARTH_RATE * np.stack([velocity[:, 1], -velocity[:, 0]], axis=-1)

    def means(values: FloatArray) -> FloatArray:
        return np.asarray(values[: count * every].reshape(count, every, -1).mean(axis=1))

    def integrated(values: FloatArray) -> FloatArray:
        return means(integral(values, time_s))

    begin_s, middle_s = time_s[: count * every : every], means(time_s)[:, 0]
    length_s = time_s[-1] / len(time_s) * every
    walk = np.minimum.outer(begin_s, begin_s) + 0.5 * length_s
    np.fill_diagonal(walk, begin_s + length_s / 3.0)
    walk_root = np.linalg.cholesky(walk)
    warmed_k = np.zeros(len(time_s))
    if window.accelerometer_c is not None:
        warmed_k = window.accelerometer_c - window.accelerometer_c[0]
    known = (
        prior.accelerometer_transient * TRANSIENT_S * np.exp(-middle_s / TRANSIENT_S),
        prior.accelerometer_slope * integrated(np.column_stack([warmed_k, warmed_k]))[:, 0],
    )
    white = max(noise.velocity_white, _MIN_WHITE_MPS) ** 2 / every * np.eye(count)
    others = sum(np.outer(each, each) for each in known) + white
    of_tilt = np.array([gravity**2 * EPOCH_S * _angle_noise(rotation[:, of], step_rad) for of in (1, 0)])
    signals = integrated(turned), -integrated(velocity)
    moments, added = np.zeros((_OF_WINDOW + 1,) * 2), np.zeros(4)
    line = np.stack([np.ones(count), middle_s / middle_s[-1]], axis=-1)
    for axis in range(2):
        root = np.linalg.cholesky((noise.velocity_random_walk**2 + of_tilt[axis]) * walk + others)
        rows = np.zeros((count, _OF_WINDOW + 1))
        rows[:, 2 * axis : 2 * axis + 2] = integrated(tilt)
        rows[:, 4:6] = np.stack([each[:, axis] for each in signals], axis=-1)
        rows[:, _DRIFT.start + axis] = 0.5 * prior.accelerometer_drift * middle_s**2
        rows[:, -1] = means(velocity)[:, axis]
        whitened = np.linalg.solve(root, np.hstack([line, rows, walk_root]))
        base = np.linalg.qr(whitened[:, :2])[0]
        whitened -= base @ (base.T @ whitened)
        rows, walked = whitened[:, 2 : _OF_WINDOW + 3], whitened[:, _OF_WINDOW + 3 :]
        moments += rows.T @ rows
        added[2 * axis : 2 * axis + 2] = of_tilt * float((walked**2).sum())
    return moments, added, 2 * (count - 2)


def _angle_noise(angle: FloatArray, step_rad: float) -> float:
    """Variance of the white noise of an angle (n,), rad^2."""
    changes = 1 + np.count_nonzero(np.diff(angle))
    return max(
        float(np.mean(np.diff(angle, 2) ** 2)) / 6.0, rounding_sigma(step_rad, len(angle) / changes) ** 2
    )
