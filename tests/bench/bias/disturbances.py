"""What may happen to the gyros in a dwell besides a constant bias, as a change of the bias over time.

Each function gives a ``gyro_bias_change`` of :class:`tests.bench.bias.simulated_dwell.Sensors`: time
since the end of the alignment (n,) to rad/s in body axes (n, 3).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.drivers.emulators.world.strapdown import EARTH_RATE
from tests.bench.bias.emulated_dwells import DPH, LATITUDE_DEG

Change = Callable[[FloatArray], FloatArray]


def heading_error(position: str, heading_deg: float, latitude_deg: float = LATITUDE_DEG) -> Change:
    """The INS gyrocompasses with an East gyro that reads wrong until the alignment ends."""
    east = -np.radians(heading_deg) * EARTH_RATE * np.cos(np.radians(latitude_deg))
    rate = POSITIONS[position].C_nb().T @ np.array([east, 0.0, 0.0])
    return lambda time_s: np.where(time_s[:, None] < 0.0, rate, 0.0)


def bias_step(axis: int, size_dph: float, at_s: float) -> Change:
    """The bias of one gyro jumps."""
    return lambda time_s: np.where(time_s[:, None] > at_s, size_dph * DPH * np.eye(3)[axis], 0.0)


def tilt_step(position: str, axis_enu: int, size_rad: float, at_s: float, azimuth_rad: float = 0.0) -> Change:
    """The computed attitude jumps about East, North or Up within a sample; at an azimuth in a turn."""
    in_turn = azimuth_rad != 0.0
    sample_s = 0.01 if in_turn else 0.1
    rate = POSITIONS[position].C_nb(azimuth_rad).T @ np.eye(3)[axis_enu] * size_rad / sample_s
    return lambda time_s: np.where(np.abs(time_s[:, None] - at_s) < 0.5 * sample_s, rate, 0.0)


def navigation_rate(position: str, rate_enu_dph: Any, turn_middle_s: float = 612.5) -> Change:
    """A rate that is fixed in the navigation frame, in a dwell with a turn by 180 deg."""
    before, after = (POSITIONS[position].C_nb(azimuth).T for azimuth in (0.0, np.pi))
    rate = np.asarray(rate_enu_dph) * DPH
    return lambda time_s: np.where(time_s[:, None] < turn_middle_s, before @ rate, after @ rate)


def warming(slope_dph_per_c: Any, warmth_c: Callable[[FloatArray], FloatArray]) -> Change:
    """The biases follow a temperature (n,) that is known for each time (n,)."""
    return lambda time_s: np.multiply.outer(warmth_c(time_s), np.asarray(slope_dph_per_c) * DPH)
