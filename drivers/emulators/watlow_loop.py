"""Common part of the emulated Watlow F4 and F4T: eight outputs, the first for the chamber, and the ramp."""

from __future__ import annotations

from enum import IntEnum

from gyrobench.drivers.emulators.dialect import OnEvent
from gyrobench.drivers.emulators.world.thermal import ChamberAir

#: The output that switches the chamber.
_CHAMBER_OUTPUT = 1
OUTPUTS = range(1, 9)
MAX_RAMP = 999.0


class RampAction(IntEnum):
    """Events at which the working set point ramps."""

    OFF = 0
    AT_START = 1
    AT_EVERY_CHANGE = 2


class WatlowLoop:
    """Control loop 1 over the air of an emulated chamber."""

    def __init__(self, air: ChamberAir, on_event: OnEvent | None, ramp_rate: float) -> None:
        self.air = air
        #: State of each output.
        self.outputs = {number: air.running and number == _CHAMBER_OUTPUT for number in OUTPUTS}
        self.action = RampAction.OFF  #: Event at which the set point ramps.
        self.ramp_rate = ramp_rate  #: Ramp rate in degrees per minute, or per hour with ``per_hour``.
        self.per_hour = False
        self.is_fahrenheit = False  #: Whether the controller's temperatures are in degF.
        self.is_held = False  #: Whether the profile is held.
        self._static_c: float | None = None  # set point that has no effect while a profile runs
        self._on_event = on_event

    @property
    def set_point_c(self) -> float:
        """Set point as the controller reports it, also while a profile overrides it."""
        return self.air.set_point_c if self._static_c is None else self._static_c

    @property
    def in_profile(self) -> bool:
        """Whether a profile controls the air."""
        return self._static_c is not None

    def shown(self, temperature_c: float) -> float:
        """Convert a temperature to the controller's unit."""
        return temperature_c * 1.8 + 32.0 if self.is_fahrenheit else temperature_c

    def celsius(self, value: float) -> float:
        """Convert a temperature from the controller's unit."""
        return (value - 32.0) / 1.8 if self.is_fahrenheit else value

    def start_profile(self, to_c: float) -> None:
        """Start a profile with one step, which switches the chamber on."""
        self._static_c, self.is_held = self.set_point_c, False
        self.air.set_point_c = to_c
        self.switch(_CHAMBER_OUTPUT, True)

    def end_profile(self) -> None:
        """End the profile; the set point has effect again."""
        if self._static_c is not None:
            self.air.set_point_c, self._static_c = self._static_c, None

    def switch(self, number: int, on: bool) -> None:
        """Switch an output."""
        on = bool(on)
        if on == self.outputs[number]:
            return
        self.outputs[number] = on
        if number == _CHAMBER_OUTPUT:
            self.air.running = on
            if on and self.action is RampAction.AT_START:
                self.air.ramp_rate_c_per_min = self._ramp_c_per_min
        if self._on_event:
            self._on_event(number, on)

    def switch_all_off(self) -> None:
        """Switch all outputs off, as on loss of power."""
        for number in OUTPUTS:
            self.switch(number, False)

    def set_set_point(self, set_point_c: float) -> None:
        """Change the set point."""
        if self._static_c is not None:
            self._static_c = set_point_c
            return
        self.air.set_point_c = set_point_c
        if self.action is RampAction.AT_START and self.air.running:
            self.air.ramp_rate_c_per_min = None

    def set_ramp(
        self, action: RampAction | None = None, rate: float | None = None, per_hour: bool | None = None
    ) -> None:
        """Change the ramp settings that are not None; they apply to later set points."""
        self.action = self.action if action is None else action
        self.ramp_rate = self.ramp_rate if rate is None else rate
        self.per_hour = self.per_hour if per_hour is None else per_hour
        every_change = self.action is RampAction.AT_EVERY_CHANGE
        self.air.ramp_rate_c_per_min = self._ramp_c_per_min if every_change else None

    @property
    def _ramp_c_per_min(self) -> float:
        return self.ramp_rate / (60.0 if self.per_hour else 1.0) / (1.8 if self.is_fahrenheit else 1.0)
