"""Navigation errors at rest and after table turns as white rows of a least-squares problem.

The noise of the sensors is integrated twice into the velocity and correlates all epochs. A Kalman filter
whose model contains only this noise, with the states psi, u and the psi at the start of a spin
(:mod:`gyrobench.bench.calibration.strapdown`), turns data and responses into innovations that are white with
unit variance: generalised least squares without the large covariance matrix, as in
:mod:`gyrobench.bench.bias.window_filter`.
"""

from __future__ import annotations

import numpy as np

from gyrobench.bench.calibration.increment_recording import SensorNoise
from gyrobench.bench.calibration.section import IncrementEpochs, IncrementSection
from gyrobench.bench.calibration.strapdown import ATTITUDE, Trajectory, integrate_increments
from gyrobench.bench.calibration.turns import set_turn
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray
from gyrobench.bench.foundations.kernels import compiled, multiply_3x3
from gyrobench.bench.navigation.attitude import rotation_vectors
from gyrobench.bench.navigation.earth import earth_rate_enu

#: Smallest noise of outputs, m/s and rad: far below the resolution of sensors.
_MIN_VELOCITY, _MIN_ANGLE = 1e-8, 1e-10


def white_rows(
    section: IncrementSection,
    trajectory: Trajectory,
    noise: SensorNoise,
    latitude: float,
    whole_turns: float | None,
    heading: float | None,
) -> tuple[FloatArray, FloatArray]:
    """Rows (m, c) and data (m,), white with unit variance, of a unit that begins at rest.

    ``trajectory``: of corrected increments, with the responses to c columns. ``whole_turns``, ``heading``:
    standard uncertainties, rad, of the table's return after whole turns, without which spins are rotations,
    and of the change of heading in the table's rotations about Up, which are not used without it.
    """
    epochs, lengths_s = section.epochs, section.lengths_s
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
    return _compiled_intervals(
        trajectory.attitude, trajectory.gravity, lengths_s, noise.angle_random_walk**2,
        noise.velocity_random_walk**2, earth_rate_enu(latitude),
    )  # fmt: skip


@compiled
def _compiled_intervals(
    attitude: FloatArray, gravity: float, lengths_s: FloatArray, angle_walk: FloatArray,
    velocity_walk: FloatArray, earth: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    transition, covariance = np.zeros((len(lengths_s), 6, 6)), np.zeros((len(lengths_s), 6, 6))
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
    return transition, covariance


@compiled
def _whiten(
    transition: FloatArray, covariance: FloatArray, stacked: FloatArray, at_rest: BoolArray,
    starts: IntArray, ends: IntArray, rotations: FloatArray, variances: FloatArray, white: float,
    measured: int,
) -> FloatArray:  # fmt: skip
    """Innovations of the velocities at rest and of the turns, in units of their standard deviations.

    State: psi, u, and the psi before a turn, rotated by the table; ``X`` has its responses and data, ``P``
    its covariance.
    """
    n, columns = len(transition), stacked.shape[2]
    rows = np.zeros((3 * len(stacked), columns))
    used = 0
    X, P = np.zeros((9, columns)), np.zeros((9, 9))
    # The initial velocity has the uncertainty of any measured one.
    for i in range(3, 6):
        P[i, i] = white
    for epoch in range(n + 1):
        if epoch > 0:
            _advance(X, P, transition[epoch - 1], covariance[epoch - 1])
            if at_rest[epoch - 1]:
                _whiten_velocity(X, P, stacked[epoch - 1], rows[used:], white, measured)
                used += 3
        turn = ends[epoch]
        if turn >= 0:
            _whiten_turn(X, P, stacked[n + turn], rows[used:], variances[turn])
            used += 3
        if starts[epoch] >= 0:
            begin_turn(X, P, rotations[starts[epoch]])
    return rows[:used]


@compiled
def _advance(X: FloatArray, P: FloatArray, transition: FloatArray, covariance: FloatArray) -> None:
    """Propagate states and their covariance over an epoch."""
    propagate(transition, X)
    propagate(transition, P)
    for i in range(9):
        for j in range(i):
            P[i, j], P[j, i] = P[j, i], P[i, j]
    propagate(transition, P)
    for i in range(6):
        for j in range(6):
            P[i, j] += covariance[i, j]


@compiled
def propagate(F: FloatArray, X: FloatArray) -> None:
    """Multiply the first six rows of ``X`` by ``F`` (6, 6), whose upper right block is zero, in place."""
    for j in range(X.shape[1]):
        a, b, c = X[0, j], X[1, j], X[2, j]
        for i in range(3):
            X[i, j] = F[i, 0] * a + F[i, 1] * b + F[i, 2] * c
            X[3 + i, j] += F[3 + i, 0] * a + F[3 + i, 1] * b + F[3 + i, 2] * c


@compiled
def _whiten_velocity(
    X: FloatArray, P: FloatArray, measured: FloatArray, rows: FloatArray, white: float, count: int
) -> None:
    """Write the innovations of the first ``count`` components of a velocity to ``rows``; correct states."""
    gain, spread = np.empty(9), np.empty(9)
    for i in range(count):
        variance = P[3 + i, 3 + i] + white
        for k in range(9):
            spread[k] = P[3 + i, k]
            gain[k] = P[k, 3 + i] / variance
        for j in range(X.shape[1]):
            rows[i, j] = measured[i, j] - X[3 + i, j]
        _correct(X, P, rows[i], gain, spread, variance)


@compiled
def _whiten_turn(
    X: FloatArray, P: FloatArray, measured: FloatArray, rows: FloatArray, variances: FloatArray
) -> None:
    """Write the innovations of a turn of the attitude to ``rows``; correct states."""
    gain, spread = np.empty(9), np.empty(9)
    for i in range(3):
        for k in range(9):
            spread[k] = P[k, i] - P[k, 6 + i]
        variance = spread[i] - spread[6 + i] + variances[i]
        for k in range(9):
            gain[k] = spread[k] / variance
        for j in range(X.shape[1]):
            rows[i, j] = measured[i, j] - X[i, j] + X[6 + i, j]
        _correct(X, P, rows[i], gain, spread, variance)


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
def begin_turn(X: FloatArray, P: FloatArray, R: FloatArray) -> None:
    """Copy psi, rotated by ``R`` (3, 3), to the state of the psi before the turn."""
    for i in range(3):
        for j in range(X.shape[1]):
            X[6 + i, j] = R[i, 0] * X[0, j] + R[i, 1] * X[1, j] + R[i, 2] * X[2, j]
        for j in range(9):
            P[6 + i, j] = R[i, 0] * P[0, j] + R[i, 1] * P[1, j] + R[i, 2] * P[2, j]
    for i in range(3):
        for j in range(9):
            P[j, 6 + i] = R[i, 0] * P[j, 0] + R[i, 1] * P[j, 1] + R[i, 2] * P[j, 2]
