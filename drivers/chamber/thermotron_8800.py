"""Driver of the Thermotron 8800 chamber controller (8200, 3800 alike) over its ASCII interface.

Source: Thermotron's published list of computer interface commands, in parts. Commands end with a
carriage return. A command is answered by a code, zero for done; a query by its value.

Where the public sources are silent or differ, the driver copes with all that they allow: some
controllers repeat what they were sent before or in place of the code, so what a command set is always
read back. It is assumed that a manual ramp of zero means as fast as possible, that of the bits of
``MODE?`` 0 (program) and 4 (manual) say that the temperature is controlled, and that auxiliaries keep
their state when the chamber stops. Set point limits can't be asked for.
"""

from __future__ import annotations

import re
from typing import Literal

from pydantic import Field

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import FaultError, RefusedError
from gyrobench.drivers.chamber import ChamberDialect, ChamberReading
from gyrobench.drivers.chamber.set_point import DECIMALS, check_commandable
from gyrobench.drivers.serial_line import LineDefaults, SerialLine
from gyrobench.drivers.text_line import LINE_ENDINGS, TextLine, agrees, ramp_agrees, settles

_PROGRAM, _MANUAL = 1 << 0, 1 << 4
_AUXILIARIES_IN_GROUP, _GROUPS = 8, 2
#: After a command was repeated, its code may follow within this time.
_CODE_AFTER_ECHO_S = 0.25
_MASK = re.compile(rb"[0-9]{1,5}(?:\.0*)?")
_DONE = 0

_ALARMS = ("low deviation", "high deviation", "", "", "low process", "high process")
_OPEN_INPUT = 6
_FAULT_STOPS = {
    4: "an external input",
    _OPEN_INPUT: "an open temperature input",
    7: "a process alarm",
    8: "its system monitor",
    9: "a power failure",
    10: "its over-temperature protection",
}


class Thermotron8800:
    """A chamber behind a Thermotron 8800.

    Parameters
    ----------
    line : SerialLine
        The line to the controller; closed by :meth:`close`.
    channel : int
        The controller's channel of the air temperature, 1 to 4.
    ending : bytes
        Ends each command.
    reply_timeout_s : float
        Longest wait for each reply.

    Raises
    ------
    InstrumentError
        It can't be talked to.
    """

    def __init__(
        self, line: SerialLine, channel: int = 1, ending: bytes = b"\r", reply_timeout_s: float = 1.0
    ) -> None:
        self._line = line
        self._channel = channel
        self._text = TextLine(line, ending, reply_timeout_s=reply_timeout_s)
        self._mask("MODE?")

    def identify(self) -> str:
        """What ``IDEN?`` and ``VRSN?`` say."""
        model, version = (
            self._ask(query).decode("ascii", "backslashreplace") for query in ("IDEN?", "VRSN?")
        )
        return f"Thermotron {model}, version {version}, channel {self._channel}"

    def read(self) -> ChamberReading:
        """Measure the air (``PVAR``), and read set point and operating mode back.

        Raises
        ------
        FaultError
            The controller stopped because a temperature input is open.
        """
        if self._mask("SCOD?") == _OPEN_INPUT:
            raise FaultError(
                self._line.instrument, "stopped by an open temperature input; check the temperature sensor"
            )
        air_c = self._number(f"PVAR{self._channel}?")
        return ChamberReading(air_c, self.set_point_c(), self._is_running())

    def alarms(self) -> list[str]:
        """Alarms of the channel (``ALRM``), and the fault that stopped the chamber last (``SCOD``)."""
        mask, code = self._mask(f"ALRM{self._channel}?"), self._mask("SCOD?")
        active = [
            f"{_name_of(bit)} alarm (bit {bit} of ALRM{self._channel}?)"
            for bit in range(mask.bit_length())
            if mask >> bit & 1
        ]
        return active + ([f"stopped by {_FAULT_STOPS[code]} (SCOD? {code})"] if code in _FAULT_STOPS else [])

    def clear_alarms(self) -> None:
        """Acknowledge the fault that stopped the chamber by a stop of the computer's own.

        Alarms follow their cause and need no clearing.
        """
        if self._mask("SCOD?") in _FAULT_STOPS:
            self._command("STOP")

    def limits_c(self) -> tuple[float, float]:
        """Raise RefusedError: the interface does not tell them."""
        raise RefusedError(
            self._line.instrument, "its interface does not tell the set point limits; look at its panel"
        )

    def set_temperature(self, temperature_c: float, rate_c_per_min: float | None) -> None:
        """Command a temperature (``SETP``) and the ramp to it (``MRMP``, zero for none).

        Raises
        ------
        RefusedError
            A value is no finite number, the controller refuses one, or does not hold it.
        """
        check_commandable(self._line.instrument, temperature_c, rate_c_per_min)
        self._set_ramp(0.0 if rate_c_per_min is None else rate_c_per_min)
        self._set(f"SETP{self._channel}", temperature_c)

    def set_point_c(self) -> float:
        """Temperature last commanded (``SETP``)."""
        return self._number(f"SETP{self._channel}?")

    def switch(self, on: bool) -> None:
        """Run in manual mode (``RUNM``) or stop (``STOP``).

        Raises
        ------
        RefusedError
            It does not do so.
        """
        if on == self._is_running():
            return
        self._command("RUNM" if on else "STOP")
        if not settles(self._line.clock, lambda: self._is_running() == on):
            raise self._refused("does not run although it was told to" if on else "runs on although stopped")

    def switch_event(self, number: int, on: bool) -> None:
        """Switch an auxiliary, 1 to 16 (``AUXE``).

        Raises
        ------
        RefusedError
            There is no such auxiliary, it does not keep its state, or the controller switches none
            now: some do so only while the chamber runs in manual mode.
        """
        group, bit = self._auxiliary(number)
        before = self._mask(f"AUXE{group}?")
        wanted = before | bit if on else before & ~bit
        self._command(
            f"AUXE{group},{wanted}",
            "Some controllers switch auxiliaries only while the chamber runs: put a chamber step before.",
        )
        if not settles(self._line.clock, lambda: self.is_event_on(number) == on):
            raise self._refused(f"auxiliary {number} does not keep its state")

    def is_event_on(self, number: int) -> bool:
        """Whether an auxiliary, 1 to 16, is switched on; raises RefusedError where there is none."""
        group, bit = self._auxiliary(number)
        return bool(self._mask(f"AUXE{group}?") & bit)

    def close(self) -> None:
        """Close the line; the controller goes on as it is."""
        self._line.close()

    def _is_running(self) -> bool:
        return bool(self._mask("MODE?") & (_PROGRAM | _MANUAL))

    def _auxiliary(self, number: int) -> tuple[int, int]:
        """Group of an auxiliary, and its bit there."""
        most = _GROUPS * _AUXILIARIES_IN_GROUP
        if not 1 <= number <= most:
            raise self._refused(f"there is no auxiliary {number}, only 1 to {most}")
        group, place = divmod(number - 1, _AUXILIARIES_IN_GROUP)
        return group + 1, 1 << place

    def _set_ramp(self, rate_c_per_min: float) -> None:
        name = f"MRMP{self._channel}"
        self._command(f"{name},{rate_c_per_min:.{DECIMALS}f}")
        if not settles(self._line.clock, lambda: ramp_agrees(self._number(f"{name}?"), rate_c_per_min)):
            held = self._number(f"{name}?")
            raise self._refused(f"holds {held:g} degC/min as {name}, asked were {rate_c_per_min:g}")

    def _set(self, name: str, value: float) -> None:
        self._command(f"{name},{value:.{DECIMALS}f}")
        if not settles(self._line.clock, lambda: agrees(self._number(f"{name}?"), value)):
            held = self._number(f"{name}?")
            raise self._refused(f"holds {held:g} as {name} although {value:g} was written and accepted")

    def _command(self, command: str, advice: str = "") -> None:
        """Give a command; raise RefusedError where its code is not zero."""
        text = self._text
        reply = text.ask(command)
        if reply == command.encode("ascii"):
            code_after = text.more(command, _CODE_AFTER_ECHO_S)
            if code_after is None:
                return  # it repeats the command in place of a code
            reply = code_after
        code = text.number(command, reply)
        if code != _DONE:
            raise self._refused(f"{command} was refused with code {code:g}. {advice}".rstrip())

    def _ask(self, query: str) -> bytes:
        reply = self._text.ask(query)
        return self._text.receive(query) if reply == query.encode("ascii") else reply

    def _number(self, query: str) -> float:
        return self._text.number(query, self._ask(query))

    def _mask(self, query: str) -> int:
        reply = self._ask(query)
        if not _MASK.fullmatch(reply):
            raise self._text.unexpected(query, reply)
        return int(float(reply))

    def _refused(self, message: str) -> RefusedError:
        return RefusedError(self._line.instrument, message)


def _name_of(bit: int) -> str:
    return (_ALARMS[bit] if bit < len(_ALARMS) else "") or "unknown"


class Thermotron8800Options(StrictModel):
    """Keys of its own in the station file."""

    channel: int = Field(default=1, ge=1, le=4, description="the controller's channel of the air temperature")
    line_ending: Literal["cr", "crlf", "lf"] = Field(default="cr", description="what ends each command")


def _open(line: SerialLine, options: Thermotron8800Options) -> Thermotron8800:
    return Thermotron8800(line, options.channel, LINE_ENDINGS[options.line_ending])


DIALECT = ChamberDialect(_open, Thermotron8800Options, LineDefaults(baudrate=9600, tcp_port=8888))
