"""Estimates the gyro bias from a turn of 180 deg by the paper's method, as one rule for all six positions.

A level gyro's bias makes the velocity error grow with the square of time. After a turn of 180 deg it acts in
the opposite direction, while errors fixed in the navigation frame do not. The vertical gyro's bias turns the
heading. The equations (10) and (12) to (16) of the paper are this rule, resolved in the body axes of each
position.

The method neglects the Earth-rate and Schuler coupling of the errors. Over windows of 10 min the bias of a
level gyro is wrong by 8 to 17 %, and up to 20 % of the bias of one axis leaks into another.

References
----------
Yu et al., "The Six-Position Calibration Technique of Gyro Bias for Rotational Inertial
Navigation System Based on Ring Laser Gyroscope", sections 3 and 4.
"""

from __future__ import annotations

from math import factorial

import numpy as np

from gyrobench.bench.bias.dwell import BiasEstimate, Dwell, NavigationWindow
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.attitude import UP, angle_between, rotation_matrix, rotation_vector_enu

#: Largest deviation of the turn from half a turn about the vertical, rad.
TURN_TOLERANCE = np.deg2rad(1.0)


class PolynomialTrend:
    """Highest derivative of a least-squares polynomial in time, as ``weights`` (n,) of the values."""

    def __init__(self, time: FloatArray, degree: int) -> None:
        middle, half = 0.5 * (time[0] + time[-1]), 0.5 * (time[-1] - time[0])
        basis, triangle = np.linalg.qr(np.vander((time - middle) / half, degree + 1, increasing=True))
        self.weights = factorial(degree) / (triangle[degree, degree] * half**degree) * basis[:, degree]


class _WindowSlopes:
    """Slope of the heading and second derivative of the velocity in one window."""

    def __init__(self, window: NavigationWindow) -> None:
        time = window.time_s - window.time_s[0]
        heading = rotation_vector_enu(window.C_nb, window.C_nb[0])[:, 2]
        self.quadratic = PolynomialTrend(time, 2)
        self.linear = PolynomialTrend(time, 1)
        self.velocity_second_slope_en = window.velocity_enu_mps[:, :2].T @ self.quadratic.weights
        self.heading_slope = float(heading @ self.linear.weights)


def estimate_paper(dwell: Dwell, gravity: float, noise: NoiseModel) -> BiasEstimate:
    """Estimate the gyro bias of one dwell by the paper's method; ``gravity`` in m/s^2.

    The noise affects only the covariance, which does not include the leaks of the method. Raises
    MeasurementError if there are not two windows with a turn of 180 deg about the vertical between them.
    """
    _check_half_turn(dwell)
    before, after = (_WindowSlopes(window) for window in dwell.windows)
    east, north = (before.velocity_second_slope_en - after.velocity_second_slope_en) / (2.0 * gravity)
    up = 0.5 * (before.heading_slope + after.heading_slope)
    C_bn = dwell.C_nb_table[0].T
    return BiasEstimate(
        bias_radps=C_bn @ np.array([-north, east, up]),
        covariance=C_bn @ np.diag(_variances_enu(dwell, before, after, gravity, noise)) @ C_bn.T,
    )


def _variances_enu(
    dwell: Dwell, before: _WindowSlopes, after: _WindowSlopes, gravity: float, noise: NoiseModel
) -> tuple[float, float, float]:
    """Variances of the bias East, North and Up; noise before the turn also acts after it."""
    time = np.concatenate([window.time_s for window in dwell.windows]) - dwell.windows[0].time_s[0]
    second = np.concatenate([before.quadratic.weights, -after.quadratic.weights]) / (2.0 * gravity)
    first = np.concatenate([before.linear.weights, after.linear.weights]) / 2.0
    level = float(noise.velocity_variance(time, second, gravity))
    return level, level, float(noise.heading_variance(time, first))


def _check_half_turn(dwell: Dwell) -> None:
    if len(dwell.windows) != 2:
        raise MeasurementError(
            f"{dwell.position_name}: {len(dwell.windows)} windows of navigation; the paper's method takes "
            "two, one on each side of a turn by 180 deg"
        )
    half_turned = rotation_matrix(UP, np.pi) @ dwell.C_nb_table[0]
    deviation = angle_between(dwell.C_nb_table[1], half_turned)
    if deviation > TURN_TOLERANCE:
        raise MeasurementError(
            f"{dwell.position_name}: the paper's method needs a turn of 180 deg about the vertical; this one "
            f"is {np.rad2deg(deviation):.1f} deg away from it. Turn by 180 or -180 deg"
        )
