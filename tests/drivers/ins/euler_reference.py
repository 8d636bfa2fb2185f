"""Euler angles of attitude matrices, the inverse of the driver's conversion."""

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.drivers.ins.attitude import EulerSequence


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
