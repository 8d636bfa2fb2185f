"""Base class of drivers of chamber controllers with text commands; reads back each number that it writes."""

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

#: Largest differences of a value read back: controllers may store tenths only, which for a slow ramp is
#: a large relative error.
_HALF_A_TENTH = 0.051
_MAX_RAMP_ERROR = 0.05


class TextChamber(ABC):
    """A chamber whose controller has text commands ``NAME value`` and queries ``NAME?``.

    A subclass sets the class attributes below and implements the abstract methods and ``identify``,
    ``read``, ``clear_alarms``, ``switch`` and ``switch_event`` of :class:`gyrobench.drivers.chamber.Chamber`.
    """

    set_point_name: str  #: Name of the set point in commands and queries.
    #: prefix, separator: Text before the name, and between name and value.
    prefix = ""
    separator: str
    can_ramp = True
    end_profiles = False  #: Whether to end a running profile; else a set point is refused while one runs.
    event_name: str  #: The controller's term for an event output, for messages.
    max_events: int  #: Number of event outputs.

    def __init__(self, line: SerialLine, text: TextLine) -> None:
        self._line = line
        self._text = text

    def limits_c(self) -> tuple[float, float]:
        """Raise RefusedError; a subclass overrides this if its controller has a query for the limits."""
        raise self._refused("has no query for its set point limits; read them from its panel")

    def set_temperature(self, temperature_c: float, rate_c_per_min: float | None) -> None:
        """Command the ramp, then the set point.

        Raises RefusedError if a value can't be commanded, a profile runs, the controller works in another
        unit, or it does not hold the value that was written.
        """
        if rate_c_per_min is not None and not _MAX_NUMBER > round(rate_c_per_min, _DECIMALS) > 0.0:
            raise self._refused(f"a ramp of {rate_c_per_min} °C/min can't be commanded")
        if not abs(temperature_c) < _MAX_NUMBER:
            raise self._refused(f"a set point of {temperature_c} °C can't be commanded")
        self._require_ready()
        self._set_ramp(rate_c_per_min)
        self._set_number(self.set_point_name, temperature_c, _agrees)

    def set_point_c(self) -> float:
        """Read the set point last commanded."""
        return self._number(f"{self.prefix}{self.set_point_name}?")

    @abstractmethod
    def running_profile(self) -> str:
        """Describe the profile that the controller runs; empty if none."""

    @abstractmethod
    def end_profile(self) -> None:
        """End the running profile."""

    @abstractmethod
    def is_event_on(self, number: int) -> bool:
        """Whether an event output is on; raises RefusedError if there is no such output."""

    def close(self) -> None:
        """Close the line; the controller continues unchanged."""
        self._line.close()

    @abstractmethod
    def _set_ramp(self, rate_c_per_min: float | None) -> None:
        """Command the ramp of the next set point; None for no ramp."""

    @abstractmethod
    def _command(self, command: str) -> None:
        """Send a command; raises RefusedError if the controller refuses it."""

    def _require_ready(self) -> None:
        """Raise RefusedError if the controller would not follow a set point, as while a profile runs."""
        require_no_profile(self, self._line.instrument, self.end_profiles)

    def _format(self, value: float) -> str:
        return f"{value:.{_DECIMALS}f}"

    def _number(self, query: str) -> float:
        """Send a query; returns its reply as a number."""
        return self._text.number(query, self._text.ask(query))

    def _set_rate(self, name: str, rate_c_per_min: float) -> None:
        """Set a ramp rate by its name; raises as :meth:`_set_number`."""
        self._set_number(name, rate_c_per_min, _ramp_agrees, " degC/min")

    def _set_number(
        self, name: str, value: float, agrees: Callable[[float, float], bool], unit: str = ""
    ) -> None:
        """Set a number by its name and read it back.

        Raises RefusedError unless ``agrees(number read back, value)``; ``unit`` is for the message.
        """
        query = f"{self.prefix}{name}?"
        self._command(f"{self.prefix}{name}{self.separator}{self._format(value)}")
        if not self._settles(lambda: agrees(self._number(query), value)):
            present = self._number(query)
            raise self._refused(f"holds {present:g}{unit} as {name} although {value:g} was written")

    def _check_event(self, number: int) -> None:
        """Raise RefusedError if there is no event output of this number."""
        if not 1 <= number <= self.max_events:
            raise self._refused(f"there is no {self.event_name} {number}, only 1 to {self.max_events}")

    def _confirm_event(self, number: int, on: bool) -> None:
        """Raise RefusedError unless an event output takes the state that was commanded."""
        if not self._settles(lambda: self.is_event_on(number) == on):
            raise self._refused(f"{self.event_name} {number} does not keep its state")

    def _settles(self, condition: Callable[[], bool]) -> bool:
        """Poll until ``condition`` is met after a command; False if it is not within the settling time."""
        clock = self._line.clock
        deadline = Deadline(clock, _SETTLING_TIME_S)
        while not condition():
            if deadline.expired():
                return False
            clock.sleep(_SETTLING_POLL_S)
        return True

    def _refused(self, message: str) -> RefusedError:
        return RefusedError(self._line.instrument, message)


def _agrees(read_back: float, written: float) -> bool:
    """Whether a number read back is the one written, at most rounded to tenths."""
    return abs(read_back - written) < _HALF_A_TENTH and (read_back != 0.0 or written == 0.0)


def _ramp_agrees(read_back: float, written: float) -> bool:
    return _agrees(read_back, written) and abs(read_back - written) <= _MAX_RAMP_ERROR * abs(written)
