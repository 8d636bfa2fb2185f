"""Driver of the Watlow F4T chamber controller over SCPI, by default on TCP port 5025.

Source: the command list of the F4T's SCPI interface in a chamber maker's manual. Commands have no
reply, so the driver reads every setting back by the same words with a question mark. It assumes that this
works also for the ramp settings, the unit and the state of a profile. If an F4T does not answer the queries
for unit and profile, each sent up to twice when it is opened, the driver works without them. There are no
queries for set point limits and alarms, and no command to clear alarms; the error of the control loop can
be read.
"""

from __future__ import annotations

from pydantic import Field

from gyrobench.bench.foundations.errors import FaultError, NoReplyError
from gyrobench.drivers.chamber import ChamberDialect, ChamberOptions, ChamberReading, switch_output
from gyrobench.drivers.chamber.text_chamber import TextChamber
from gyrobench.drivers.serial_line import LineDefaults, SerialLine
from gyrobench.drivers.text_line import LINE_ENDINGS, TextLine

_OUTPUTS = 8
_STATES = {b"ON": True, b"1": True, b"OFF": False, b"0": False}
_ERRORS = {b"ERROR": True, b"NONE": False}
_UNIT, _PROGRAM = ":UNIT:TEMPERATURE", ":PROGRAM:SELECTED:STATE"
#: First letters of the words for a profile in progress.
_IN_PROGRESS = ("RUN", "PAUS", "HOLD")
_MINUTES, _SET_POINT_RAMP, _NO_RAMP = "MINUTES", "SETPOINT", "OFF"


class WatlowF4T(TextChamber):
    """A chamber with a Watlow F4T; implements :class:`gyrobench.drivers.chamber.Chamber`.

    ``loop`` is the control loop of the air temperature; ``chamber_output`` switches the chamber's machinery
    on. Raises InstrumentError if the controller can't be reached.
    """

    set_point_name = "SPOINT"
    separator = " "
    event_name = "output"
    max_events = _OUTPUTS

    def __init__(
        self, line: SerialLine, loop: int = 1, chamber_output: int = 1, reply_timeout_s: float = 1.0
    ) -> None:
        super().__init__(line, TextLine(line, LINE_ENDINGS["lf"], reply_timeout_s=reply_timeout_s))
        self.prefix = f":SOURCE:CLOOP{loop}:"
        self._loop = loop
        self._chamber_output = chamber_output
        self._identity = self._word("*IDN?")
        self._command(f"{_UNIT} C")
        self._supported_queries = {name for name in (_UNIT, _PROGRAM) if self._is_supported(name)}

    def identify(self) -> str:
        """Return the reply to ``*IDN?``, and the control loop."""
        return f"{self._identity}, control loop {self._loop}"

    def read(self) -> ChamberReading:
        """Read air temperature (``PVALUE``), error of the control loop, set point and the chamber's output.

        Raises FaultError if the control loop reports an error.
        """
        if self._choice(self.prefix + "ERROR?", _ERRORS):
            problem = f"control loop {self._loop} reports an error; check the temperature sensor"
            raise FaultError(self._line.instrument, problem)
        air_c = self._number(self.prefix + "PVALUE?")
        is_on = self.is_event_on(self._chamber_output)
        return ChamberReading(air_c, self.set_point_c(), is_on, alarms=())  # no alarms can be read

    def clear_alarms(self) -> None:
        """Do nothing: the error clears with its cause."""

    def running_profile(self) -> str:
        """Describe a profile that runs or is paused (``PROGRAM:SELECTED:STATE?``)."""
        state = self._optional_word(_PROGRAM)
        return f"a profile (its state is {state})" if state.upper().startswith(_IN_PROGRESS) else ""

    def end_profile(self) -> None:
        """Stop the profile."""
        self._command(f"{_PROGRAM} STOP")
        self._settles(lambda: not self.running_profile())

    def switch(self, on: bool) -> None:
        """Switch the chamber's output; raises as :func:`gyrobench.drivers.chamber.switch_output`."""
        switch_output(self, self._chamber_output, on, self.end_profiles, self._line.instrument)

    def switch_event(self, number: int, on: bool) -> None:
        """Switch an output (``OUTPUTn:STATE``); raises RefusedError if it does not hold its state."""
        self._command(f"{self._output(number)} {'ON' if on else 'OFF'}")
        self._confirm_event(number, on)

    def is_event_on(self, number: int) -> bool:
        """Whether an output is on; raises RefusedError if there is no such output."""
        return self._choice(f"{self._output(number)}?", _STATES)

    def _require_ready(self) -> None:
        """Raise RefusedError if a profile runs, or the unit was changed: the chamber is then switched off."""
        if self._optional_word(_UNIT).upper().startswith("F"):
            self.switch_event(self._chamber_output, False)
            raise self._refused(
                "its unit was changed from °C to °F, so the chamber was switched off. Change it back at the "
                "panel."
            )
        super()._require_ready()

    def _is_supported(self, name: str) -> bool:
        """Whether the controller answers a query that some models do not answer."""
        for _ in range(2):  # one reply may be lost
            try:
                self._word(f"{name}?")
            except NoReplyError:
                self._word("*IDN?")  # raises NoReplyError if it answers nothing at all
            else:
                return True
        return False

    def _optional_word(self, name: str) -> str:
        """Answer to such a query; empty if the controller does not support it."""
        return self._word(f"{name}?") if name in self._supported_queries else ""

    def _output(self, number: int) -> str:
        self._check_event(number)
        return f":OUTPUT{number}:STATE"

    def _set_ramp(self, rate_c_per_min: float | None) -> None:
        """Set ``RRATE``, ``RSCALE`` and ``RACTION``; the action last, so that no ramp uses an old rate."""
        if rate_c_per_min is None:
            self._set_word("RACTION", _NO_RAMP)
        else:
            self._set_rate("RRATE", rate_c_per_min)
            self._set_word("RSCALE", _MINUTES)
            self._set_word("RACTION", _SET_POINT_RAMP)

    def _set_word(self, name: str, word: str) -> None:
        query = f"{self.prefix}{name}?"

        def is_held() -> bool:
            present = self._word(query)
            return bool(present) and word.startswith(present.upper())  # SCPI may abbreviate words

        self._command(f"{self.prefix}{name} {word}")
        if not self._settles(is_held):
            raise self._refused(f"holds {self._word(query)} as {name} although {word} was written")

    def _command(self, command: str) -> None:
        self._text.send(command)

    def _format(self, value: float) -> str:
        """Format a decimal number without trailing zeros: 25, 0.5."""
        return super()._format(value).rstrip("0").rstrip(".")

    def _choice(self, query: str, meanings: dict[bytes, bool]) -> bool:
        reply = self._text.ask(query)
        try:
            return meanings[reply.upper()]
        except KeyError:
            raise self._text.unexpected(query, reply) from None

    def _word(self, query: str) -> str:
        return self._text.ask(query).decode("ascii", errors="backslashreplace")


class WatlowF4TOptions(ChamberOptions):
    """Additional keys in the station file."""

    loop: int = Field(1, ge=1, le=4, description="control loop of the air temperature")
    chamber_output: int = Field(
        1, ge=1, le=_OUTPUTS, description="output that switches the chamber's machinery"
    )


def _open(line: SerialLine, options: WatlowF4TOptions) -> WatlowF4T:
    chamber = WatlowF4T(line, options.loop, options.chamber_output)
    chamber.end_profiles = options.running_profile == "end"
    return chamber


DIALECT = ChamberDialect(_open, WatlowF4TOptions, LineDefaults(baudrate=38400, tcp_port=5025))
