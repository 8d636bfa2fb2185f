"""Undeclared effects on the gyro biases: what the bench's declared bias model knows nothing of."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.emulators.world.document import AttitudeThermalEffect
from drivers.emulators.world.sensor_errors import DPH
from drivers.emulators.world.thermal import ThermalNetwork

Array = NDArray[np.float64]


def undeclared_bias(effects: list[AttitudeThermalEffect], thermal: ThermalNetwork) -> Array:
    """Sum of all effects on the gyro biases, rad/s, shape (3,)."""
    total = np.zeros(3)
    for effect in effects:
        below = (effect.onset_c - thermal.optics_c) / effect.onset_width_c
        onset = np.logaddexp(0.0, below) * effect.onset_width_c / effect.onset_c
        total += np.array(effect.sensitivity_dph_per_w) * DPH * thermal.convected_w * onset
    return total
