"""In which of the six positions a window was measured, and what the Earth turns there."""

from __future__ import annotations

import math

import numpy as np

from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, FloatArray
from gyrobench.bench.navigation.earth import earth_rate_enu
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.sensor_log.document import EarthRate


def nearest_position(force: FloatArray) -> tuple[str, float]:
    """Position whose vertical is nearest to a specific force.

    Parameters
    ----------
    force : ndarray, shape (3,)
        Specific force at rest, body axes, any unit: it points up.

    Returns
    -------
    str, float
        Name of the position, and the angle between the force and its vertical, deg.
    """
    size = float(np.linalg.norm(force))
    if not size > 0.0:
        return "z_up", math.nan
    cosines = {
        name: position.up_sign * float(force[position.up_axis]) / size for name, position in POSITIONS.items()
    }
    name = max(cosines, key=cosines.__getitem__)
    return name, math.degrees(math.acos(min(1.0, cosines[name])))


def earth_rate_dph(position: str, rule: EarthRate) -> FloatArray:
    """Earth rate that the gyros sense, deg/h, body axes, shape (3,).

    Without an azimuth only the vertical axis has a value; the others are 0.
    """
    attitude = POSITIONS[position]
    rate = earth_rate_enu(math.radians(rule.latitude_deg)) * RADPS_TO_DPH
    if rule.azimuth_deg is None:
        rate = rate * [0.0, 0.0, 1.0]
    return np.asarray(attitude.C_nb(math.radians(rule.azimuth_deg or 0.0)).T @ rate)
