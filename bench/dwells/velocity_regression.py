"""Regression of the velocities of a dwell on the tilt in the output of the INS.

A tilt ``r`` since the start of a window adds a component of gravity to the accelerations, ``dV_E/dt = g r_N +
2 W_U V_N + constant`` and ``dV_N/dt = -g r_E - 2 W_U V_E + constant``. Both velocities are regressed on both
integrals of the tilt, which gives a matrix (2, 2): the identity if the velocities are correct.

* Earth rate and damping by the INS are free parameters; transient and temperature slope of the accelerometers
  have their prior uncertainty. Noise of the attitude, which reduces the slope of a regression, is subtracted
  from its moment.
* A steady drift of each accelerometer is a free parameter of each dwell, since it changes the velocity as the
  tilt by a bias of a level gyro does. From window to window it may change by its prior uncertainty, or by the
  change estimated with correct velocities. The matrix then depends on the random walk of the gyros, and on
  errors that a turn does not reverse. Wrong velocities seem to be a drift, in proportion to the biases of the
  level gyros, which several positions distinguish from a drift of the accelerometers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.bias.damping import Damping
from gyrobench.bench.bias.dwell import Dwell, NavigationWindow
from gyrobench.bench.bias.noise_model import rounding_sigma
from gyrobench.bench.bias.parameters import ErrorModel, PriorKnowledge
from gyrobench.bench.bias.window_filter import EPOCH_S, TRANSIENT_S
from gyrobench.bench.foundations.arrays import FloatArray, integral
from gyrobench.bench.navigation.attitude import rotation_vector_enu
from gyrobench.bench.navigation.earth import EARTH_RATE

#: Usual remainder of a quartz accelerometer's slope of 15 to 30 ug/K after compensation.
_USUAL_SLOPE_UG_PER_C = 2.0
#: Largest share of the attitude noise in the moment of the tilt.
_MAX_NOISE_SHARE = 0.1
#: Prior uncertainty of a free drift of an accelerometer, as a multiple of the declared one.
_WIDE_DRIFT = 1e4
#: The regression averages the epochs of a window to this number of means.
_MEANS = 60
#: Smallest noise of the velocity output, m/s.
_MIN_WHITE_MPS = 1e-6
#: Parameters of a window: matrix by rows, Earth rate, damping, drift of the acceleration East and North; last
#: the velocity. Those of a dwell have the drift of each accelerometer, then its changes East and North in
#: each window. Prior uncertainty of the Earth rate about Up over its size, and of damping, 1/s.
_MATRIX, _DRIFT, _WINDOW_COUNT = slice(0, 4), slice(6, 8), 8
_DWELL_COUNT, _PRIOR_RATE, _PRIOR_DAMPING = 9, 1.0, 0.01
#: Prior uncertainty of the Earth rate about Up if the latitude is that of the station.
_LATITUDE_RATE = 0.1


@dataclass(frozen=True, eq=False, slots=True)
class VelocityRegression:
    """Regression of the velocities of one dwell on the tilt."""

    #: matrix, covariance: Shapes (4,), (4, 4). By rows: response of velocity East and North to the velocities
    #: due to the tilt; the identity if the velocities are correct.
    matrix: FloatArray
    covariance: FloatArray
    #: damping, drift, drift_sigma: For correct velocities. Drift of the accelerometers, body axes, shape
    #: (3,), m/s^3; uncertainty of the measurement and the expected standard deviation, shape (2, 3).
    damping: Damping
    drift: FloatArray
    drift_sigma: FloatArray
    #: drift_response, drift_covariance: Shapes (3, 4), (3, 3). Change of the drift that a unit of each
    #: element of the matrix seems to be, and the covariance of its measurement and expected size.
    drift_response: FloatArray
    drift_covariance: FloatArray


def velocity_regression(
    dwell: Dwell, model: ErrorModel, heading_step_rad: float
) -> VelocityRegression | None:
    """Regression of a dwell without jumps of the output; None if its attitude is too coarse.

    ``heading_step_rad``: resolution of the attitude.
    """
    # A station file may declare less than the unit really has.
    usual = PriorKnowledge.from_datasheet(accelerometer_slope_ug_per_c=_USUAL_SLOPE_UG_PER_C)
    prior = model.prior
    widened = replace(
        prior,
        accelerometer_drift=max(prior.accelerometer_drift, usual.accelerometer_drift),
        accelerometer_transient=max(prior.accelerometer_transient, usual.accelerometer_transient),
        accelerometer_slope=max(prior.accelerometer_slope, usual.accelerometer_slope),
    )
    moments, attitude_noise, count, separate_chi2 = _dwell_moments(
        dwell, replace(model, prior=widened), heading_step_rad
    )
    if (attitude_noise > _MAX_NOISE_SHARE * np.diag(moments)[_MATRIX]).any() or not np.isfinite(
        moments
    ).all():
        return None
    values, rows, chi2 = _solve(moments, attitude_noise)
    scatter = max(1.0, chi2 / (count - _WINDOW_COUNT))
    if len(dwell.windows) > 1:
        scatter = max(scatter, (chi2 - separate_chi2) / (_WINDOW_COUNT * (len(dwell.windows) - 1)))
    covariance = np.asarray(scatter * np.linalg.inv(rows)[_MATRIX, _MATRIX])
    if not (np.linalg.eigvalsh(covariance) > 0.0).all():
        return None
    others, others_covariance, response = _solve_for_identity(moments, model.site.latitude)
    sigma = np.sqrt(scatter * np.diag(others_covariance))
    drift, drift_unit = slice(2, 5), widened.accelerometer_drift
    return VelocityRegression(
        matrix=values[_MATRIX],
        covariance=covariance,
        damping=Damping(float(others[1]), float(sigma[1])),
        drift=others[drift] * drift_unit,
        drift_sigma=drift_unit * np.stack([sigma[drift], np.ones(3)]),
        drift_response=drift_unit * response[drift],
        drift_covariance=drift_unit**2 * (scatter * others_covariance[drift, drift] + np.eye(3)),
    )


def _dwell_moments(
    dwell: Dwell, model: ErrorModel, step_rad: float
) -> tuple[FloatArray, FloatArray, int, float]:
    """Moments (n + 1, n + 1) of the n parameters of a dwell and the velocity, whitened.

    Also returns the moments (4,) that noise of the attitude adds to those of the matrix, the number of white
    data, and the chi2 if each window has its own parameters.
    """
    size = _DWELL_COUNT + 2 * len(dwell.windows)
    moments, attitude_noise, count, separate_chi2 = np.zeros((size + 1, size + 1)), np.zeros(4), 0, 0.0
    for number, window in enumerate(dwell.windows):
        window_moments, noise_moments, data = _window_moments(window.thinned(EPOCH_S), model, step_rad)
        to_dwell = np.zeros((_WINDOW_COUNT + 1, size + 1))
        to_dwell[: _DRIFT.start, : _DRIFT.start] = np.eye(_DRIFT.start)
        to_dwell[_DRIFT, _DRIFT.start : _DWELL_COUNT] = window.C_nb[0, :2]
        to_dwell[_DRIFT, _DWELL_COUNT + 2 * number :][:, :2] = np.eye(2)
        to_dwell[-1, -1] = 1.0
        moments += to_dwell.T @ window_moments @ to_dwell
        attitude_noise, count = attitude_noise + noise_moments, count + data
        separate_chi2 += _solve(window_moments, noise_moments)[2]
    return moments, attitude_noise, count, separate_chi2


def _solve(moments: FloatArray, attitude_noise: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Parameters (n,) of a window or dwell, their information (n, n), and chi2."""
    normal, products = moments[:-1, :-1] + np.diag(_prior(len(moments) - 1)), moments[:-1, -1]
    information = normal - np.diag(np.pad(attitude_noise, (0, len(products) - 4)))
    values = np.asarray(np.linalg.solve(information, products))
    chi2 = float(moments[-1, -1] - 2.0 * products @ values + values @ normal @ values)
    return values, information, chi2


def _solve_for_identity(moments: FloatArray, latitude: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Parameters (n - 4,) except the matrix, which is the identity at this latitude; their covariance.

    Also returns their response (n - 4, 4) to the elements of the matrix.
    """
    prior, reference = _prior(len(moments) - 1)[4:], np.append(np.eye(2), math.sin(latitude))
    prior[0] = _LATITUDE_RATE**-2.0
    covariance = np.asarray(np.linalg.inv(moments[4:-1, 4:-1] + np.diag(prior)))
    parameters = covariance @ (moments[4:-1, -1] - moments[4:-1, :5] @ reference)
    parameters[0] += reference[-1]
    return parameters, covariance, covariance @ moments[4:-1, _MATRIX]


def _prior(count: int) -> FloatArray:
    """Prior information (n,) on the parameters of a window or dwell."""
    prior = np.full(count, _WIDE_DRIFT**-2.0)
    prior[_MATRIX], prior[4:6], prior[_DWELL_COUNT:] = 0.0, (_PRIOR_RATE**-2.0, _PRIOR_DAMPING**-2.0), 1.0
    return prior


def _window_moments(
    window: NavigationWindow, model: ErrorModel, step_rad: float
) -> tuple[FloatArray, FloatArray, int]:
    """Moments (9, 9) of the parameters of a window and the velocity, whitened.

    Also returns the moments (4,) that noise of the attitude adds to those of the matrix, and the number of
    white data.
    """
    gravity, noise, prior = model.site.gravity, model.noise, model.prior
    count = len(window.time_s) // max(1, len(window.time_s) // _MEANS)
    every = len(window.time_s) // count
    time_s = window.time_s - window.time_s[0]
    rotation = rotation_vector_enu(window.C_nb, window.C_nb[0])
    velocity = window.velocity_enu_mps[:, :2]
    tilt = gravity * np.stack([rotation[:, 1], -rotation[:, 0]], axis=-1)
    coriolis = 2.0 * EARTH_RATE * np.stack([velocity[:, 1], -velocity[:, 0]], axis=-1)

    def means(values: FloatArray) -> FloatArray:
        return np.asarray(values[: count * every].reshape(count, every, -1).mean(axis=1))

    def integrated(values: FloatArray) -> FloatArray:
        return means(integral(values, time_s))

    begin_s, middle_s = time_s[: count * every : every], means(time_s)[:, 0]
    length_s = time_s[-1] / len(time_s) * every
    walk = np.minimum.outer(begin_s, begin_s) + 0.5 * length_s
    np.fill_diagonal(walk, begin_s + length_s / 3.0)
    walk_root = np.linalg.cholesky(walk)
    changes_k = np.zeros(len(time_s))
    if window.accelerometer_c is not None:
        changes_k = window.accelerometer_c - window.accelerometer_c[0]
    prior_effects = (
        prior.accelerometer_transient * TRANSIENT_S * np.exp(-middle_s / TRANSIENT_S),
        prior.accelerometer_slope * integrated(np.column_stack([changes_k, changes_k]))[:, 0],
    )
    white = max(noise.velocity_white, _MIN_WHITE_MPS) ** 2 / every * np.eye(count)
    others = sum(np.outer(each, each) for each in prior_effects) + white
    tilt_noise = np.array([gravity**2 * EPOCH_S * _angle_noise(rotation[:, k], step_rad) for k in (1, 0)])
    signals = integrated(coriolis), -integrated(velocity)
    moments, noise_moments = np.zeros((_WINDOW_COUNT + 1,) * 2), np.zeros(4)
    line = np.stack([np.ones(count), middle_s / middle_s[-1]], axis=-1)
    for axis in range(2):
        root = np.linalg.cholesky((noise.velocity_random_walk**2 + tilt_noise[axis]) * walk + others)
        rows = np.zeros((count, _WINDOW_COUNT + 1))
        rows[:, 2 * axis : 2 * axis + 2] = integrated(tilt)
        rows[:, 4:6] = np.stack([each[:, axis] for each in signals], axis=-1)
        rows[:, _DRIFT.start + axis] = 0.5 * prior.accelerometer_drift * middle_s**2
        rows[:, -1] = means(velocity)[:, axis]
        whitened = np.linalg.solve(root, np.hstack([line, rows, walk_root]))
        line_basis = np.linalg.qr(whitened[:, :2])[0]
        whitened -= line_basis @ (line_basis.T @ whitened)
        rows, whitened_walk = whitened[:, 2 : _WINDOW_COUNT + 3], whitened[:, _WINDOW_COUNT + 3 :]
        moments += rows.T @ rows
        noise_moments[2 * axis : 2 * axis + 2] = tilt_noise * float((whitened_walk**2).sum())
    return moments, noise_moments, 2 * (count - 2)


def _angle_noise(angle: FloatArray, step_rad: float) -> float:
    """Variance of the white noise of an angle (n,), rad^2."""
    changes = 1 + np.count_nonzero(np.diff(angle))
    return max(
        float(np.mean(np.diff(angle, 2) ** 2)) / 6.0, rounding_sigma(step_rad, len(angle) / changes) ** 2
    )
