"""Attitude of an INS from its Euler angles or quaternion.

``C_nb`` turns vectors of the body into the navigation frame, East-North-Up (ENU). At zero angles
body x points right (East), y forward (North) and z up. In every sequence roll is an angle about
body y, pitch one about body x, and yaw one about the vertical:

``rpy_321``
    ``C_nb = Rz(yaw) Rx(pitch) Ry(roll)``: the usual sequence of vehicles. Singular where the
    pitch is +-90 deg, that is where y points up or down.
``pry_231``
    ``C_nb = Rz(yaw) Ry(roll) Rx(pitch)``: regular there; singular where the roll is +-90 deg,
    that is where x points up or down.

Yaw here is positive about Up, from East towards North. A heading, clockwise from north, is its
negative. An INS whose frames are North-East-Down and forward-right-down has the same roll, pitch
and (negative) heading in the sequence ``rpy_321``.

References
----------
Yu et al., "The Six-Position Calibration Technique of Gyro Bias for Rotational Inertial
Navigation System Based on Ring Laser Gyroscope", section 4.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from gyrobench.bench.foundations.arrays import FloatArray


class EulerSequence(StrEnum):
    """Order of the three rotations."""

    RPY_321 = "rpy_321"
    PRY_231 = "pry_231"


class QuaternionFrames(StrEnum):
    """Frames between which a quaternion leads, from body to navigation."""

    #: Right-forward-up to East-North-Up.
    RFU_TO_ENU = "rfu_to_enu"
    #: Forward-right-down to North-East-Down.
    FRD_TO_NED = "frd_to_ned"


def attitude_matrices(
    sequence: EulerSequence, roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike
) -> FloatArray:
    """Matrices ``C_nb``, shape (n, 3, 3), of Euler angles in rad, shape (n,)."""
    about_x, about_y = _turned("x", pitch), _turned("y", roll)
    tilted = about_x @ about_y if sequence is EulerSequence.RPY_321 else about_y @ about_x
    return np.asarray(_turned("z", yaw) @ tilted)


def quaternion_matrices(
    frames: QuaternionFrames, w: ArrayLike, x: ArrayLike, y: ArrayLike, z: ArrayLike
) -> FloatArray:
    """Matrices ``C_nb``, shape (n, 3, 3), of quaternions that need not be of length one.

    The all-zero quaternion, which some INS send before alignment, gives NaN.
    """
    scalar_last = np.stack(np.broadcast_arrays(x, y, z, w), axis=-1).astype(np.float64)
    if frames is QuaternionFrames.FRD_TO_NED:
        # Both frames change by the same half turn, about the bisector of their first two axes.
        scalar_last = scalar_last[..., [1, 0, 2, 3]] * np.array([1.0, 1.0, -1.0, 1.0])
    length = np.linalg.norm(scalar_last, axis=-1)
    usable = np.isfinite(length) & (length > 0.0)
    matrices = np.full((*usable.shape, 3, 3), np.nan)
    matrices[usable] = Rotation.from_quat(scalar_last[usable]).as_matrix()
    return matrices


def euler_angles(sequence: EulerSequence, C_nb: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Roll, pitch and yaw, each of shape (n,), rad, of matrices (n, 3, 3).

    At the singularity of the sequence yaw and the angle about the vertical axis mean nothing.
    """
    if sequence is EulerSequence.RPY_321:
        roll = np.arctan2(-C_nb[..., 2, 0], C_nb[..., 2, 2])
        pitch = np.arctan2(C_nb[..., 2, 1], np.hypot(C_nb[..., 2, 0], C_nb[..., 2, 2]))
        yaw = np.arctan2(-C_nb[..., 0, 1], C_nb[..., 1, 1])
    else:
        roll = np.arctan2(-C_nb[..., 2, 0], np.hypot(C_nb[..., 2, 1], C_nb[..., 2, 2]))
        pitch = np.arctan2(C_nb[..., 2, 1], C_nb[..., 2, 2])
        yaw = np.arctan2(C_nb[..., 1, 0], C_nb[..., 0, 0])
    return roll, pitch, yaw


def _turned(axis: Literal["x", "y", "z"], angle: ArrayLike) -> FloatArray:
    """Matrices (n, 3, 3) that turn vectors about an axis."""
    angle = np.asarray(angle, np.float64)
    with np.errstate(invalid="ignore"):  # an infinite angle has no sine; NaN is right
        cosine, sine = np.cos(angle), np.sin(angle)
    along = "xyz".index(axis)
    first, second = (along + 1) % 3, (along + 2) % 3
    matrices = np.zeros((*angle.shape, 3, 3))
    matrices[..., along, along] = 1.0
    matrices[..., first, first] = matrices[..., second, second] = cosine
    matrices[..., first, second] = -sine
    matrices[..., second, first] = sine
    return matrices
