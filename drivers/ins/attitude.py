"""Attitude of an INS from its Euler angles or quaternion.

``C_nb`` transforms body vectors to the navigation frame, East-North-Up (ENU). At zero angles body x
points right (East), y forward (North) and z up. In every sequence roll is about body y, pitch about
body x, and yaw about the vertical:

``rpy_321``
    ``C_nb = Rz(yaw) Rx(pitch) Ry(roll)``: the usual sequence of vehicles, singular at a pitch of
    +-90 deg, where y points up or down.
``pry_231``
    ``C_nb = Rz(yaw) Ry(roll) Rx(pitch)``: singular at a roll of +-90 deg, where x points up or down.

Yaw is positive about Up, from East towards North; a heading, clockwise from north, is its negative.
An INS with the frames North-East-Down and forward-right-down has the same roll, pitch and (negative)
heading in the sequence ``rpy_321``.

References
----------
Yu et al., "The Six-Position Calibration Technique of Gyro Bias for Rotational Inertial
Navigation System Based on Ring Laser Gyroscope", section 4.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from gyrobench.bench.foundations.arrays import FloatArray


class EulerSequence(StrEnum):
    """Order of the three rotations."""

    RPY_321 = "rpy_321"
    PRY_231 = "pry_231"


class QuaternionFrames(StrEnum):
    """Body and navigation frame of a quaternion."""

    #: Right-forward-up to East-North-Up.
    RFU_TO_ENU = "rfu_to_enu"
    #: Forward-right-down to North-East-Down.
    FRD_TO_NED = "frd_to_ned"


def attitude_matrices(
    sequence: EulerSequence, roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike
) -> FloatArray:
    """Compute the matrices ``C_nb``, shape (n, 3, 3), of Euler angles in rad, shape (n,)."""
    angles = (np.asarray(angle, np.float64) for angle in (roll, pitch, yaw))
    with np.errstate(invalid="ignore"):  # the sine of an infinite angle is NaN
        (cr, sr), (cp, sp), (cy, sy) = ((np.cos(angle), np.sin(angle)) for angle in angles)
    zero = np.zeros_like(cr)
    tilt_columns = (
        ((cr, zero, sr), (sp * sr, cp, -sp * cr), (-cp * sr, sp, cp * cr))
        if sequence is EulerSequence.RPY_321
        else ((cr, sr * sp, sr * cp), (zero, cp, -sp), (-sr, cr * sp, cr * cp))
    )
    matrices = np.empty((*cr.shape, 3, 3))
    for column, (x, y, z) in enumerate(zip(*tilt_columns, strict=True)):
        matrices[..., 0, column] = cy * x - sy * y
        matrices[..., 1, column] = sy * x + cy * y
        matrices[..., 2, column] = z
    return matrices


def quaternion_matrices(
    frames: QuaternionFrames, w: ArrayLike, x: ArrayLike, y: ArrayLike, z: ArrayLike
) -> FloatArray:
    """Compute the matrices ``C_nb``, shape (n, 3, 3), of quaternions with components of shape (n,).

    Quaternions are normalised; those of length zero, which some INS send before alignment, give NaN.
    """
    scalar_last = np.stack(np.broadcast_arrays(x, y, z, w), axis=-1).astype(np.float64)
    if frames is QuaternionFrames.FRD_TO_NED:
        # Both frames change by the same half turn about the bisector of their first two axes.
        scalar_last = scalar_last[..., [1, 0, 2, 3]] * np.array([1.0, 1.0, -1.0, 1.0])
    length = np.linalg.norm(scalar_last, axis=-1, keepdims=True)
    unit = scalar_last / np.where(np.isfinite(length) & (length > 0.0), length, np.nan)
    vector, scalar = unit[..., :3], unit[..., 3, np.newaxis, np.newaxis]
    cross = -np.cross(vector[..., np.newaxis, :], np.eye(3))
    outer = vector[..., :, np.newaxis] * vector[..., np.newaxis, :]
    return np.asarray(2.0 * (outer + scalar * cross) + (2.0 * scalar**2 - 1.0) * np.eye(3))
