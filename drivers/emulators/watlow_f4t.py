"""Emulator of a Watlow F4T chamber controller at its SCPI interface.

Source: the command list of the F4T's SCPI interface in a chamber maker's manual. One control loop,
eight outputs, no profiles.

Assumptions where the public sources are silent: that settings are asked for by their command with a
question mark; that what can't be done is passed over without a word; that set points outside the range
of the chamber can't be done; that the error of the loop goes with its cause.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial

from gyrobench.drivers.emulators.dialect import ChamberEmulation, OnEvent
from gyrobench.drivers.emulators.text_requests import TextRequests, decimal
from gyrobench.drivers.emulators.world.chamber_air import ChamberAir

#: The output that switches the chamber's machinery.
CHAMBER_OUTPUT = 1
_OUTPUTS = 8
_REQUEST = re.compile(r":?([A-Z0-9*:]+)(\?| +(\S+))?")
_LOOP = "SOURCE:CLOOP1:"
_ACTIONS = ("OFF", "STARTUP", "SETPOINT", "BOTH")
_SCALES = {"MINUTES": 1.0, "HOURS": 60.0}
_DEFAULT_RAMP, _FASTEST_RAMP = 1.0, 999.0


class WatlowF4TEmulator:
    """A Watlow F4T that controls the air of an emulated chamber on loop 1.

    Parameters
    ----------
    air : ChamberAir
        The air; output 1 switches its control.
    on_event : callable, optional
        Called with number and state of each output that changes.
    decimals : int
        Decimals of the numbers that are read.
    latency_s : float
        Time that the controller takes to answer.
    """

    def __init__(
        self,
        air: ChamberAir,
        on_event: OnEvent | None = None,
        *,
        decimals: int = 4,
        latency_s: float = 0.02,
    ) -> None:
        self.air = air
        self.latency_s = latency_s
        self._on_event = on_event
        self._decimals = decimals
        self._outputs = dict.fromkeys(range(1, _OUTPUTS + 1), False)
        self._outputs[CHAMBER_OUTPUT] = air.running
        self._action = "OFF"
        self._scale = "MINUTES"
        self._rate = _DEFAULT_RAMP
        self._fahrenheit = False
        self._error = False
        self._requests = TextRequests()
        self._commands: dict[str, Callable[[str], None]] = {
            _LOOP + "SPOINT": self._set_set_point,
            _LOOP + "RACTION": self._set_action,
            _LOOP + "RSCALE": self._set_scale,
            _LOOP + "RRATE": self._set_rate,
            "UNIT:TEMPERATURE": self._set_unit,
        }
        self._queries: dict[str, Callable[[], str]] = {
            "*IDN": lambda: "WATLOW ELECTRIC MANUFACTURING COMPANY,F4T,00000,gyrobench emulator",
            _LOOP + "PVALUE": lambda: self._shown(self.air.air_c),
            _LOOP + "SPOINT": lambda: self._shown(self.air.set_point_c),
            _LOOP + "ERROR": lambda: "ERROR" if self._error else "NONE",
            _LOOP + "RACTION": lambda: self._action,
            _LOOP + "RSCALE": lambda: self._scale,
            _LOOP + "RRATE": lambda: self._number(self._rate),
            "UNIT:TEMPERATURE": lambda: "F" if self._fahrenheit else "C",
        }
        for number in self._outputs:
            self._commands[f"OUTPUT{number}:STATE"] = partial(self._set_output, number)
            self._queries[f"OUTPUT{number}:STATE"] = partial(self._output, number)

    def feed(self, data: bytes, now_s: float) -> bytes:  # noqa: ARG002 - the air is at the present already
        """Take bytes; return the answers to the queries that they complete."""
        return b"".join(self._reply(request) for request in self._requests.take(data))

    def power_off(self, now_s: float) -> None:  # noqa: ARG002
        """Lose power: every output drops."""
        self._requests.forget()
        for number in self._outputs:
            self._switch(number, False)

    def power_on(self, now_s: float) -> None:
        """Come back with the settings as they were and the outputs off."""

    def break_sensor(self, error: int) -> None:  # noqa: ARG002 - it tells one kind only
        """Let the input fail: the loop stops and reports an error."""
        self._error = self.air.faults.blind = True

    def mend_sensor(self) -> None:
        """Let the input be well again, and the loop go on."""
        self._error = self.air.faults.blind = False

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

    def _shown(self, temperature_c: float) -> str:
        return self._number(temperature_c * 1.8 + 32.0 if self._fahrenheit else temperature_c)

    def _number(self, value: float) -> str:
        return f"{value:.{self._decimals}f}"

    def _set_set_point(self, text: str) -> None:
        value = decimal(text)
        if value is None:
            return
        value_c = (value - 32.0) / 1.8 if self._fahrenheit else value
        if self.air.parameters.low_c <= value_c <= self.air.parameters.high_c:
            self.air.set_point_c = value_c
            if self._action == "STARTUP" and self.air.running:
                self.air.ramp_rate_c_per_min = None

    def _set_action(self, text: str) -> None:
        if text in _ACTIONS:
            self._action = text
            self._apply_ramp()

    def _set_scale(self, text: str) -> None:
        if text in _SCALES:
            self._scale = text
            self._apply_ramp()

    def _set_rate(self, text: str) -> None:
        value = decimal(text)
        if value is not None and 0.0 < value <= _FASTEST_RAMP:
            self._rate = value
            self._apply_ramp()

    def _set_unit(self, text: str) -> None:
        if text in ("C", "F"):
            self._fahrenheit = text == "F"

    def _output(self, number: int) -> str:
        return "ON" if self._outputs[number] else "OFF"

    def _set_output(self, number: int, text: str) -> None:
        if text in ("ON", "OFF"):
            self._switch(number, text == "ON")

    def _switch(self, number: int, on: bool) -> None:
        if on == self._outputs[number]:
            return
        self._outputs[number] = on
        if number == CHAMBER_OUTPUT:
            self.air.running = on
            if on and self._action == "STARTUP":
                self.air.ramp_rate_c_per_min = self._ramp_c_per_min
        if self._on_event:
            self._on_event(number, on)

    @property
    def _ramp_c_per_min(self) -> float:
        return self._rate / _SCALES[self._scale] / (1.8 if self._fahrenheit else 1.0)

    def _apply_ramp(self) -> None:
        every_change = self._action in ("SETPOINT", "BOTH")
        self.air.ramp_rate_c_per_min = self._ramp_c_per_min if every_change else None


DIALECT = ChamberEmulation(WatlowF4TEmulator)
