"""What drivers of chamber controllers with text commands share: number commands, read back after each."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

from gyrobench.bench.foundations.clock import Deadline
from gyrobench.bench.foundations.errors import RefusedError
from gyrobench.drivers.chamber import require_no_profile
from gyrobench.drivers.serial_line import SerialLine
from gyrobench.drivers.text_line import TextLine

#: Decimals of numbers in commands.
_DECIMALS = 3
_MAX_NUMBER = 99_999.0

#: Controllers may answer a query before they have executed the command before it.
_SETTLING_TIME_S, _SETTLING_POLL_S = 2.0, 0.1

#: Controllers may keep tenths only; for a slow ramp that is a large relative error.
_HALF_A_TENTH = 0.051
_MAX_RAMP_ERROR = 0.05


class TextChamber(ABC):
    """A chamber whose controller has text commands ``NAME value`` and queries ``NAME?``."""

    set_point_name: str  #: Name of the set point in commands and queries.
    #: prefix, separator: Before the name, and between name and value.
    prefix = ""
    separator: str
    can_ramp = True
    end_profiles = False  #: Whether a running profile is ended.
    event_name: str  #: What the controller calls its event outputs.
    max_events: int  #: Number of its event outputs.

    def __init__(self, line: SerialLine, text: TextLine) -> None:
        self._line = line
        self._text = text

    def limits_c(self) -> tuple[float, float]:
        """Raise RefusedError: the interface has no query for the limits."""
        raise self._refused("has no query for its set point limits; read them from its panel")

    def set_temperature(self, temperature_c: float, rate_c_per_min: float | None) -> None:
        """Command a ramp, then the temperature.

        Raises RefusedError: a value is not a number that can be commanded, the controller runs a profile or
        works in another unit, or it does not keep the value.
        """
        if rate_c_per_min is not None and not _MAX_NUMBER > round(rate_c_per_min, _DECIMALS) > 0.0:
            raise self._refused(f"a ramp of {rate_c_per_min} °C/min can't be commanded")
        if not abs(temperature_c) < _MAX_NUMBER:
            raise self._refused(f"a set point of {temperature_c} °C can't be commanded")
        self._require_ready()
        self._set_ramp(rate_c_per_min)
        self._set_number(self.set_point_name, temperature_c, _agrees)

    def set_point_c(self) -> float:
        """Temperature last commanded."""
        return self._number(f"{self.prefix}{self.set_point_name}?")

    @abstractmethod
    def running_profile(self) -> str:
        """Describe the profile that the controller runs by itself; empty if none."""

    @abstractmethod
    def end_profile(self) -> None:
        """End that profile."""

    @abstractmethod
    def is_event_on(self, number: int) -> bool:
        """Whether an event output is on; raises RefusedError where there is none."""

    def close(self) -> None:
        """Close the line; the controller continues unchanged."""
        self._line.close()

    @abstractmethod
    def _set_ramp(self, rate_c_per_min: float | None) -> None:
        """Command the ramp of the next set point, None for none."""

    @abstractmethod
    def _command(self, command: str) -> None:
        """Send a command."""

    def _require_ready(self) -> None:
        """Raise RefusedError if a set point would not have its effect."""
        require_no_profile(self, self._line.instrument, self.end_profiles)

    def _format(self, value: float) -> str:
        return f"{value:.{_DECIMALS}f}"

    def _ask(self, query: str) -> bytes:
        return self._text.ask(query)

    def _number(self, query: str) -> float:
        return self._text.number(query, self._ask(query))

    def _set_rate(self, name: str, rate_c_per_min: float) -> None:
        self._set_number(name, rate_c_per_min, _ramp_agrees, " degC/min")

    def _set_number(
        self, name: str, value: float, agrees: Callable[[float, float], bool], unit: str = ""
    ) -> None:
        query = f"{self.prefix}{name}?"
        self._command(f"{self.prefix}{name}{self.separator}{self._format(value)}")
        if not self._settles(lambda: agrees(self._number(query), value)):
            held = self._number(query)
            raise self._refused(f"holds {held:g}{unit} as {name} although {value:g} was written")

    def _check_event(self, number: int) -> None:
        if not 1 <= number <= self.max_events:
            raise self._refused(f"there is no {self.event_name} {number}, only 1 to {self.max_events}")

    def _confirm_event(self, number: int, on: bool) -> None:
        if not self._settles(lambda: self.is_event_on(number) == on):
            raise self._refused(f"{self.event_name} {number} does not keep its state")

    def _settles(self, is_so: Callable[[], bool]) -> bool:
        """Poll until a command has taken effect; False if it has not within the settling time."""
        clock = self._line.clock
        deadline = Deadline(clock, _SETTLING_TIME_S)
        while not is_so():
            if deadline.expired():
                return False
            clock.sleep(_SETTLING_POLL_S)
        return True

    def _refused(self, message: str) -> RefusedError:
        return RefusedError(self._line.instrument, message)


def _agrees(held: float, written: float) -> bool:
    """Whether a number read back is the one written, rounded to tenths at worst."""
    return abs(held - written) < _HALF_A_TENTH and (held != 0.0 or written == 0.0)


def _ramp_agrees(held: float, written: float) -> bool:
    return _agrees(held, written) and abs(held - written) <= _MAX_RAMP_ERROR * abs(written)
