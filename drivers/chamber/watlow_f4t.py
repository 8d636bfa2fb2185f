"""Driver of the Watlow F4T chamber controller over SCPI, by default on TCP port 5025.

Source: the command list of the F4T's SCPI interface in a chamber maker's manual. Queries are answered
by one line, commands by nothing: so what a command set is read back, by the same words with a
question mark. It is assumed that this works for the ramp's settings as well. Set point limits, alarms
and clearing can't be asked for; an error of the control loop can.
"""

from __future__ import annotations

from pydantic import Field

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import FaultError, RefusedError
from gyrobench.drivers.chamber import ChamberDialect, ChamberReading
from gyrobench.drivers.chamber.set_point import DECIMALS, check_commandable
from gyrobench.drivers.serial_line import LineDefaults, SerialLine
from gyrobench.drivers.text_line import LINE_ENDINGS, TextLine, agrees, ramp_agrees, settles

_OUTPUTS = 8
_STATES = {b"ON": True, b"1": True, b"OFF": False, b"0": False}
_ERRORS = {b"ERROR": True, b"NONE": False}
_MINUTES, _SET_POINT_RAMP, _NO_RAMP = "MINUTES", "SETPOINT", "OFF"


class WatlowF4T:
    """A chamber behind a Watlow F4T.

    Parameters
    ----------
    line : SerialLine
        The line to the controller; closed by :meth:`close`.
    loop : int
        Control loop of the air temperature.
    chamber_output : int
        Output that switches the chamber's machinery on.
    reply_timeout_s : float
        Longest wait for each reply.

    Raises
    ------
    InstrumentError
        It can't be talked to.
    """

    def __init__(
        self, line: SerialLine, loop: int = 1, chamber_output: int = 1, reply_timeout_s: float = 1.0
    ) -> None:
        self._line = line
        self._loop = f":SOURCE:CLOOP{loop}:"
        self._loop_number = loop
        self._chamber_output = chamber_output
        self._text = TextLine(line, LINE_ENDINGS["lf"], reply_timeout_s=reply_timeout_s)
        self._identity = self._words("*IDN?")
        self._text.send(":UNIT:TEMPERATURE C")

    def identify(self) -> str:
        """Answer to ``*IDN?``, and what distinguishes this controller."""
        return f"{self._identity}, control loop {self._loop_number}"

    def read(self) -> ChamberReading:
        """Measure the air (``PVALUE``); read error, set point and the chamber's output back.

        Raises
        ------
        FaultError
            The control loop reports an error.
        """
        if self._has_error():
            raise FaultError(self._line.instrument, f"{self._error_words()}; check the temperature sensor")
        air_c = self._number(self._loop + "PVALUE?")
        return ChamberReading(air_c, self.set_point_c(), self.is_event_on(self._chamber_output))

    def alarms(self) -> list[str]:
        """Error of the control loop (``ERROR``), all that the interface tells."""
        return [self._error_words()] if self._has_error() else []

    def clear_alarms(self) -> None:
        """Do nothing: the error goes with its cause."""

    def limits_c(self) -> tuple[float, float]:
        """Raise RefusedError: the interface does not tell them."""
        raise RefusedError(
            self._line.instrument, "SCPI does not tell the set point limits; look at its panel"
        )

    def set_temperature(self, temperature_c: float, rate_c_per_min: float | None) -> None:
        """Command a temperature (``SPOINT``) and the ramp to it (``RRATE``, ``RSCALE``, ``RACTION``).

        Raises
        ------
        RefusedError
            A value is no finite number, or the controller does not hold it.
        """
        check_commandable(self._line.instrument, temperature_c, rate_c_per_min)
        if rate_c_per_min is None:
            self._set_word("RACTION", _NO_RAMP)
        else:
            # The action comes last, so that no ramp starts with an old rate.
            self._set_ramp(rate_c_per_min)
            self._set_word("RSCALE", _MINUTES)
            self._set_word("RACTION", _SET_POINT_RAMP)
        self._set_number("SPOINT", temperature_c)

    def set_point_c(self) -> float:
        """Temperature last commanded (``SPOINT``)."""
        return self._number(self._loop + "SPOINT?")

    def switch(self, on: bool) -> None:
        """Switch the chamber's output."""
        self.switch_event(self._chamber_output, on)

    def switch_event(self, number: int, on: bool) -> None:
        """Switch an output (``OUTPUTn:STATE``).

        Raises
        ------
        RefusedError
            There is no such output, or it does not keep its state.
        """
        self._text.send(f"{self._output(number)} {'ON' if on else 'OFF'}")
        if not settles(self._line.clock, lambda: self.is_event_on(number) == on):
            raise self._refused(f"output {number} does not keep its state")

    def is_event_on(self, number: int) -> bool:
        """Whether an output is switched on; raises RefusedError where there is none."""
        return self._choice(f"{self._output(number)}?", _STATES)

    def close(self) -> None:
        """Close the line; the controller goes on as it is."""
        self._line.close()

    def _has_error(self) -> bool:
        return self._choice(self._loop + "ERROR?", _ERRORS)

    def _error_words(self) -> str:
        return f"control loop {self._loop_number} reports an error"

    def _output(self, number: int) -> str:
        if not 1 <= number <= _OUTPUTS:
            raise self._refused(f"there is no output {number}, only 1 to {_OUTPUTS}")
        return f":OUTPUT{number}:STATE"

    def _set_ramp(self, rate_c_per_min: float) -> None:
        self._text.send(f"{self._loop}RRATE {_plain(rate_c_per_min)}")
        query = f"{self._loop}RRATE?"
        if not settles(self._line.clock, lambda: ramp_agrees(self._number(query), rate_c_per_min)):
            held = self._number(query)
            raise self._refused(f"holds {held:g} degC/min as RRATE, asked were {rate_c_per_min:g}")

    def _set_number(self, name: str, value: float) -> None:
        self._text.send(f"{self._loop}{name} {_plain(value)}")
        if not settles(self._line.clock, lambda: agrees(self._number(f"{self._loop}{name}?"), value)):
            held = self._number(f"{self._loop}{name}?")
            raise self._refused(f"holds {held:g} as {name} although {value:g} was written")

    def _set_word(self, name: str, word: str) -> None:
        query = f"{self._loop}{name}?"

        def is_held() -> bool:
            held = self._words(query)
            return bool(held) and word.startswith(held.upper())  # SCPI may shorten its words

        self._text.send(f"{self._loop}{name} {word}")
        if not settles(self._line.clock, is_held):
            raise self._refused(f"holds {self._words(query)} as {name} although {word} was written")

    def _choice(self, query: str, meanings: dict[bytes, bool]) -> bool:
        reply = self._text.ask(query)
        try:
            return meanings[reply.upper()]
        except KeyError:
            raise self._text.unexpected(query, reply) from None

    def _words(self, query: str) -> str:
        return self._text.ask(query).decode("ascii", errors="backslashreplace")

    def _number(self, query: str) -> float:
        return self._text.number(query, self._text.ask(query))

    def _refused(self, message: str) -> RefusedError:
        return RefusedError(self._line.instrument, message)


def _plain(value: float) -> str:
    """Decimal number without zeros at its end: 25, 0.5."""
    return f"{value:.{DECIMALS}f}".rstrip("0").rstrip(".")


class WatlowF4TOptions(StrictModel):
    """Keys of its own in the station file."""

    loop: int = Field(default=1, ge=1, le=4, description="control loop of the air temperature")
    chamber_output: int = Field(
        default=1, ge=1, le=_OUTPUTS, description="output that switches the chamber's machinery"
    )


def _open(line: SerialLine, options: WatlowF4TOptions) -> WatlowF4T:
    return WatlowF4T(line, options.loop, options.chamber_output)


DIALECT = ChamberDialect(_open, WatlowF4TOptions, LineDefaults(baudrate=38400, tcp_port=5025))
