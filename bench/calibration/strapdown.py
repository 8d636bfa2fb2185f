"""Strapdown integration of increments at rest and in turns, with responses to the sensors' coefficients.

The unit stays at one place. So the integral of the specific force and gravity in the navigation frame,

    ``u(t) = integral of (C_nb f + g) dt``,

is zero whenever the unit rests, however it was turned in between; a deviation from zero is an error.
Attitude errors psi rotate vectors from the true attitude to the computed one, ENU:

    ``psi' = -w_ie x psi + C_nb dw``,   ``u' = psi x C_nb f + C_nb df``.

The same integration gives the response of psi and u to each coefficient.

References
----------
Savage, "Strapdown Inertial Navigation Integration Algorithm Design", J. Guidance, Control, and Dynamics 21
(1998): coning and sculling from the increment before.
Titterton and Weston, *Strapdown Inertial Navigation Technology*, 2nd ed., chapters 11 and 12.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.calibration.coefficients import COUNT, LOWER, OPTIONAL_PARAMETERS, SensorErrors
from gyrobench.bench.calibration.turns import Vector, add_scaled, cross_product, multiply, set_turn
from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.foundations.kernels import compiled, copy_matrix, multiply_3x3
from gyrobench.bench.navigation.attitude import rotation_matrices
from gyrobench.bench.navigation.earth import earth_rate_enu

#: Columns of the responses: the coefficients; inner lever arms of the accelerometers by rows, m; delay of the
#: accelerometers, s; their quadratic terms, s^2/m; sensitivities of the gyros to the specific force by rows,
#: s/m; asymmetries of their scale factors; initial attitude error, rad; drift of the gyro biases relative to
#: those at half time, rad/s^2; latitude, rad.
LEVER_ARMS, DELAY, QUADRATIC = slice(COUNT, COUNT + 9), COUNT + 9, slice(COUNT + 10, COUNT + 13)
G_SENSITIVITIES, ASYMMETRIES = slice(COUNT + 13, COUNT + 22), slice(COUNT + 22, COUNT + 25)
#: Rate, rad/s, above which an asymmetry is modelled; at lower rates noise changes the sign of the rate.
ASYMMETRY_RATE = np.deg2rad(0.1)
PARAMETER_COUNT = COUNT + len(OPTIONAL_PARAMETERS)
ATTITUDE, DRIFT = slice(PARAMETER_COUNT, PARAMETER_COUNT + 3), slice(PARAMETER_COUNT + 3, PARAMETER_COUNT + 6)
LATITUDE = PARAMETER_COUNT + 6
_ALL = tuple(range(LATITUDE))
#: First columns of the gyro matrix, of the biases and the lower triangle of the matrix of the accelerometers,
#: and of optional parameters: kernels know no slices.
_FIRST_GYRO_ELEMENT, _FIRST_FORCE_BIAS, _FIRST_FORCE_ELEMENT = 3, 12, 15
_FIRST_QUADRATIC, _FIRST_G_SENSITIVITY = QUADRATIC.start, G_SENSITIVITIES.start
_FIRST_ASYMMETRY, _FIRST_ATTITUDE, _FIRST_DRIFT = ASYMMETRIES.start, ATTITUDE.start, DRIFT.start
_ROWS, _COLUMNS = LOWER
#: Rotations, rad, after which the attitude, and after which the responses are updated. In between, increments
#: are summed with their coning and sculling, and the responses use the mean attitude.
_MAX_SUM, _MAX_TURN = 2e-5, 0.01


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Integrated increments at the start and at the ends of n epochs."""

    attitude: FloatArray  #: Shape (n + 1, 3, 3). C_nb.
    integral: FloatArray  #: Shape (n + 1, 3). u, m/s, ENU; zero at rest if the sensors have no error.
    gravity: float  #: Gravity subtracted from the specific force, m/s^2.
    #: Shape (n + 1, 6, c). Derivatives of attitude (rad) and u (m/s) by coefficients and other columns, SI.
    response: FloatArray


def integrate_increments(
    angle: FloatArray,
    velocity: FloatArray,
    interval_s: float,
    ends: IntArray,
    C_nb: FloatArray,
    latitude: float,
    gravity: float,
    columns: Sequence[int] = _ALL,
    errors: SensorErrors | None = None,
    are_corrected: bool = False,
) -> Trajectory:
    """Integrate increments (k, 3), body axes, rad and m/s, from the attitude ``C_nb`` up to ``ends`` (n,).

    ``columns``: of the responses. ``errors``: of the sensors. ``are_corrected``: whether the increments are
    already corrected for ``errors``, as they must be with columns of optional parameters.
    """
    half_samples_s = 0.5 * interval_s * np.arange(2.0 * np.diff(ends, prepend=0).max() + 1.0)
    earth = rotation_matrices(-earth_rate_enu(latitude) * half_samples_s[:, np.newaxis])
    latitude_response = np.cross([1.0, 0.0, 0.0], earth_rate_enu(latitude))
    error_correction = (errors or SensorErrors()).correction(interval_s)
    correction = SensorErrors().correction(interval_s) if are_corrected else error_correction
    attitude, integral, response = _integrate(
        angle, velocity, correction, error_correction, interval_s, ends, C_nb, earth, latitude_response,
        gravity, np.array(columns, np.int64),
    )  # fmt: skip
    return Trajectory(attitude, integral, gravity, response)


@compiled
def _integrate(
    angle: FloatArray, velocity: FloatArray, correction: FloatArray, error_correction: FloatArray,
    interval_s: float, ends: IntArray, start: FloatArray, earth: FloatArray, latitude_response: FloatArray,
    gravity: float, columns: IntArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Attitudes, integrals and responses at the start and at the ends of the epochs.

    ``correction``, ``error_correction`` (2, 3, 4): of the increments, and of the sensors' errors; ``start``
    (3, 3): C_nb; ``earth`` (s, 3, 3): the Earth's rotation in 0, 1, ... half samples.
    """
    attitudes, integrals = np.empty((len(ends) + 1, 3, 3)), np.zeros((len(ends) + 1, 3))
    responses, has_sums = np.zeros((len(ends) + 1, 6, len(columns))), False
    for r, column in enumerate(columns):
        has_sums |= COUNT <= column < _FIRST_G_SENSITIVITY
        for i in range(3):
            responses[0, i, r] = column == _FIRST_ATTITUDE + i
    copy_matrix(attitudes[0], start)
    C, begin = start.copy(), start.copy()
    u, angles, sums = np.zeros(3), np.zeros(3), np.zeros((5, 3))
    response, drive = responses[0].copy(), np.zeros((6, LATITUDE + 1))
    middle, turn, product, gyro_axes, force_axes = np.empty((5, 3, 3))
    samples = summed = epoch = 0
    theta = dv = alpha = speed = coning = sculling = (0.0, 0.0, 0.0)
    for k in range(ends[-1]):
        theta_before, dv_before = theta, dv
        theta = _corrected_increment(correction[0], angle[k])
        dv = _corrected_increment(correction[1], velocity[k])
        if k == 0:
            theta_before, dv_before = theta, dv
        before = add_scaled(alpha, theta_before, 1.0 / 6.0)
        coning = add_scaled(coning, cross_product(before, theta), 0.5)
        sculling = add_scaled(sculling, cross_product(before, dv), 0.5)
        sculling = add_scaled(sculling, cross_product(add_scaled(speed, dv_before, 1.0 / 6.0), theta), 0.5)
        alpha, speed = add_scaled(alpha, theta, 1.0), add_scaled(speed, dv, 1.0)
        summed += 1
        is_end = k + 1 == ends[epoch]
        if not is_end and _square(alpha) < _MAX_SUM**2:
            continue
        velocity_change = multiply(earth[summed], multiply(C, _force_sum(alpha, speed, sculling)))
        set_turn(turn, add_scaled(alpha, coning, 1.0))
        multiply_3x3(product, C, turn)
        multiply_3x3(C, earth[2 * summed], product)
        for i in range(3):
            angles[i] += alpha[i]
            u[i] += velocity_change[i]
        u[2] -= gravity * interval_s * summed
        samples += summed
        summed = 0
        alpha = speed = coning = sculling = (0.0, 0.0, 0.0)
        if not is_end and _square((angles[0], angles[1], angles[2])) < _MAX_TURN**2:
            continue
        for i in range(3):
            for j in range(3):
                middle[i, j] = 0.5 * (begin[i, j] + C[i, j])
                begin[i, j] = C[i, j]
        # An error of a sensor changes the corrected increments through all scale factors and misalignments.
        multiply_3x3(gyro_axes, middle, error_correction[0])
        multiply_3x3(force_axes, middle, error_correction[1])
        length_s = samples * interval_s
        since_middle_s = (k + 1 - 0.5 * samples - 0.5 * ends[-1]) * interval_s
        if has_sums:
            _set_sums(sums, angle, velocity, k + 1 - samples, k + 1, interval_s)
        _set_gyro_drive(drive, middle, gyro_axes, angles, length_s, since_middle_s, gravity * length_s)
        _set_force_drive(drive, middle, force_axes, sums, length_s, gravity * length_s)
        for i in range(3):
            drive[i, LATITUDE] = latitude_response[i] * length_s
            angles[i] = 0.0
        _update_responses(response, columns, drive, earth[2 * samples], gravity * length_s)
        samples = 0
        if is_end:
            epoch += 1
            copy_matrix(attitudes[epoch], C)
            copy_matrix(responses[epoch], response)
            for i in range(3):
                integrals[epoch, i] = u[i]
    return attitudes, integrals, responses


@compiled
def _corrected_increment(correction: FloatArray, measured: FloatArray) -> Vector:
    x, y, z = multiply(correction, (measured[0], measured[1], measured[2]))
    return x + correction[0, 3], y + correction[1, 3], z + correction[2, 3]


@compiled
def _square(a: Vector) -> float:
    return a[0] ** 2 + a[1] ** 2 + a[2] ** 2


@compiled
def _force_sum(alpha: Vector, speed: Vector, sculling: Vector) -> Vector:
    """Change of velocity over summed increments, in the axes at their start."""
    cross = cross_product(alpha, speed)
    rotated = add_scaled(add_scaled(speed, sculling, 1.0), cross, 0.5)
    return add_scaled(rotated, cross_product(alpha, cross), 1.0 / 6.0)


@compiled
def _set_sums(
    sums: FloatArray, angle: FloatArray, velocity: FloatArray, begin: int, end: int, interval_s: float
) -> None:
    """Derivatives of the velocity by optional parameters, summed over corrected increments, to ``sums``.

    Rows of ``sums`` (5, 3): by the delay, by the quadratic terms, and of each accelerometer by its lever arm.
    """
    for i in range(5):
        for j in range(3):
            sums[i, j] = 0.0
    for k in range(begin, end):
        theta = angle[k, 0], angle[k, 1], angle[k, 2]
        dv = velocity[k, 0], velocity[k, 1], velocity[k, 2]
        first, last = max(k - 1, 0), min(k + 1, len(angle) - 1)
        per_s = 1.0 / ((last - first) * interval_s)
        cross, square = cross_product(theta, dv), _square(theta)
        for i in range(3):
            y, z = (i + 1) % 3, (i + 2) % 3
            sums[0, i] -= cross[i] / interval_s
            sums[1, i] += dv[i] ** 2 / interval_s
            for j in range(3):
                sums[2 + i, j] += theta[i] * theta[j] / interval_s
            sums[2 + i, i] -= square / interval_s
            sums[2 + i, y] -= (angle[last, z] - angle[first, z]) * per_s
            sums[2 + i, z] += (angle[last, y] - angle[first, y]) * per_s


@compiled
def _set_gyro_drive(
    drive: FloatArray, middle: FloatArray, axes: FloatArray, angles: FloatArray, length_s: float,
    since_middle_s: float, gravity_change: float,
) -> None:  # fmt: skip
    """Set errors of the rotation over an interval by the parameters of the gyros, in ``drive`` (6, 53)."""
    for i in range(3):
        for sensor in range(3):
            drive[i, sensor] = axes[i, sensor] * length_s
            drive[i, _FIRST_DRIFT + sensor] = axes[i, sensor] * length_s * since_middle_s
            angle = abs(angles[sensor])
            is_turning = angle > ASYMMETRY_RATE * length_s
            drive[i, _FIRST_ASYMMETRY + sensor] = 0.5 * axes[i, sensor] * angle if is_turning else 0.0
            for j in range(3):
                drive[i, _FIRST_GYRO_ELEMENT + 3 * sensor + j] = axes[i, sensor] * angles[j]
                drive[i, _FIRST_G_SENSITIVITY + 3 * sensor + j] = (
                    middle[i, sensor] * middle[2, j] * gravity_change
                )


@compiled
def _set_force_drive(
    drive: FloatArray, middle: FloatArray, axes: FloatArray, sums: FloatArray, length_s: float,
    gravity_change: float,
) -> None:  # fmt: skip
    """Set errors of the velocity over an interval by the parameters of the accelerometers."""
    for i in range(3):
        for sensor in range(3):
            drive[3 + i, _FIRST_FORCE_BIAS + sensor] = axes[i, sensor] * length_s
            drive[3 + i, _FIRST_QUADRATIC + sensor] = middle[i, sensor] * sums[1, sensor]
            for j in range(3):
                drive[3 + i, COUNT + 3 * sensor + j] = middle[i, sensor] * sums[2 + sensor, j]
        for number in range(6):
            sensor, j = _ROWS[number], _COLUMNS[number]
            drive[3 + i, _FIRST_FORCE_ELEMENT + number] = axes[i, sensor] * middle[2, j] * gravity_change
        drive[3 + i, DELAY] = -(
            middle[i, 0] * sums[0, 0] + middle[i, 1] * sums[0, 1] + middle[i, 2] * sums[0, 2]
        )


@compiled
def _update_responses(
    response: FloatArray, columns: IntArray, drive: FloatArray, earth: FloatArray, gravity_change: float
) -> None:
    """Update responses (6, c) over an interval; corrected increments are those measured minus the errors.

    The specific force is gravity. With the measured one, parameters would explain its noise: a smaller scale
    factor reduces it, another heading rotates it.
    """
    for r, column in enumerate(columns):
        east, north = response[0, r], response[1, r]
        for i in range(6):
            response[i, r] -= drive[i, column]
        a, b, c = response[0, r], response[1, r], response[2, r]
        for i in range(3):
            response[i, r] = earth[i, 0] * a + earth[i, 1] * b + earth[i, 2] * c
        response[3, r] += 0.5 * (north + response[1, r]) * gravity_change
        response[4, r] -= 0.5 * (east + response[0, r]) * gravity_change


def attitudes(
    angle: FloatArray, interval_s: float, ends: IntArray, C_nb: FloatArray, latitude: float
) -> FloatArray:
    """Attitudes (n + 1, 3, 3) at the start and the ends of epochs, from increments of angle."""
    velocity = np.zeros_like(angle)
    return integrate_increments(angle, velocity, interval_s, ends, C_nb, latitude, 0.0, ()).attitude
