"""The expected state of the bench at each time of a plan."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.navigation.table_axes import Angles, TurnOrMove, TwoAxisTable


@dataclass(frozen=True)
class ThermalEstimate:
    """Model of the gyros behind the chamber: a first-order lag."""

    time_constant_s: float = 2400.0  #: Time in which the gyros cover 63 % of a temperature difference.
    self_heating_c: float = 15.0  #: Excess of their final temperature over the chamber with the INS on.
    air_lag_s: float = 120.0  #: Lag of the chamber's air behind its ramping set point.
    room_c: float = 23.0  #: Temperature of the bench before the chamber runs and after it is switched off.


#: Time in which the servo of an axis settles after a motion.
SETTLING_S = 1.0


@dataclass(frozen=True, eq=False)
class TableEstimate:
    """Motions of the rate table, from rest until it has settled, within its acceleration and jerk."""

    axes: TwoAxisTable
    acceleration_dps2: float
    jerk_dps3: float
    tick_s: float  #: The engine notices the end of a motion or a wait at its next tick.

    def motion_s(self, move_deg: Angles, rate_dps: float) -> float:
        """Duration of a move of both axes at once, until the engine notices its end."""
        distance_deg = max(map(abs, move_deg))
        acceleration, jerk = self.acceleration_dps2, self.jerk_dps3
        # Peak rate of a move too short for the rate: first where the acceleration reaches its limit.
        lag_s = acceleration / jerk
        peak_dps = acceleration / 2.0 * (math.sqrt(lag_s**2 + 4.0 * distance_deg / acceleration) - lag_s)
        if peak_dps < acceleration * lag_s:
            peak_dps = (distance_deg**2 * jerk / 4.0) ** (1.0 / 3.0)
        peak_dps = min(peak_dps, rate_dps)
        is_limited = peak_dps > acceleration * lag_s
        ramp_s = peak_dps / acceleration + lag_s if is_limited else 2.0 * math.sqrt(peak_dps / jerk)
        moving_s = ramp_s + distance_deg / peak_dps + SETTLING_S if distance_deg else 0.0
        return self.tick_s * max(1, math.ceil(moving_s / self.tick_s))

    def wait_s(self, duration_s: float) -> float:
        """Duration of a wait after a motion or a reading, which end shortly after a tick."""
        return self.tick_s * (math.floor(duration_s / self.tick_s) + 1) if duration_s else 0.0


@lru_cache(maxsize=1024)
def _angles(axes: TwoAxisTable, position: str, azimuth_deg: float, turns: tuple[TurnOrMove, ...]) -> Angles:
    return axes.angles(POSITIONS[position].C_nb(np.deg2rad(azimuth_deg)), turns)


_turned_angles = lru_cache(maxsize=1024)(TwoAxisTable.turn)


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
    table: TableEstimate | None = None  #: None for a plan without a station.
    angles_deg: Angles | None = None  #: Outer and inner angle; None if not known.
    next_turns_deg: tuple[TurnOrMove, ...] = ()  #: Turns that follow the last go_to, until the next.

    @classmethod
    def at_rest(cls, thermal: ThermalEstimate | None = None) -> BenchEstimate:
        """State with everything off and at room temperature."""
        thermal = thermal or ThermalEstimate()
        return cls(thermal, chamber_c=thermal.room_c, gyro_c=thermal.room_c)

    def motion_s(self, to_deg: Angles | None, rate_dps: float, usual_travel_deg: float) -> float:
        """Duration of a motion of the table to these angles; ``usual_travel_deg``: if they are not known."""
        if self.table is None:
            return usual_travel_deg / rate_dps
        if self.angles_deg is None or to_deg is None:
            return self.table.motion_s((usual_travel_deg, 0.0), rate_dps)
        outer_deg, inner_deg = (to - now for to, now in zip(to_deg, self.angles_deg, strict=True))
        return self.table.motion_s((outer_deg, inner_deg), rate_dps)

    def wait_s(self, duration_s: float) -> float:
        """Duration of a wait after a motion."""
        return self.table.wait_s(duration_s) if self.table else duration_s

    def angles_at(self, position: str, azimuth_deg: float) -> Angles | None:
        """Angles of the table in a position; None if they are not known, or it can't be reached."""
        try:
            turns = self.next_turns_deg
            return _angles(self.table.axes, position, azimuth_deg, turns) if self.table else None
        except DocumentError:  # found by the checks of the plan
            return None

    def angles_turned(self, angle_deg: float) -> Angles | None:
        """Angles of the table after a turn about Up; None as for :meth:`angles_at`."""
        if self.table is None or self.angles_deg is None:
            return None
        try:
            return _turned_angles(self.table.axes, self.angles_deg, angle_deg)
        except DocumentError:
            return None

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
