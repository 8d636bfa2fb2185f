"""The air of the thermal chamber, its control loop, heater and compressor."""

from __future__ import annotations

import math
from dataclasses import dataclass

#: Share of full cooling power above which the compressor runs continuously.
_MIN_STEADY_COOLING = 0.3
#: Time constant of the air while the door is open.
_DOOR_TIME_CONSTANT_S = 300.0


@dataclass(frozen=True)
class ChamberParameters:
    """Limits of the chamber, and the room around it."""

    #: heating_limit_c_per_min, cooling_limit_c_per_min: Rate of change of the air at full power, above zero.
    heating_limit_c_per_min: float = 5.0
    cooling_limit_c_per_min: float = 3.0
    control_time_constant_s: float = 90.0  #: Lag of the air behind the working set point.
    #: ambient_c, ambient_time_constant_s: Room temperature, and time constant of the uncontrolled air's drift
    #: to it.
    ambient_c: float = 23.0
    ambient_time_constant_s: float = 5400.0
    #: low_c, high_c: Temperatures that the chamber can reach.
    low_c: float = -60.0
    high_c: float = 100.0


@dataclass
class AirFaults:
    """Active faults of the chamber."""

    #: stopped, blind: Heater and compressor are off although the controller runs; it has no temperature
    #: reading.
    stopped: bool = False
    blind: bool = False
    error_c: float = 0.0  #: Offset of the controlled air from its set point.
    door_open: bool = False  #: The room's air comes in.


class ChamberAir:
    """Air temperature of a chamber, controlled or drifting."""

    def __init__(self, parameters: ChamberParameters | None = None) -> None:
        self.parameters = parameters or ChamberParameters()
        #: air_c, set_point_c, working_set_point_c: Temperature of the air, final set point, ramped set point.
        self.air_c = self.parameters.ambient_c
        self.set_point_c = self.air_c
        self.ramp_rate_c_per_min: float | None = None  #: Rate of the ramped set point; None for a step.
        #: Whether the air is controlled; otherwise it drifts to the room's temperature.
        self.running = False
        self.working_set_point_c = self.air_c
        self.power = 0.0  #: Share of full power: 1 heats, -1 cools.
        self.faults = AirFaults()  #: Active faults.

    @property
    def compressor_duty(self) -> float:
        """Share of the time that the compressor runs: it cycles where little cooling is needed."""
        return _within(-self.power / _MIN_STEADY_COOLING, 0.0, 1.0)

    def step(self, dt_s: float) -> None:
        """Advance by ``dt_s``."""
        if self.faults.door_open:
            self._drift(dt_s, _DOOR_TIME_CONSTANT_S)
        elif self.running and not (self.faults.stopped or self.faults.blind):
            self._control(dt_s)
        else:
            self._drift(dt_s, self.parameters.ambient_time_constant_s)

    def disturb(self, delta_c: float) -> None:
        """Step the air's temperature, as an opened door does."""
        self.air_c += delta_c

    def _control(self, dt_s: float) -> None:
        limits = self.parameters
        target_c = self.set_point_c
        if self.ramp_rate_c_per_min is not None:
            span_c = self.ramp_rate_c_per_min * dt_s / 60.0
            target_c = _within(target_c, self.working_set_point_c - span_c, self.working_set_point_c + span_c)
        self.working_set_point_c = target_c
        gap_c = _within(target_c + self.faults.error_c, limits.low_c, limits.high_c) - self.air_c
        approach_c_per_min = -gap_c * math.expm1(-dt_s / limits.control_time_constant_s) * 60.0 / dt_s
        rate_c_per_min = _within(
            approach_c_per_min, -limits.cooling_limit_c_per_min, limits.heating_limit_c_per_min
        )
        self.air_c += rate_c_per_min * dt_s / 60.0
        lost_c_per_min = (self.air_c - limits.ambient_c) * 60.0 / limits.ambient_time_constant_s
        demand_c_per_min = rate_c_per_min + lost_c_per_min
        full_c_per_min = (
            limits.heating_limit_c_per_min if demand_c_per_min > 0.0 else limits.cooling_limit_c_per_min
        )
        self.power = _within(demand_c_per_min / full_c_per_min, -1.0, 1.0)

    def _drift(self, dt_s: float, time_constant_s: float) -> None:
        share = -math.expm1(-dt_s / time_constant_s)
        self.air_c += (self.parameters.ambient_c - self.air_c) * share
        # A ramp that starts later starts from the air's temperature then.
        self.working_set_point_c = self.air_c
        self.power = 0.0


def _within(value: float, low: float, high: float) -> float:
    return low if value < low else high if value > high else value
