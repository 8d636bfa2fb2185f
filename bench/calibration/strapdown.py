"""Strapdown integration of increments; navigation errors at rest as white rows of a least-squares problem.

The unit stays at one place. So the integral of the specific force and gravity in the navigation frame,

    ``u(t) = integral of (C_nb f + g) dt``,

is zero whenever the unit rests, however it was turned in between; a deviation from zero is an error.
Attitude errors psi rotate vectors from the true attitude to the computed one, ENU:

    ``psi' = -w_ie x psi + C_nb dw``,   ``u' = psi x C_nb f + C_nb df``.

The same integration gives the response of psi and u to each coefficient. The noise of the sensors is
integrated twice into u and correlates all epochs. A Kalman filter whose model contains only this noise, with
the states psi, u and the psi at the start of a spin, turns data and responses into innovations that are white
with unit variance: generalised least squares without the large covariance matrix, as in
:mod:`gyrobench.bench.bias.window_filter`.

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
from gyrobench.bench.calibration.increment_recording import SensorNoise
from gyrobench.bench.calibration.turns import Vector, add_scaled, cross_product, multiply, set_turn
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray
from gyrobench.bench.foundations.kernels import compiled, multiply_3x3
from gyrobench.bench.navigation.attitude import rotation_matrices, rotation_vectors
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
_FIRST_QUADRATIC, _FIRST_G_SENSITIVITY = QUADRATIC.start, G_SENSITIVITIES.start
_FIRST_ASYMMETRY = ASYMMETRIES.start
_ROWS, _COLUMNS = LOWER
#: Rotations, rad, after which the attitude, and after which the responses are updated. In between, increments
#: are summed with their coning and sculling, and the responses use the mean attitude.
_MAX_SUM, _MAX_TURN = 2e-5, 0.01
#: Smallest noise of outputs, m/s and rad: far below the resolution of sensors.
_MIN_VELOCITY, _MIN_ANGLE = 1e-8, 1e-10


@dataclass(frozen=True, eq=False)
class IncrementEpochs:
    """Ends, rests and table rotations of n epochs of increments."""

    ends: IntArray  #: Shape (n,). Number of increments up to the end of each epoch.
    at_rest: BoolArray  #: Shape (n,). Whether the unit rests at the end of each epoch.
    #: Indices of epochs in the rests before and after whole turns, and the net rotation (3, 3), ENU, by the
    #: table's readings.
    spins: Sequence[tuple[int, int, FloatArray]]
    has_vertical: bool  #: Whether the vertical velocity is measured; otherwise its rows are zero.
    #: Indices of epochs before and after rotations about Up, and the rotation (3, 3), ENU, by the table.
    headings: Sequence[tuple[int, int, FloatArray]] = ()


def white_rows(
    trajectory: Trajectory,
    lengths_s: FloatArray,
    epochs: IncrementEpochs,
    noise: SensorNoise,
    latitude: float,
    whole_turns: float | None,
    heading: float | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Rows (m, c) and data (m,), white with unit variance, of a unit that begins at rest.

    ``trajectory`` is that of the corrected increments, with the responses to c columns; ``lengths_s``, shape
    (n,), are those of the epochs. ``whole_turns`` and ``heading`` are standard uncertainties, rad: of the
    table's return after whole turns, without which spins are rotations, and of the change of heading in the
    table's rotations about Up, which are not used without it.
    """
    n, turns = len(lengths_s), _turns(epochs, whole_turns, heading)
    starts, ends = np.full((2, n + 1), -1, np.int64)
    columns = trajectory.response.shape[2]
    stacked = np.empty((n + len(turns), 3, columns + 1))
    stacked[:n, :, :columns], stacked[:n, :, columns] = trajectory.response[1:, 3:], -trajectory.integral[1:]
    for number, (a, b, R, _) in enumerate(turns):
        starts[a], ends[b] = number, number
        stacked[n + number, :, :columns] = trajectory.response[b, :3] - R @ trajectory.response[a, :3]
        error = trajectory.attitude[b] @ trajectory.attitude[a].T @ R.T
        stacked[n + number, :, columns] = -rotation_vectors(error[np.newaxis])[0]
    white = float(np.mean(noise.white_velocity**2)) + _MIN_VELOCITY**2
    output = 2.0 * float(np.mean(noise.white_angle**2)) + _MIN_ANGLE**2
    R = np.array([each[2] for each in turns]).reshape(-1, 3, 3)
    variances = np.array([each[3] for each in turns]).reshape(-1, 3) ** 2 + output
    transition, covariance = _intervals(trajectory, lengths_s, noise, latitude)
    measured = 3 if epochs.has_vertical else 2
    whitened = _whiten(
        transition, covariance, stacked, epochs.at_rest, starts, ends, R, variances, white, measured
    )
    return whitened[:, :columns], whitened[:, columns]


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
    steps = interval_s * np.arange(np.diff(ends, prepend=0).max() + 1.0)
    earth = rotation_matrices(-earth_rate_enu(latitude) * steps[:, np.newaxis])
    half = rotation_matrices(-0.5 * earth_rate_enu(latitude) * steps[:, np.newaxis])
    attitude = np.empty((len(ends) + 1, 3, 3))
    integral = np.zeros((len(ends) + 1, 3))
    column_array = np.array(columns, np.int64)
    response = np.zeros((len(ends) + 1, 6, len(column_array)))
    attitude[0] = C_nb
    response[0, :3] = column_array == np.arange(ATTITUDE.start, ATTITUDE.stop)[:, np.newaxis]
    turns = earth, half, np.cross([1.0, 0.0, 0.0], earth_rate_enu(latitude))
    states = attitude, integral, response
    error_correction = (errors or SensorErrors()).correction(interval_s)
    correction = SensorErrors().correction(interval_s) if are_corrected else error_correction
    has_sums = any(COUNT <= each < G_SENSITIVITIES.start for each in columns)
    _integrate(
        angle, velocity, correction, error_correction, interval_s, ends, has_sums, *turns, gravity,
        column_array, *states,
    )  # fmt: skip
    return Trajectory(attitude, integral, gravity, response)


@compiled
def _corrected_increment(correction: FloatArray, measured: FloatArray) -> Vector:
    x, y, z = multiply(correction, (measured[0], measured[1], measured[2]))
    return x + correction[0, 3], y + correction[1, 3], z + correction[2, 3]


@compiled
def _integrate(
    angle: FloatArray, velocity: FloatArray, correction: FloatArray, error_correction: FloatArray,
    interval_s: float, ends: IntArray, has_sums: bool, earth: FloatArray, half: FloatArray,
    latitude_response: FloatArray, gravity: float, columns: IntArray, attitudes: FloatArray,
    integrals: FloatArray, responses: FloatArray,
) -> None:  # fmt: skip
    C, begin = attitudes[0].copy(), attitudes[0].copy()
    u = np.zeros(3)
    response = responses[0].copy()
    tilt = np.empty(3)
    # Sums over the samples since the last update of the responses: angles, and derivatives of the velocity
    # increments by lever arms, delay and quadratic terms.
    sums = np.zeros((6, 3))
    angles, delayed, squares, arms = sums[0], sums[1], sums[2], sums[3:]
    samples = summed = epoch = 0
    count = len(angle)
    turn, product, gyro_axes, force_axes = np.empty((4, 3, 3))
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
        if has_sums:
            first, last = max(k - 1, 0), min(k + 1, count - 1)
            per_s = 1.0 / ((last - first) * interval_s)
            cross = cross_product(theta, dv)
            square = theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2
            for i in range(3):
                delayed[i] -= cross[i] / interval_s
                squares[i] += dv[i] ** 2 / interval_s
                for j in range(3):
                    arms[i, j] += theta[i] * theta[j] / interval_s
                arms[i, i] -= square / interval_s
                arms[i, (i + 1) % 3] -= (angle[last, (i + 2) % 3] - angle[first, (i + 2) % 3]) * per_s
                arms[i, (i + 2) % 3] += (angle[last, (i + 1) % 3] - angle[first, (i + 1) % 3]) * per_s
        if k + 1 != ends[epoch] and alpha[0] ** 2 + alpha[1] ** 2 + alpha[2] ** 2 < _MAX_SUM**2:
            continue
        cross = cross_product(alpha, speed)
        force_sum = add_scaled(
            add_scaled(add_scaled(speed, sculling, 1.0), cross, 0.5), cross_product(alpha, cross), 1.0 / 6.0
        )
        velocity_change = multiply(half[summed], multiply(C, force_sum))
        set_turn(turn, add_scaled(alpha, coning, 1.0))
        multiply_3x3(product, C, turn)
        multiply_3x3(C, earth[summed], product)
        for i in range(3):
            angles[i] += alpha[i]
            u[i] += velocity_change[i]
        u[2] -= gravity * interval_s * summed
        samples += summed
        summed = 0
        alpha = speed = coning = sculling = (0.0, 0.0, 0.0)
        if k + 1 != ends[epoch] and angles[0] ** 2 + angles[1] ** 2 + angles[2] ** 2 < _MAX_TURN**2:
            continue
        middle, step, length_s = 0.5 * (begin + C), earth[samples], samples * interval_s
        # An error of a sensor changes the corrected increments through all scale factors and misalignments.
        multiply_3x3(gyro_axes, middle, error_correction[0])
        multiply_3x3(force_axes, middle, error_correction[1])
        # The responses use gravity as specific force. With the measured one, parameters would explain its
        # noise: a smaller scale factor reduces it, another heading rotates it.
        gravity_change = gravity * length_s
        since_middle_s = (k + 1 - 0.5 * samples - 0.5 * ends[-1]) * interval_s
        for r, c in enumerate(columns):
            for i in range(3):
                tilt[i] = response[i, r]
            # Response of the corrected increments, which are those measured minus the errors.
            if c < 3:
                for i in range(3):
                    response[i, r] -= gyro_axes[i, c] * length_s
            elif c < 12:
                for i in range(3):
                    response[i, r] -= gyro_axes[i, (c - 3) // 3] * angles[(c - 3) % 3]
            elif c < 15:
                for i in range(3):
                    response[3 + i, r] -= force_axes[i, c - 12] * length_s
            elif c < COUNT:
                for i in range(3):
                    response[3 + i, r] -= (
                        force_axes[i, _ROWS[c - 15]] * middle[2, _COLUMNS[c - 15]] * gravity_change
                    )
            elif c < DELAY:
                sensor, arm = (c - COUNT) // 3, (c - COUNT) % 3
                for i in range(3):
                    response[3 + i, r] -= middle[i, sensor] * arms[sensor, arm]
            elif c == DELAY:
                for i in range(3):
                    response[3 + i, r] += (
                        middle[i, 0] * delayed[0] + middle[i, 1] * delayed[1] + middle[i, 2] * delayed[2]
                    )
            elif c < _FIRST_G_SENSITIVITY:
                for i in range(3):
                    response[3 + i, r] -= middle[i, c - _FIRST_QUADRATIC] * squares[c - _FIRST_QUADRATIC]
            elif c < _FIRST_ASYMMETRY:
                sensor, along = (c - _FIRST_G_SENSITIVITY) // 3, (c - _FIRST_G_SENSITIVITY) % 3
                for i in range(3):
                    response[i, r] -= middle[i, sensor] * middle[2, along] * gravity_change
            elif c < PARAMETER_COUNT and abs(angles[c - _FIRST_ASYMMETRY]) > ASYMMETRY_RATE * length_s:
                for i in range(3):
                    response[i, r] -= (
                        0.5 * gyro_axes[i, c - _FIRST_ASYMMETRY] * abs(angles[c - _FIRST_ASYMMETRY])
                    )
            elif c == LATITUDE:
                for i in range(3):
                    response[i, r] -= latitude_response[i] * length_s
            elif c >= PARAMETER_COUNT + 3:
                for i in range(3):
                    response[i, r] -= gyro_axes[i, c - PARAMETER_COUNT - 3] * length_s * since_middle_s
            a, b, d = response[0, r], response[1, r], response[2, r]
            for i in range(3):
                response[i, r] = step[i, 0] * a + step[i, 1] * b + step[i, 2] * d
                tilt[i] = 0.5 * (tilt[i] + response[i, r])
            response[3, r] += tilt[1] * gravity_change
            response[4, r] -= tilt[0] * gravity_change
        # Numba takes seconds to compile the assignment of whole arrays.
        for i in range(3):
            for j in range(3):
                begin[i, j] = C[i, j]
        for i in range(6):
            for j in range(3):
                sums[i, j] = 0.0
        samples = 0
        if k + 1 == ends[epoch]:
            epoch += 1
            for i in range(3):
                integrals[epoch, i] = u[i]
                for j in range(3):
                    attitudes[epoch, i, j] = C[i, j]
            for i in range(6):
                for r in range(len(columns)):
                    responses[epoch, i, r] = response[i, r]


def attitudes(
    angle: FloatArray, interval_s: float, ends: IntArray, C_nb: FloatArray, latitude: float
) -> FloatArray:
    """Attitudes (n + 1, 3, 3) at the start and the ends of epochs, from increments of angle."""
    velocity = np.zeros_like(angle)
    return integrate_increments(angle, velocity, interval_s, ends, C_nb, latitude, 0.0, ()).attitude


def epoch_steps(
    angle: FloatArray,
    velocity: FloatArray,
    interval_s: float,
    ends: IntArray,
    C_nb: FloatArray,
    noise: SensorNoise,
    latitude: float,
    gravity: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Transition (n, 6, 6), noise (n, 6, 6) and drive (n, 6, 40) of psi and u over each epoch.

    The response to the coefficients at the end of an epoch is the transition times that at its start, plus
    the drive. For the parameters see :func:`integrate_increments`.
    """
    trajectory = integrate_increments(angle, velocity, interval_s, ends, C_nb, latitude, gravity)
    transition, covariance = _intervals(trajectory, np.diff(ends, prepend=0) * interval_s, noise, latitude)
    response = trajectory.response.copy()
    response[:, :, ATTITUDE] = 0.0
    return transition, covariance, response[1:] - transition @ response[:-1]


_Turn = tuple[int, int, FloatArray, tuple[float, float, float]]


def _turns(epochs: IncrementEpochs, whole_turns: float | None, heading: float | None) -> list[_Turn]:
    """Epochs before and after each table rotation used, the rotation (3, 3), its uncertainties E, N, U."""
    turns: dict[int, _Turn] = {}
    if heading is not None:
        turns |= {a: (a, b, R, (np.inf, np.inf, heading)) for a, b, R in epochs.headings}
    if whole_turns is not None:
        turns |= {a: (a, b, R, (whole_turns, whole_turns, whole_turns)) for a, b, R in epochs.spins}
    return list(turns.values())


def _intervals(
    trajectory: Trajectory, lengths_s: FloatArray, noise: SensorNoise, latitude: float
) -> tuple[FloatArray, FloatArray]:
    """Transition and noise (n, 6, 6) of psi and u over each epoch."""
    transition, covariance = np.zeros((2, len(lengths_s), 6, 6))
    _set_intervals(
        trajectory.attitude, trajectory.gravity, lengths_s, noise.angle_random_walk**2,
        noise.velocity_random_walk**2, earth_rate_enu(latitude), transition, covariance,
    )  # fmt: skip
    return transition, covariance


@compiled
def _set_intervals(
    attitude: FloatArray, gravity: float, lengths_s: FloatArray, angle_walk: FloatArray,
    velocity_walk: FloatArray, earth: FloatArray, transition: FloatArray, covariance: FloatArray,
) -> None:  # fmt: skip
    cross, tilts, lifts, tilts_to_velocity, twice = np.zeros((5, 3, 3))
    for n, time in enumerate(lengths_s):
        F, Q, C = transition[n], covariance[n], 0.5 * (attitude[n] + attitude[n + 1])
        set_turn(F[:3, :3], (-earth[0] * time, -earth[1] * time, -earth[2] * time))
        for i in range(3):
            F[3 + i, 3 + i] = 1.0
            for j in range(3):
                tilts[i, j] = lifts[i, j] = 0.0
                for k in range(3):
                    tilts[i, j] += time * C[i, k] * angle_walk[k] * C[j, k]
                    lifts[i, j] += time * C[i, k] * velocity_walk[k] * C[j, k]
        cross[0, 1], cross[1, 0] = gravity * time, -gravity * time  # cross @ psi = psi x force
        multiply_3x3(tilts_to_velocity, cross, tilts)
        multiply_3x3(twice, tilts_to_velocity, cross)  # the transpose of cross is its negative
        for i in range(3):
            for j in range(3):
                F[3 + i, j] = cross[i, j]
                Q[i, j], Q[3 + i, 3 + j] = tilts[i, j], lifts[i, j] - twice[i, j] / 3.0
                Q[3 + i, j] = Q[j, 3 + i] = 0.5 * tilts_to_velocity[i, j]


@compiled
def _propagate(F: FloatArray, X: FloatArray) -> None:
    """Multiply the first six rows of ``X`` by ``F`` (6, 6), whose upper right block is zero, in place."""
    for j in range(X.shape[1]):
        a, b, c = X[0, j], X[1, j], X[2, j]
        for i in range(3):
            X[i, j] = F[i, 0] * a + F[i, 1] * b + F[i, 2] * c
            X[3 + i, j] += F[3 + i, 0] * a + F[3 + i, 1] * b + F[3 + i, 2] * c


@compiled
def _correct(
    X: FloatArray, P: FloatArray, innovation: FloatArray, gain: FloatArray, spread: FloatArray,
    variance: float,
) -> None:  # fmt: skip
    """Correct states by an innovation, and scale the innovation to unit variance."""
    scale = 1.0 / np.sqrt(variance)
    for k in range(9):
        for j in range(X.shape[1]):
            X[k, j] += gain[k] * innovation[j]
        for j in range(9):
            P[k, j] -= gain[k] * spread[j]
    for j in range(X.shape[1]):
        innovation[j] *= scale


@compiled
def _whiten(
    transition: FloatArray, covariance: FloatArray, stacked: FloatArray, at_rest: BoolArray,
    starts: IntArray, ends: IntArray, rotations: FloatArray, variances: FloatArray, white: float,
    measured: int,
) -> FloatArray:  # fmt: skip
    n, columns = len(transition), stacked.shape[2]
    rows = np.zeros((3 * len(stacked), columns))
    used = 0
    X, P, gain, spread = np.zeros((9, columns)), np.zeros((9, 9)), np.empty(9), np.empty(9)
    # The initial velocity has the uncertainty of any measured one.
    for i in range(3, 6):
        P[i, i] = white
    for epoch in range(n + 1):
        if epoch > 0:
            F = transition[epoch - 1]
            _propagate(F, X)
            _propagate(F, P)
            for i in range(9):
                for j in range(i):
                    P[i, j], P[j, i] = P[j, i], P[i, j]
            _propagate(F, P)
            for i in range(6):
                for j in range(6):
                    P[i, j] += covariance[epoch - 1, i, j]
            if at_rest[epoch - 1]:
                for i in range(measured):
                    variance = P[3 + i, 3 + i] + white
                    for k in range(9):
                        spread[k] = P[3 + i, k]
                        gain[k] = P[k, 3 + i] / variance
                    for j in range(columns):
                        rows[used + i, j] = stacked[epoch - 1, i, j] - X[3 + i, j]
                    _correct(X, P, rows[used + i], gain, spread, variance)
                used += 3
        if ends[epoch] >= 0:
            for i in range(3):
                for k in range(9):
                    spread[k] = P[k, i] - P[k, 6 + i]
                variance = spread[i] - spread[6 + i] + variances[ends[epoch], i]
                for k in range(9):
                    gain[k] = spread[k] / variance
                for j in range(columns):
                    rows[used, j] = stacked[n + ends[epoch], i, j] - X[i, j] + X[6 + i, j]
                _correct(X, P, rows[used], gain, spread, variance)
                used += 1
        if starts[epoch] >= 0:
            R = rotations[starts[epoch]]
            for i in range(3):
                for j in range(columns):
                    X[6 + i, j] = R[i, 0] * X[0, j] + R[i, 1] * X[1, j] + R[i, 2] * X[2, j]
                for j in range(9):
                    P[6 + i, j] = R[i, 0] * P[0, j] + R[i, 1] * P[1, j] + R[i, 2] * P[2, j]
            for i in range(3):
                for j in range(9):
                    P[j, 6 + i] = R[i, 0] * P[j, 0] + R[i, 1] * P[j, 1] + R[i, 2] * P[j, 2]
    return rows[:used]
