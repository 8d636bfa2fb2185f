"""Faults of the thermal chamber."""

from __future__ import annotations

import math
from functools import partial
from typing import Annotated, Literal

from pydantic import Field

from gyrobench.drivers.emulators.dialect import (
    WithAlarms,
    WithDecimals,
    WithProfiles,
    WithRamp,
    WithTemperatureSensor,
    WithTemperatureUnit,
)
from gyrobench.drivers.emulators.faults.fault import BenchParts, End, Fault, Occurrence, Persistence
from gyrobench.drivers.emulators.world.thermal import ChamberAir
from gyrobench.drivers.emulators.world.undeclared_effects import Positive


class ControlFault(Fault):
    """The air is held off its set point."""

    by_c: Positive = Field(description="offset from the set point, K")

    def _direction(self, air: ChamberAir) -> float:
        """Sign of the error."""
        raise NotImplementedError

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        faults = bench.world.air.faults
        faults.error_c = math.copysign(self.by_c, self._direction(bench.world.air))
        return partial(setattr, faults, "error_c", 0.0)


class TemperatureNotReached(ControlFault):
    """The air stays ``by_c`` short of its set point, on the side of the room."""

    fault: Literal["temperature_not_reached"]

    def _direction(self, air: ChamberAir) -> float:
        return air.parameters.ambient_c - air.set_point_c


class TemperatureOvershoots(ControlFault):
    """The air goes ``by_c`` beyond its set point, in the direction of its approach."""

    fault: Literal["temperature_overshoots"]

    def _direction(self, air: ChamberAir) -> float:
        return air.set_point_c - air.air_c


class ChamberSensorError(Fault):
    """The controller's sensor fails for ``for_s`` and control stops; the error is latched until cleared."""

    requires = ("chamber", WithTemperatureSensor)
    fault: Literal["chamber_sensor_error"]
    error: Annotated[int, Field(ge=1, le=10)] = Field(1, description="number in register 101")

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        chamber = bench.require_capability("chamber", WithTemperatureSensor)
        chamber.break_sensor(self.error)
        return chamber.repair_sensor


class ChamberSensorStuck(Fault):
    """The controller's sensor keeps its last, plausible value: the chamber heats or cools at full power."""

    fault: Literal["chamber_sensor_stuck"]

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        air = bench.world.air
        air.faults.stuck_c = air.air_c
        return partial(setattr, air.faults, "stuck_c", None)


class ChamberAlarm(Fault):
    """An alarm of the controller; its condition lasts ``for_s``, the alarm until it is cleared after that."""

    requires = ("chamber", WithAlarms)
    fault: Literal["chamber_alarm"]
    alarm: Literal[1, 2] = Field(1, description="number of the alarm")
    state: Literal["high", "low"] = Field("high", description="the violated limit")

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        chamber = bench.require_capability("chamber", WithAlarms)
        chamber.raise_alarm(self.alarm, self.state == "high")
        return partial(chamber.end_alarm, self.alarm)


class DoorOpened(Fault):
    """The door is opened for ``for_s``: the air jumps towards the room's temperature and drifts to it."""

    fault: Literal["door_opened"]
    share: Annotated[float, Field(gt=0.0, le=1.0)] = Field(0.3, description="share of the jump at once")

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        air = bench.world.air
        air.air_c += self.share * (air.parameters.ambient_c - air.air_c)
        air.faults.door_open = True
        return partial(setattr, air.faults, "door_open", False)


class SwitchedOffAtPanel(Fault):
    """An operator switches heater and compressor off at the chamber; the controller keeps running."""

    fault: Literal["switched_off_at_panel"]

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        faults = bench.world.air.faults
        faults.stopped = True
        return partial(setattr, faults, "stopped", False)


class SetPointChangedAtPanel(Fault):
    """An operator enters another set point at the chamber's controller."""

    persistence = Persistence.MOMENTARY

    fault: Literal["set_point_changed_at_panel"]
    to_c: float = Field(ge=-60.0, le=100.0, description="the new set point, degC")

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        bench.world.air.set_point_c = self.to_c
        return None


class ProfileStartedAtPanel(Fault):
    """An operator starts a profile at the chamber's controller; its set point still reads as before."""

    persistence = Persistence.MOMENTARY

    requires = ("chamber", WithProfiles)
    fault: Literal["profile_started_at_panel"]
    to_c: float = Field(ge=-60.0, le=100.0, description="temperature of the profile, degC")

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        bench.require_capability("chamber", WithProfiles).start_profile(self.to_c)
        return None


class UnitChangedAtPanel(Fault):
    """An operator changes the controller's unit to °F, for ``for_s`` if given."""

    requires = ("chamber", WithTemperatureUnit)
    fault: Literal["unit_changed_at_panel"]

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        chamber = bench.require_capability("chamber", WithTemperatureUnit)
        chamber.use_fahrenheit(True)
        return partial(chamber.use_fahrenheit, False)


class DecimalsChangedAtPanel(Fault):
    """An operator changes the decimals of the controller's numbers, for ``for_s`` if given."""

    requires = ("chamber", WithDecimals)
    fault: Literal["decimals_changed_at_panel"]
    decimals: Annotated[int, Field(ge=0, le=3)] = Field(2, description="places after the decimal point")

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        chamber = bench.require_capability("chamber", WithDecimals)
        before, chamber.decimals = chamber.decimals, self.decimals
        return partial(setattr, chamber, "decimals", before)


class NoSetPointRamp(Fault):
    """The controller is a model that does not ramp its set point."""

    persistence = Persistence.MOMENTARY

    requires = ("chamber", WithRamp)
    fault: Literal["no_set_point_ramp"]

    def _begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        bench.require_capability("chamber", WithRamp).remove_ramp()
        return None
