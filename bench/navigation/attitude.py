"""Rotation matrices and vectors, small rotations in ENU, and the Euler angles of the paper.

Yaw is positive about Up, that is from East towards North; pitch is a rotation about body x, roll about
body y.

References
----------
Yu et al., "The Six-Position Calibration Technique of Gyro Bias for Rotational Inertial
Navigation System Based on Ring Laser Gyroscope", section 4.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gyrobench.bench.foundations.arrays import FloatArray

#: Up in the navigation frame.
UP = np.array([0.0, 0.0, 1.0])
#: Shape (3, 9). ``vector @ _CROSS`` is the cross-product matrix of the vector, by rows.
_CROSS = np.cross(np.eye(3)[:, np.newaxis], -np.eye(3)).reshape(3, 9)


def rotation_matrix(axis: ArrayLike, angle: float) -> FloatArray:
    """Matrix (3, 3) that rotates vectors by ``angle`` (rad) about the unit vector ``axis``."""
    return rotation_matrices(angle * np.asarray(axis, dtype=float))


def rotation_matrices(vectors: FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) of rotation vectors (..., 3), rad."""
    angle = np.linalg.norm(vectors, axis=-1)[..., np.newaxis, np.newaxis]
    cross = (vectors @ _CROSS).reshape(*vectors.shape, 3)
    # sin(a) / a and (1 - cos(a)) / a^2, also for an angle of zero.
    return np.asarray(
        np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * cross @ cross
    )


def rotation_vectors(matrices: FloatArray) -> FloatArray:
    """Rotation vectors (n, 3), rad, of matrices (n, 3, 3) that turn by less than half a turn."""
    vector, sine, angle = _axis_and_angle(matrices)
    ratio = np.divide(angle, sine, out=np.ones_like(angle), where=sine > 0.0)
    return vector * ratio[:, np.newaxis]


def rotation_vector_enu(C_nb: FloatArray, C_nb_reference: FloatArray) -> FloatArray:
    """Rotation vectors in ENU from a reference attitude to the given ones.

    The Up component is a heading without singularity: for rotations much smaller than 1 rad it changes as the
    yaw of any Euler sequence that is regular. ``C_nb`` (n, 3, 3): attitudes, less than half a turn away from
    the reference. ``C_nb_reference`` (3, 3): reference attitude. Result (n, 3): rotation vectors,
    rad.
    """
    # As one product: numpy multiplies a stack of small matrices slowly.
    return rotation_vectors((C_nb.reshape(-1, 3) @ C_nb_reference.T).reshape(C_nb.shape))


def angle_between(C_first: FloatArray, C_second: FloatArray) -> float:
    """Angle (rad, 0 to pi) of the rotation from one attitude (3, 3) to another."""
    return float(_axis_and_angle(C_first @ C_second.T)[2])


def euler_rpy321(C_nb: FloatArray) -> FloatArray:
    """Roll, pitch and yaw (..., 3), rad, of ``C_nb = Rz(yaw) Rx(pitch) Ry(roll)``.

    Roll and yaw are meaningless if body y is up or down (pitch of +-90 deg).
    """
    roll = np.arctan2(-C_nb[..., 2, 0], C_nb[..., 2, 2])
    pitch = np.arcsin(np.clip(C_nb[..., 2, 1], -1.0, 1.0))
    yaw = np.arctan2(-C_nb[..., 0, 1], C_nb[..., 1, 1])
    return np.stack([roll, pitch, yaw], axis=-1)


def _axis_and_angle(turn: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Axis times sine (..., 3), sine and angle (...) of rotation matrices (..., 3, 3)."""
    x, y, z = (0.5 * (turn[..., i, j] - turn[..., j, i]) for i, j in ((2, 1), (0, 2), (1, 0)))
    vector, sine = np.stack([x, y, z], axis=-1), np.sqrt(x**2 + y**2 + z**2)
    cosine = 0.5 * (turn[..., 0, 0] + turn[..., 1, 1] + turn[..., 2, 2] - 1.0)
    return vector, sine, np.arctan2(sine, cosine)
