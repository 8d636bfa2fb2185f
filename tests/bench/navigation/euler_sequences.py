"""The sequence of Euler angles that an INS may send beside the one that the bench uses."""

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray


def euler_pry231(C_nb: FloatArray) -> FloatArray:
    """Roll, pitch and yaw (..., 3), rad, of ``C_nb = Rz(yaw) Ry(roll) Rx(pitch)``.

    Pitch and yaw are meaningless where body x is up or down (roll of +-90 deg).
    """
    roll = np.arcsin(np.clip(-C_nb[..., 2, 0], -1.0, 1.0))
    pitch = np.arctan2(C_nb[..., 2, 1], C_nb[..., 2, 2])
    yaw = np.arctan2(C_nb[..., 1, 0], C_nb[..., 0, 0])
    return np.stack([roll, pitch, yaw], axis=-1)
