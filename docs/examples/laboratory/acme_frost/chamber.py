"""Driver of the Acme Frost.

Requests end with a line feed, and each has one reply. ``T?`` asks for the air, ``S?`` for the set point,
``R?`` for the ramp, ``C?`` whether it controls, ``O?`` for its outputs as a number, bit 1 for output 1.
``S25.50``, ``R1.00``, ``C1``, ``+2`` and ``-2`` set; they are answered by ``ok``, or by ``E`` if refused.
"""

from __future__ import annotations

import math

from pydantic import Field

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import RefusedError
from gyrobench.drivers.chamber import ChamberDialect, ChamberReading
from gyrobench.drivers.serial_line import LineDefaults, SerialLine
from gyrobench.drivers.text_line import TextLine

_MAX_OUTPUTS = 8
_MAX_RAMP_C_PER_MIN = 10.0
_RESOLUTION_C = 0.01


class Frost:
    """An Acme Frost with the unit on one of its shelves."""

    can_ramp = True

    def __init__(self, line: SerialLine, shelf: int) -> None:
        self._line, self._text, self._shelf = line, TextLine(line, b"\n"), shelf

    def identify(self) -> str:
        return f"Acme Frost, shelf {self._shelf}"

    def read(self) -> ChamberReading:
        is_on = bool(self._number("C?"))
        return ChamberReading(self._number("T?"), self.set_point_c(), is_on, alarms=())  # it has no alarms

    def clear_alarms(self) -> None:
        """Do nothing: it latches no alarms."""

    def running_profile(self) -> str:
        return ""  # it has no profiles

    def end_profile(self) -> None:
        """Do nothing: it has no profiles."""

    def limits_c(self) -> tuple[float, float]:
        raise RefusedError(self._line.instrument, "has no query for its limits; read them from its panel")

    def set_temperature(self, temperature_c: float, rate_c_per_min: float | None) -> None:
        rate = 0.0 if rate_c_per_min is None else rate_c_per_min
        is_rate = rate_c_per_min is None or 0.0 < rate <= _MAX_RAMP_C_PER_MIN
        if not (is_rate and math.isfinite(temperature_c)):
            asked = f"{temperature_c} degC at {rate_c_per_min} degC/min"
            raise RefusedError(self._line.instrument, f"{asked} can't be commanded. Give finite numbers")
        self._set("R", rate)
        self._set("S", temperature_c)

    def set_point_c(self) -> float:
        return self._number("S?")

    def switch(self, on: bool) -> None:
        self._command(f"C{on:d}")

    def switch_event(self, number: int, on: bool) -> None:
        if not 1 <= number <= _MAX_OUTPUTS:
            raise RefusedError(self._line.instrument, f"has outputs 1 to {_MAX_OUTPUTS}, and no {number}")
        self._command(f"{'+' if on else '-'}{number}")

    def is_event_on(self, number: int) -> bool:
        return bool(int(self._number("O?")) >> number & 1)

    def close(self) -> None:
        self._line.close()

    def _set(self, name: str, value: float) -> None:
        """Set a value, and read it back."""
        self._command(f"{name}{value:.2f}")
        held = self._number(f"{name}?")
        if abs(held - value) > _RESOLUTION_C:
            raise RefusedError(
                self._line.instrument, f"holds {held:g} as {name} although {value:g} was written"
            )

    def _command(self, request: str) -> None:
        reply = self._text.ask(request)
        if reply == b"E":
            raise RefusedError(self._line.instrument, f"{request} was refused. Check its range at the panel")
        if reply != b"ok":
            raise self._text.unexpected(request, reply)

    def _number(self, query: str) -> float:
        return self._text.number(query, self._text.ask(query))


class FrostOptions(StrictModel):
    """Keys of the section ``chamber`` of a station file."""

    shelf: int = Field(ge=1, le=9, description="shelf that the unit stands on")


DIALECT = ChamberDialect(
    lambda line, options: Frost(line, options.shelf), FrostOptions, LineDefaults(tcp_port=77)
)
