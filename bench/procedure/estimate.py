"""The expected state of the bench at each time of a plan."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class ThermalEstimate:
    """Model of the gyros behind the chamber: a first-order lag."""

    time_constant_s: float = 2400.0  #: Time in which the gyros cover 63 % of a temperature difference.
    self_heating_c: float = 15.0  #: Excess of their final temperature over the chamber with the INS on.
    air_lag_s: float = 120.0  #: Lag of the chamber's air behind its ramping set point.
    room_c: float = 23.0  #: Temperature of the bench before the chamber runs and after it is switched off.


@dataclass(frozen=True, slots=True)
class BenchEstimate:
    """The expected state of the bench at one time."""

    thermal: ThermalEstimate
    chamber_c: float  #: The ramped set point.
    gyro_c: float  #: Temperature of the gyros.
    #: powered, aligned: Whether the INS is on; whether it has aligned since it last moved other than by a
    #: turn.
    powered: bool = False
    aligned: bool = False
    #: position, azimuth_deg: Position and azimuth of the table; None before the first go_to.
    position: str | None = None
    azimuth_deg: float = 0.0
    #: set_point_c, ramp_c_per_s: Set point and ramp of the chamber; None while it is off.
    set_point_c: float | None = None
    ramp_c_per_s: float = 0.0

    @classmethod
    def at_rest(cls, thermal: ThermalEstimate | None = None) -> BenchEstimate:
        """State with everything off and at room temperature."""
        thermal = thermal or ThermalEstimate()
        return cls(thermal, chamber_c=thermal.room_c, gyro_c=thermal.room_c)

    def ramp_left_s(self) -> float:
        """Time until the chamber's ramp reaches its set point."""
        if self.set_point_c is None or self.ramp_c_per_s == 0.0:
            return 0.0
        return abs(self.set_point_c - self.chamber_c) / self.ramp_c_per_s

    def passed(self, duration_s: float) -> BenchEstimate:
        """Return the state of the bench ``duration_s`` later, without commands meanwhile."""
        tau_s, heating_c = self.thermal.time_constant_s, self._heating_c()
        ramp_s, slope_c_per_s = min(duration_s, self.ramp_left_s()), 0.0
        if self.set_point_c is not None:
            slope_c_per_s = math.copysign(self.ramp_c_per_s, self.set_point_c - self.chamber_c)
        chamber_c = self.chamber_c + slope_c_per_s * ramp_s
        ramped_c = lagged(self.gyro_c, self.chamber_c + heating_c, slope_c_per_s, tau_s, ramp_s)
        held_c = lagged(ramped_c, chamber_c + heating_c, 0.0, tau_s, duration_s - ramp_s)
        return replace(self, chamber_c=chamber_c, gyro_c=held_c)

    def time_until_gyro_rate_s(self, rate_c_per_h: float) -> float:
        """Time until the gyros change by less than ``rate_c_per_h`` if the chamber holds its temperature."""
        return self.thermal.time_constant_s * math.log(max(1.0, self.settling_c_per_h / rate_c_per_h))

    @property
    def settling_c_per_h(self) -> float:
        """Absolute rate of change of the gyros, degC/h, if the chamber holds its temperature."""
        gap_c = self.chamber_c + self._heating_c() - self.gyro_c
        return 3600.0 * abs(gap_c) / self.thermal.time_constant_s

    def _heating_c(self) -> float:
        return self.thermal.self_heating_c if self.powered else 0.0


def lagged(value: float, goal: float, slope_per_s: float, tau_s: float, duration_s: float) -> float:
    """Response of a first-order lag with time constant ``tau_s`` to a goal that moves at a constant slope."""
    lag = slope_per_s * tau_s
    steady = goal + slope_per_s * duration_s - lag
    return steady + (value - goal + lag) * math.exp(-duration_s / tau_s)
