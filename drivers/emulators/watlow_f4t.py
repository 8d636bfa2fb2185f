"""Emulator of a Watlow F4T chamber controller at its SCPI interface.

Source: the command list of the F4T's SCPI interface in a chamber maker's manual. One control loop,
eight outputs. A profile can only be started at the panel, has one step, and can be stopped.

Assumptions where the public sources are silent: settings are read by their command with a question mark;
a profile's state reads ``RUNNING`` or ``IDLE``; a request that can't be executed is ignored without an
answer; set points outside the range of the chamber can't be executed; the error of the loop ends with its
condition.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial

from gyrobench.drivers.emulators.dialect import ChamberEmulation, OnEvent, TextInstrument, decimal
from gyrobench.drivers.emulators.watlow_loop import MAX_RAMP, OUTPUTS, RampAction, WatlowLoop
from gyrobench.drivers.emulators.world.thermal import ChamberAir

_REQUEST = re.compile(r":?([A-Z0-9*:]+)(\?| +(\S+))?")
_LOOP = "SOURCE:CLOOP1:"
_PROGRAM = "PROGRAM:SELECTED:STATE"
_ACTIONS = {
    "OFF": RampAction.OFF,
    "STARTUP": RampAction.AT_START,
    "SETPOINT": RampAction.AT_EVERY_CHANGE,
    "BOTH": RampAction.AT_EVERY_CHANGE,
}
_DEFAULT_RAMP = 1.0


class WatlowF4TEmulator(TextInstrument):
    """A Watlow F4T that controls the air of an emulated chamber on loop 1.

    Output 1 switches the control of the air.
    """

    def __init__(
        self, air: ChamberAir, on_event: OnEvent | None = None, *, decimals: int = 4, latency_s: float = 0.02
    ) -> None:
        super().__init__(latency_s)
        self.air = air
        self._loop = WatlowLoop(air, on_event, _DEFAULT_RAMP)
        self._decimals = decimals
        self._action = "OFF"
        self._error = False
        self._commands: dict[str, Callable[[str], None]] = {
            _LOOP + "SPOINT": self._set_set_point,
            _LOOP + "RACTION": self._set_action,
            _LOOP + "RSCALE": self._set_scale,
            _LOOP + "RRATE": self._set_rate,
            "UNIT:TEMPERATURE": self._set_unit,
            _PROGRAM: self._set_program,
        }
        self._queries: dict[str, Callable[[], str]] = {
            "*IDN": lambda: "WATLOW ELECTRIC MANUFACTURING COMPANY,F4T,00000,gyrobench emulator",
            _LOOP + "PVALUE": lambda: self._format_temperature(self.air.read_c),
            _LOOP + "SPOINT": lambda: self._format_temperature(self._loop.set_point_c),
            _LOOP + "ERROR": lambda: "ERROR" if self._error else "NONE",
            _LOOP + "RACTION": lambda: self._action,
            _LOOP + "RSCALE": lambda: "HOURS" if self._loop.per_hour else "MINUTES",
            _LOOP + "RRATE": lambda: self._format_number(self._loop.ramp_rate),
            "UNIT:TEMPERATURE": lambda: "F" if self._loop.is_fahrenheit else "C",
            _PROGRAM: lambda: "RUNNING" if self._loop.in_profile else "IDLE",
        }
        for number in OUTPUTS:
            self._commands[f"OUTPUT{number}:STATE"] = partial(self._set_output, number)
            self._queries[f"OUTPUT{number}:STATE"] = partial(self._output, number)

    def power_off(self, now_s: float) -> None:  # noqa: ARG002
        """Lose power: every output drops."""
        self._discard_input()
        self._loop.switch_all_off()

    def power_on(self, now_s: float) -> None:
        """Restart with the settings as they were and the outputs off."""

    def break_sensor(self, error: int) -> None:  # noqa: ARG002 - it reports one kind only
        """Make the input fail: the loop stops and reports an error."""
        self._error = self.air.faults.blind = True

    def repair_sensor(self) -> None:
        """Repair the input; the loop continues."""
        self._error = self.air.faults.blind = False

    def start_profile(self, to_c: float) -> None:
        """Start a profile at the panel."""
        self._loop.start_profile(to_c)

    def use_fahrenheit(self, fahrenheit: bool) -> None:
        """Change the unit at the panel."""
        self._set_unit("F" if fahrenheit else "C")

    def _reply(self, request: str) -> bytes:
        parts = _REQUEST.fullmatch(request.upper())
        if not parts or parts[2] is None:
            return b""
        if parts[2] == "?":
            query = self._queries.get(parts[1])
            return query().encode("ascii") + b"\n" if query else b""
        if command := self._commands.get(parts[1]):
            command(parts[3])
        return b""

    def _format_temperature(self, temperature_c: float) -> str:
        return self._format_number(self._loop.shown(temperature_c))

    def _format_number(self, value: float) -> str:
        return f"{value:.{self._decimals}f}"

    def _set_set_point(self, text: str) -> None:
        value = decimal(text)
        limits = self.air.parameters
        if value is not None and limits.low_c <= self._loop.celsius(value) <= limits.high_c:
            self._loop.set_set_point(self._loop.celsius(value))

    def _set_action(self, text: str) -> None:
        if text in _ACTIONS:
            self._action = text
            self._loop.set_ramp(action=_ACTIONS[text])

    def _set_scale(self, text: str) -> None:
        if text in ("MINUTES", "HOURS"):
            self._loop.set_ramp(per_hour=text == "HOURS")

    def _set_rate(self, text: str) -> None:
        value = decimal(text)
        if value is not None and 0.0 < value <= MAX_RAMP:
            self._loop.set_ramp(rate=value)

    def _set_unit(self, text: str) -> None:
        if text in ("C", "F"):
            self._loop.is_fahrenheit = text == "F"

    def _set_program(self, text: str) -> None:
        if text == "STOP":
            self._loop.end_profile()

    def _output(self, number: int) -> str:
        return "ON" if self._loop.outputs[number] else "OFF"

    def _set_output(self, number: int, text: str) -> None:
        if text in ("ON", "OFF"):
            self._loop.switch(number, text == "ON")


DIALECT = ChamberEmulation(WatlowF4TEmulator)
