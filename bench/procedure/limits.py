"""What a station can do: the limits that a plan must keep."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class StationLimits:
    """Limits of one station's chamber and table.

    Attributes
    ----------
    chamber_low_c, chamber_high_c : float
        Range of the chamber's set point.
    ramp_max_c_per_min : float
        Fastest ramp of the chamber, up or down.
    table_rate_max_dps : float
        Fastest turn of either axis of the table.
    reachable : callable
        ``reachable(position, azimuth_deg, turns_deg)`` gives the reason why the table can't stand
        there and then do these turns, None where it can.
    gyro_low_c, gyro_high_c : float
        Temperatures of the gyros at which an interlock trips.
    """

    chamber_low_c: float
    chamber_high_c: float
    ramp_max_c_per_min: float
    table_rate_max_dps: float
    reachable: Callable[[str, float, tuple[float, ...]], str | None]
    gyro_low_c: float = -math.inf
    gyro_high_c: float = math.inf
