"""Velocity at rest and whole turns as white rows of a least-squares problem.

The noise of the sensors is integrated twice into the velocity and correlates all epochs. A Kalman filter
that knows this noise alone, with the states psi, u and the psi at the start of a spin, turns data and
responses into innovations that are white with unit variance: generalised least squares without its large
matrix, as in :mod:`gyrobench.bench.bias.window_filter`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gyrobench.bench.calibration.recording import SensorNoise
from gyrobench.bench.calibration.strapdown import COLUMNS, Trajectory
from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray
from gyrobench.bench.foundations.kernels import compiled
from gyrobench.bench.navigation.attitude import rotation_matrices, rotation_vectors
from gyrobench.bench.navigation.earth import earth_rate_enu

#: Noise of outputs without any, m/s and rad: far below what sensors resolve.
_MIN_VELOCITY, _MIN_ANGLE = 1e-8, 1e-10


def white_rows(
    trajectory: Trajectory,
    lengths_s: FloatArray,
    at_rest: BoolArray,
    spins: Sequence[tuple[int, int]],
    noise: SensorNoise,
    latitude: float,
    table: float,
) -> tuple[FloatArray, FloatArray]:
    """Rows (m, 34) and data (m,), white with unit variance.

    Parameters
    ----------
    lengths_s : ndarray, shape (n,)
        Length of each epoch.
    at_rest : ndarray, shape (n,)
        Whether the unit rests at the end of each.
    spins : sequence of (int, int)
        Epochs, counted from 0 at the start, in the rests before and after whole turns.
    table : float
        Standard uncertainty, rad, of the table's return after whole turns.
    """
    n = len(lengths_s)
    starts, ends = np.zeros(n + 1, np.int64), np.full(n + 1, -1, np.int64)
    turned = (trajectory.response[b, :3] - trajectory.response[a, :3] for a, b in spins)
    rows = [*trajectory.response[1:, 3:], *turned]
    data = [*-trajectory.integral[1:], *(_returned(trajectory, a, b) for a, b in spins)]
    for number, (a, b) in enumerate(spins):
        starts[a], ends[b] = 1, n + number
    white = float(np.mean(noise.white_velocity**2)) + _MIN_VELOCITY**2
    turn = table**2 + 2.0 * float(np.mean(noise.white_angle**2)) + _MIN_ANGLE**2
    stacked = np.concatenate([np.array(rows), np.array(data)[:, :, np.newaxis]], axis=2)
    transition, covariance = _intervals(trajectory, lengths_s, noise, latitude)
    whitened = _whiten(transition, covariance, stacked, at_rest, starts, ends, white, turn)
    return whitened[:, :COLUMNS], whitened[:, COLUMNS]


def _returned(trajectory: Trajectory, a: int, b: int) -> FloatArray:
    """Error (3,) of the computed attitude, negated, after whole turns, which return to where they started."""
    turn = trajectory.attitude[b] @ trajectory.attitude[a].T
    return np.asarray(-rotation_vectors(turn[np.newaxis])[0])


def _intervals(
    trajectory: Trajectory, lengths_s: FloatArray, noise: SensorNoise, latitude: float
) -> tuple[FloatArray, FloatArray]:
    """Transition and noise (n, 6, 6) of psi and u over each epoch."""
    n = len(lengths_s)
    cross = np.cross(trajectory.force[:, np.newaxis, :], np.eye(3))  # cross @ psi = psi x force
    C = 0.5 * (trajectory.attitude[1:] + trajectory.attitude[:-1])
    gyro = C * noise.angle_random_walk**2 @ C.transpose(0, 2, 1)
    force = C * noise.velocity_random_walk**2 @ C.transpose(0, 2, 1)
    time = lengths_s[:, np.newaxis, np.newaxis]
    transition, covariance = np.zeros((2, n, 6, 6))
    transition[:, :3, :3] = rotation_matrices(-earth_rate_enu(latitude) * lengths_s[:, np.newaxis])
    transition[:, 3:, :3] = cross
    transition[:, 3:, 3:] = np.eye(3)
    covariance[:, :3, :3] = gyro * time
    covariance[:, 3:, :3] = 0.5 * cross @ gyro * time
    covariance[:, :3, 3:] = covariance[:, 3:, :3].transpose(0, 2, 1)
    covariance[:, 3:, 3:] = force * time + cross @ gyro @ cross.transpose(0, 2, 1) * time / 3.0
    return transition, covariance


@compiled
def _whiten(
    transition: FloatArray, covariance: FloatArray, stacked: FloatArray, at_rest: BoolArray,
    starts: IntArray, ends: IntArray, white: float, turn: float,
) -> FloatArray:  # fmt: skip
    n, columns = len(transition), stacked.shape[2]
    rows = np.empty((3 * len(stacked), columns))
    used = 0
    X, P = np.zeros((9, columns)), np.zeros((9, 9))
    # The velocity at the start is as uncertain as any that is measured.
    for i in range(3, 6):
        P[i, i] = white
    for epoch in range(n + 1):
        if epoch > 0:
            F, Q = transition[epoch - 1], covariance[epoch - 1]
            X[:6] = F @ X[:6]
            P[:6] = F @ P[:6]
            P = P.T.copy()
            P[:6] = F @ P[:6]
            P[:6, :6] += Q
            if at_rest[epoch - 1]:
                for i in range(3):
                    gain = P[:, 3 + i] / (P[3 + i, 3 + i] + white)
                    scale = 1.0 / np.sqrt(P[3 + i, 3 + i] + white)
                    innovation = stacked[epoch - 1, i] - X[3 + i]
                    X += np.outer(gain, innovation)
                    P -= np.outer(gain, P[3 + i].copy())
                    rows[used] = innovation * scale
                    used += 1
        if ends[epoch] >= 0:
            for i in range(3):
                spread = P[:, i] - P[:, 6 + i]
                variance = spread[i] - spread[6 + i] + turn
                innovation = stacked[ends[epoch], i] - X[i] + X[6 + i]
                X += np.outer(spread / variance, innovation)
                P -= np.outer(spread / variance, spread)
                rows[used] = innovation / np.sqrt(variance)
                used += 1
        if starts[epoch]:
            X[6:] = X[:3]
            P[6:] = P[:3]
            P[:, 6:] = P[:, :3]
    return rows[:used]
