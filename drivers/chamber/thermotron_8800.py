"""Driver of the Thermotron 8800 chamber controller (also 8200, 3800) over its ASCII interface.

Source: parts of Thermotron's published list of computer interface commands. Commands end with a
carriage return. The reply to a command is a code, zero for success; the reply to a query is its value.

Some controllers echo the command before or in place of the code, so the driver reads every setting back.
Assumptions, where the public sources are silent or differ: a manual ramp of zero means as fast as
possible; bits 0 (program) and 4 (manual) of ``MODE?`` mean that temperature control is on;
auxiliaries keep their state when the chamber stops; ``STOP`` ends a program. There is no query for the set
point limits, and none for the unit, which has to be °C: a set point that reads as the commanded one in °F
shows that an operator changed it.
"""

from __future__ import annotations

import re
from typing import Literal

from pydantic import Field

from gyrobench.bench.foundations.errors import FaultError, RefusedError
from gyrobench.drivers.chamber import ChamberDialect, ChamberOptions, ChamberReading
from gyrobench.drivers.chamber.text_chamber import TextChamber
from gyrobench.drivers.serial_line import LineDefaults, SerialLine
from gyrobench.drivers.text_line import LINE_ENDINGS, TextLine

_PROGRAM, _MANUAL = 1 << 0, 1 << 4
_AUXILIARIES_IN_GROUP = 8
#: Longest time between the echo of a command and its code.
_CODE_AFTER_ECHO_S = 0.25
_MASK = re.compile(rb"[0-9]{1,5}(?:\.0*)?")
_ERROR_CODE = re.compile(rb"[1-9]")
_DONE = 0
#: Controllers may store tenths.
_MAX_ROUNDING = 0.15
_FAHRENHEIT = "its unit was changed from °C to °F"

_ALARMS = {0: "low deviation", 1: "high deviation", 4: "low process", 5: "high process"}
_OPEN_INPUT = 6
_FAULT_STOPS = {
    4: "an external input",
    _OPEN_INPUT: "an open temperature input",
    7: "a process alarm",
    8: "its system monitor",
    9: "a power failure",
    10: "its over-temperature protection",
}


class Thermotron8800(TextChamber):
    """A chamber with a Thermotron 8800; implements :class:`gyrobench.drivers.chamber.Chamber`.

    ``channel`` is the controller's channel of the air temperature, 1 to 4; ``ending`` ends each command.
    Raises InstrumentError if the controller can't be reached.
    """

    separator = ","
    event_name = "auxiliary"
    max_events = 16

    def __init__(
        self, line: SerialLine, channel: int = 1, ending: bytes = b"\r", reply_timeout_s: float = 1.0
    ) -> None:
        super().__init__(line, TextLine(line, ending, reply_timeout_s=reply_timeout_s))
        self._channel = channel
        self._commanded_c: float | None = None  # set point that this driver commanded last
        self.set_point_name = f"SETP{channel}"
        self._mask("MODE?")

    def identify(self) -> str:
        """Return the replies to ``IDEN?`` and ``VRSN?``, and the channel."""
        model, version = (
            self._text.ask(query).decode("ascii", "backslashreplace") for query in ("IDEN?", "VRSN?")
        )
        return f"Thermotron {model}, version {version}, channel {self._channel}"

    def read(self) -> ChamberReading:
        """Read air temperature (``PVAR``), alarms (``ALRM``, ``SCOD``), set point and operating mode.

        Raises FaultError if the controller stopped because a temperature input is open, or works in °F.
        """
        mask, code = self._mask(f"ALRM{self._channel}?"), self._mask("SCOD?")
        alarms = [
            f"{_ALARMS.get(bit, 'unknown')} alarm (bit {bit} of ALRM{self._channel}?)"
            for bit in range(mask.bit_length())
            if mask >> bit & 1
        ]
        alarms += [f"stopped by {_FAULT_STOPS[code]} (SCOD? {code})"] if code in _FAULT_STOPS else []
        if code == _OPEN_INPUT:
            raise FaultError(self._line.instrument, f"{', '.join(alarms)}; check the temperature sensor")
        air_c, set_c = self._number(f"PVAR{self._channel}?"), self.set_point_c()
        if self._is_in_fahrenheit(set_c):
            problems = ", ".join([*alarms, _FAHRENHEIT])
            raise FaultError(self._line.instrument, f"{problems}; change it back at the panel")
        return ChamberReading(air_c, set_c, self._is_running(), alarms=tuple(alarms))

    def set_temperature(self, temperature_c: float, rate_c_per_min: float | None) -> None:
        """Command the ramp, then the set point; raises as that of :class:`TextChamber`."""
        super().set_temperature(temperature_c, rate_c_per_min)
        self._commanded_c = temperature_c

    def clear_alarms(self) -> None:
        """Acknowledge by ``STOP`` a fault that stopped the chamber; alarms clear with their cause."""
        if self._mask("SCOD?") in _FAULT_STOPS:
            self._command("STOP")

    def running_profile(self) -> str:
        """Describe a program that runs (bit 0 of ``MODE?``)."""
        mode = self._mask("MODE?")
        return f"a program (MODE? {mode})" if mode & _PROGRAM else ""

    def end_profile(self) -> None:
        """Stop the program (``STOP``) and continue in manual mode (``RUNM``), as the chamber was on."""
        self._command("STOP")
        self._command("RUNM")

    def switch(self, on: bool) -> None:
        """Run in manual mode (``RUNM``) or stop (``STOP``), which ends a program too.

        Raises RefusedError if the mode does not change, or to switch on while a program runs.
        """
        mode = self._mask("MODE?")
        if on and mode & _PROGRAM:
            self._require_ready()
        elif on == bool(mode & (_PROGRAM | _MANUAL)):
            return
        self._command("RUNM" if on else "STOP")
        if not self._settles(lambda: self._is_running() == on):
            raise self._refused("does not run after RUNM" if on else "still runs after STOP")

    def switch_event(self, number: int, on: bool) -> None:
        """Switch an auxiliary, 1 to 16 (``AUXE``).

        Raises RefusedError if there is no such auxiliary, it does not hold its state, or the controller
        refuses: some switch auxiliaries only while the chamber runs in manual mode.
        """
        group, bit = self._auxiliary(number)
        present = self._mask(f"AUXE{group}?")
        mask = present | bit if on else present & ~bit
        self._command(
            f"AUXE{group},{mask}",
            "Some controllers switch auxiliaries only while the chamber runs: put a chamber step before.",
        )
        self._confirm_event(number, on)

    def is_event_on(self, number: int) -> bool:
        """Whether an auxiliary, 1 to 16, is on; raises RefusedError if there is no such auxiliary."""
        group, bit = self._auxiliary(number)
        return bool(self._mask(f"AUXE{group}?") & bit)

    def _require_ready(self) -> None:
        """Raise RefusedError if a program runs, or the unit was changed: the chamber is then switched off."""
        super()._require_ready()
        if self._commanded_c is not None and self._is_in_fahrenheit(self.set_point_c()):
            self._command("STOP")
            raise self._refused(
                f"{_FAHRENHEIT}, so the chamber was switched off. Change it back at the panel."
            )

    def _is_in_fahrenheit(self, set_point: float) -> bool:
        """Whether a set point that was read is the last commanded one in °F; it is the same at -40 °."""
        commanded_c = self._commanded_c
        return (
            commanded_c is not None
            and abs(set_point - commanded_c) > _MAX_ROUNDING
            and abs(set_point - (1.8 * commanded_c + 32.0)) < _MAX_ROUNDING
        )

    def _is_running(self) -> bool:
        return bool(self._mask("MODE?") & (_PROGRAM | _MANUAL))

    def _auxiliary(self, number: int) -> tuple[int, int]:
        """Group of an auxiliary, and its bit in the mask of the group."""
        self._check_event(number)
        group, bit_index = divmod(number - 1, _AUXILIARIES_IN_GROUP)
        return group + 1, 1 << bit_index

    def _set_ramp(self, rate_c_per_min: float | None) -> None:
        self._commanded_c = None  # until the set point that follows is confirmed
        self._set_rate(f"MRMP{self._channel}", rate_c_per_min or 0.0)

    def _command(self, command: str, advice: str = "") -> None:
        """Send a command; raises RefusedError with ``advice`` if its code is not zero."""
        text = self._text
        reply = text.ask(command)
        if reply == command.encode("ascii"):
            code_after = text.more(command, _CODE_AFTER_ECHO_S)
            if code_after is None:
                return  # this controller echoes the command in place of a code
            reply = code_after
        code = text.number(command, reply)
        if code != _DONE:
            raise self._refused(f"{command} was refused with code {code:g}. {advice}".rstrip())

    def _number(self, query: str) -> float:
        reply = self._text.ask(query)
        if _ERROR_CODE.fullmatch(reply):  # an error code has one digit; values have decimals
            raise RefusedError(self._line.instrument, f"{query} was refused with code {reply.decode()}")
        return self._text.number(query, reply)

    def _mask(self, query: str) -> int:
        reply = self._text.ask(query)
        if not _MASK.fullmatch(reply):
            raise self._text.unexpected(query, reply)
        return int(float(reply))


class Thermotron8800Options(ChamberOptions):
    """Additional keys in the station file."""

    channel: int = Field(1, ge=1, le=4, description="the controller's channel of the air temperature")
    line_ending: Literal["cr", "crlf", "lf"] = Field("cr", description="what ends each command")


def _open(line: SerialLine, options: Thermotron8800Options) -> Thermotron8800:
    chamber = Thermotron8800(line, options.channel, LINE_ENDINGS[options.line_ending])
    chamber.end_profiles = options.running_profile == "end"
    return chamber


DIALECT = ChamberDialect(_open, Thermotron8800Options, LineDefaults(baudrate=9600, tcp_port=8888))
