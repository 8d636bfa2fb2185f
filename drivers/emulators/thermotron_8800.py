"""Emulator of a Thermotron 8800 chamber controller at its serial port or TCP socket.

Source: parts of Thermotron's published list of computer interface commands. The chamber is stopped, runs
in manual mode, or runs a program, which can only be started at the panel and has one interval.

Assumptions where the public sources are silent: the codes of refusals, which are also the reply to an invalid
query; ``STOP`` ends a program, and ``RUNM`` is refused while one runs; alarms end with their
condition; a process alarm and an open input stop the chamber; set points outside the range of the chamber
are refused.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from enum import IntEnum
from functools import partial
from typing import Literal

from gyrobench.drivers.emulators.dialect import ChamberEmulation, OnEvent, TextInstrument, decimal
from gyrobench.drivers.emulators.world.thermal import ChamberAir
from gyrobench.drivers.text_line import LINE_ENDINGS

_CHANNEL = "1"
_COMMAND = re.compile(r"([A-Z]{4})(\d*)(?:,([^,]*))?")
_QUERY = re.compile(r"([A-Z]{4})(\d*)\?")
_PROGRAM, _MANUAL = 1 << 0, 1 << 4
_MAX_RAMP = 999.0
_MAX_DEVIATION = 100.0
_AUXILIARIES_IN_GROUP = 8
_ALL_AUXILIARIES = (1 << _AUXILIARIES_IN_GROUP) - 1
#: Bits of ALRM by alarm (1 process, 2 deviation) and side.
_ALARM_BITS = {(1, False): 4, (1, True): 5, (2, False): 0, (2, True): 1}
_PROCESS_ALARM = 1
_PROCESS_ALARM_BITS = 1 << 4 | 1 << 5


class Code(IntEnum):
    """Reply codes of a command; all but the first are assumptions."""

    DONE = 0
    UNKNOWN_COMMAND = 1
    WRONG_PARAMETER = 2
    NOT_NOW = 3


class Stop(IntEnum):
    """Cause of the last stop."""

    COLD_BOOT = 0
    RUNNING = 1
    STOP_KEY = 2
    END_OF_TEST = 3
    EXTERNAL_INPUT = 4
    COMPUTER = 5
    OPEN_INPUT = 6
    PROCESS_ALARM = 7
    SYSTEM_MONITOR = 8
    POWER_FAIL = 9
    THERM_ALARM = 10


class Thermotron8800Emulator(TextInstrument):
    """A Thermotron 8800 that controls the air of an emulated chamber on channel 1.

    ``echo``: when the request is repeated: never, before each reply, or in bit of a command's code. With
    ``auxiliaries_need_run``, auxiliaries can be switched, and keep their state, only while the chamber runs.
    ``line_ending`` ends each reply: cr, crlf or lf.
    """

    def __init__(
        self,
        air: ChamberAir,
        on_event: OnEvent | None = None,
        *,
        echo: Literal["never", "before", "instead"] = "never",
        auxiliaries_need_run: bool = False,
        line_ending: Literal["cr", "crlf", "lf"] = "cr",
        latency_s: float = 0.05,
    ) -> None:
        super().__init__(latency_s)
        self.air = air
        self._end_of_reply = LINE_ENDINGS[line_ending]
        self._manual_c: float | None = None  # set point that has no effect while a program runs
        self.stop_code = Stop.RUNNING if air.running else Stop.COLD_BOOT  #: Answer to ``SCOD?``.
        self._on_event = on_event
        self._echo = echo
        self._auxiliaries_need_run = auxiliaries_need_run
        self._auxiliaries = {"1": 0, "2": 0}
        self._alarms = 0
        self._ramp_c_per_min = air.ramp_rate_c_per_min or 0.0
        self._deviation_c = 0.0
        self._open_input = False
        self.use_fahrenheit(False)
        self._commands: dict[str, Callable[[str, str | None], Code]] = {
            "SETP": partial(self._set_value, "set point"),
            "MRMP": partial(self._set_value, "ramp"),
            "DEVN": partial(self._set_value, "deviation"),
            "AUXE": self._set_auxiliaries,
        }
        self._actions: dict[str, Callable[[], Code]] = {
            "RUNM": self._run,
            "STOP": lambda: self._stop(Stop.COMPUTER),
            "INIT": self._initialise,
            "HOLD": lambda: Code.NOT_NOW,
            "RESM": lambda: Code.NOT_NOW,
        }
        self._queries: dict[str, Callable[[], str]] = {
            f"PVAR{_CHANNEL}": lambda: self._shown(self.air.read_c),
            f"SETP{_CHANNEL}": lambda: self._shown(self._set_point_c),
            f"MRMP{_CHANNEL}": lambda: self._shown(self._ramp_c_per_min, 0.0),
            f"DEVN{_CHANNEL}": lambda: self._shown(self._deviation_c, 0.0),
            f"ALRM{_CHANNEL}": lambda: str(self._alarms),
            f"THTL{_CHANNEL}": lambda: f"{100.0 * self.air.power:.1f}",
            "AUXE1": lambda: str(self._auxiliaries["1"]),
            "AUXE2": lambda: str(self._auxiliaries["2"]),
            "MODE": lambda: str(self._mode),
            "SCOD": lambda: str(int(self.stop_code)),
            "OPTN": lambda: "0",
            "CHST": lambda: str(1 << 8 | 1),
            "IDEN": lambda: "8800",
            "VRSN": lambda: "gyrobench emulator",
        }

    def power_off(self, now_s: float) -> None:  # noqa: ARG002
        """Lose power: the chamber stops and its auxiliaries drop."""
        self.air.running = False
        self._end_program()
        self._discard_input()
        for group in self._auxiliaries:
            self._switch_auxiliaries(group, 0)

    def power_on(self, now_s: float) -> None:  # noqa: ARG002
        """Restart stopped, with the settings as they were."""
        self.stop_code = Stop.POWER_FAIL

    def break_sensor(self, error: int) -> None:  # noqa: ARG002 - it reports one kind only
        """Open the temperature input: the chamber stops."""
        self._open_input = self.air.faults.blind = True
        self._stop(Stop.OPEN_INPUT)

    def repair_sensor(self) -> None:
        """Close the temperature input; the chamber stays stopped."""
        self._open_input = self.air.faults.blind = False

    def raise_alarm(self, number: int, high: bool) -> None:
        """Set the condition of the process alarm (1), which stops the chamber, or the deviation alarm (2)."""
        self._alarms |= 1 << _ALARM_BITS[number, high]
        if number == _PROCESS_ALARM:
            self._stop(Stop.PROCESS_ALARM)

    def end_alarm(self, number: int) -> None:
        """End the condition of the alarm; the chamber stays stopped."""
        for (alarm, _), bit in _ALARM_BITS.items():
            if alarm == number:
                self._alarms &= ~(1 << bit)

    def use_fahrenheit(self, fahrenheit: bool) -> None:
        """Change the unit of all numbers."""
        self._per_c, self._zero = (1.8, 32.0) if fahrenheit else (1.0, 0.0)

    def start_profile(self, to_c: float) -> None:
        """Start a program at the panel."""
        self._manual_c = self._set_point_c
        self.air.set_point_c = to_c
        self.air.running, self.stop_code = True, Stop.RUNNING

    @property
    def _set_point_c(self) -> float:
        return self.air.set_point_c if self._manual_c is None else self._manual_c

    @property
    def _mode(self) -> int:
        return 0 if not self.air.running else _MANUAL if self._manual_c is None else _PROGRAM

    def _reply(self, request: str) -> bytes:
        text = request.upper()
        if query := _QUERY.fullmatch(text):
            if handle := self._queries.get(query[1] + query[2]):
                answer = handle()
            else:
                is_known = any(name.startswith(query[1]) for name in self._queries)
                answer = str(int(Code.WRONG_PARAMETER if is_known else Code.UNKNOWN_COMMAND))
        else:
            answer = str(int(self._execute(text)))
            if self._echo == "instead" and answer == "0":
                answer = request
        lines = [request] if self._echo == "before" else []
        return b"".join(line.encode("latin-1") + self._end_of_reply for line in [*lines, answer])

    def _execute(self, text: str) -> Code:
        command = _COMMAND.fullmatch(text)
        if not command:
            return Code.UNKNOWN_COMMAND
        name, number, value = command.groups()
        if name in self._actions:
            return Code.WRONG_PARAMETER if number or value is not None else self._actions[name]()
        return self._commands[name](number, value) if name in self._commands else Code.UNKNOWN_COMMAND

    def _shown(self, value_c: float, zero: float | None = None) -> str:
        """A temperature in the controller's unit; a difference with a ``zero`` of 0."""
        return f"{self._per_c * value_c + (self._zero if zero is None else zero):.3f}"

    def _set_value(self, name: str, channel: str, text: str | None) -> Code:
        low, high = {
            "set point": (self.air.parameters.low_c, self.air.parameters.high_c),
            "ramp": (0.0, _MAX_RAMP),
            "deviation": (0.0, _MAX_DEVIATION),
        }[name]
        value = decimal(text) if text is not None and channel == _CHANNEL else None
        if value is not None:
            value = (value - (self._zero if name == "set point" else 0.0)) / self._per_c
        if value is None or not low <= value <= high:
            return Code.WRONG_PARAMETER
        if name == "set point" and self._manual_c is not None:
            self._manual_c = value
        elif name == "set point":
            self.air.set_point_c = value
        elif name == "ramp":
            self._ramp_c_per_min, self.air.ramp_rate_c_per_min = value, value or None
        else:
            self._deviation_c = value
        return Code.DONE

    def _set_auxiliaries(self, group: str, text: str | None) -> Code:
        mask = int(text) if text is not None and re.fullmatch(r"[0-9]{1,3}", text) else -1
        if group not in self._auxiliaries or not 0 <= mask <= _ALL_AUXILIARIES:
            return Code.WRONG_PARAMETER
        if self._auxiliaries_need_run and not self.air.running:
            return Code.NOT_NOW
        self._switch_auxiliaries(group, mask)
        return Code.DONE

    def _switch_auxiliaries(self, group: str, mask: int) -> None:
        changed = self._auxiliaries[group] ^ mask
        self._auxiliaries[group] = mask
        for bit in range(_AUXILIARIES_IN_GROUP):
            if self._on_event and changed >> bit & 1:
                number = _AUXILIARIES_IN_GROUP * (int(group) - 1) + bit + 1
                self._on_event(number, bool(mask >> bit & 1))

    def _run(self) -> Code:
        if self._open_input or self._alarms & _PROCESS_ALARM_BITS or self._mode == _PROGRAM:
            return Code.NOT_NOW
        self.air.running = True
        self.stop_code = Stop.RUNNING
        return Code.DONE

    def _stop(self, code: Stop) -> Code:
        self.air.running = False
        self._end_program()
        if self._open_input:
            code = Stop.OPEN_INPUT
        elif self._alarms & _PROCESS_ALARM_BITS:
            code = Stop.PROCESS_ALARM
        self.stop_code = code
        if self._auxiliaries_need_run:
            for group in self._auxiliaries:
                self._switch_auxiliaries(group, 0)
        return Code.DONE

    def _end_program(self) -> None:
        self.air.set_point_c, self._manual_c = self._set_point_c, None

    def _initialise(self) -> Code:
        self._deviation_c = 0.0
        return self._stop(Stop.COMPUTER)


DIALECT = ChamberEmulation(Thermotron8800Emulator)
