"""Interfaces of the emulator of a dialect.

Every emulator implements :class:`SerialInstrument`; :class:`TextInstrument` is a base class for text
protocols. An entry point names its :class:`TableEmulation` or :class:`ChamberEmulation`. The other protocols
here are optional capabilities that faults use; a fault is refused if the emulator lacks the capability that
it needs.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from gyrobench.drivers.emulators.world.table_axis import TableAxis

#: Called when an event output changes, with its number, from 1, and its new state.
OnEvent = Callable[[int, bool], None]


class SerialInstrument(Protocol):
    """An emulated instrument on a serial line: bytes in, bytes out."""

    latency_s: float  #: Time from the last byte of a request to the first byte of its reply.

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Receive bytes at time ``now_s``; returns the replies to the requests that they complete.

        Returns empty bytes if there is no reply. The world has already been advanced to ``now_s``. Must
        accept any bytes, also incomplete and invalid requests.
        """


class Connection:
    """The plug between an instrument and its clients, which faults pull."""

    def __init__(self) -> None:
        self.broken = False  #: Whether the plug is pulled, so that nothing is transmitted.
        #: Increases with each disconnection and reconnection; a client from before must reopen its port.
        self.generation = 0

    def disconnect(self) -> None:
        """Pull the plug."""
        self.broken = True
        self.generation += 1

    def reconnect(self) -> None:
        """Plug in again."""
        self.broken = False
        self.generation += 1


@dataclass(frozen=True)
class TableEmulation:
    """A dialect of emulated tables; registered as an entry point of the group ``gyrobench.emulators``."""

    #: Returns the controller. Argument: the physics of each axis by its number, 1 outer, 2 inner. A table
    #: with a single axis uses the inner one.
    make: Callable[[Mapping[int, TableAxis]], SerialInstrument]


@dataclass(frozen=True)
class ChamberEmulation:
    """A dialect of emulated chambers; registered as an entry point of the group ``gyrobench.emulators``."""

    #: Returns the controller. Arguments: the :class:`ChamberAir` that it controls, an :data:`OnEvent`
    #: function that it calls when an event output changes, and options as keyword arguments.
    make: Callable[..., SerialInstrument]


@runtime_checkable
class Restartable(Protocol):
    """An instrument that can lose power and restart."""

    def power_off(self, now_s: float) -> None:
        """Lose power: outputs drop, a table stops by its brakes."""

    def power_on(self, now_s: float) -> None:
        """Restart with the settings that are kept without power."""


@runtime_checkable
class Servoed(Protocol):
    """A table whose axes are held by servos."""

    def is_servoed(self, axis: int) -> bool:
        """Whether the servo of an axis is closed; raises KeyError if there is no such axis."""


@runtime_checkable
class WithTemperatureSensor(Protocol):
    """A chamber whose temperature sensor can fail."""

    def break_sensor(self, error: int) -> None:
        """Make the sensor fail with the error of that number; control stops."""

    def repair_sensor(self) -> None:
        """Repair the sensor."""


@runtime_checkable
class WithAlarms(Protocol):
    """A chamber with alarms."""

    def raise_alarm(self, number: int, high: bool) -> None:
        """Begin the condition of alarm 1 or 2, above its high limit or below its low limit."""

    def end_alarm(self, number: int) -> None:
        """End the condition of the alarm."""


@runtime_checkable
class WithProfiles(Protocol):
    """A chamber whose controller can run a profile."""

    def start_profile(self, to_c: float) -> None:
        """Start at the panel a profile that goes to ``to_c``."""


@runtime_checkable
class WithTemperatureUnit(Protocol):
    """A chamber whose unit of temperature can be changed at the panel."""

    def use_fahrenheit(self, fahrenheit: bool) -> None:
        """Change the unit to degrees Fahrenheit, or back to Celsius."""


@runtime_checkable
class WithDecimals(Protocol):
    """A chamber whose number of decimals can be changed at the panel."""

    decimals: int  #: Number of decimals of temperatures.


@runtime_checkable
class WithRamp(Protocol):
    """A chamber controller of which some models can't ramp their set point."""

    def remove_ramp(self) -> None:
        """Change the emulated model to one without ramps."""


@runtime_checkable
class SpeaksModbus(Protocol):
    """A device with Modbus RTU frames."""

    def refusal(self, function: int, code: int) -> bytes:
        """Return the reply frame that refuses a function with an exception code."""


_MAX_CHARACTERS = 200
_ENDS = re.compile(rb"[\r\n]+")
_NUMBER = re.compile(r"[-+]?(?:[0-9]{1,9}(?:\.[0-9]{0,9})?|\.[0-9]{1,9})")


class TextInstrument(ABC):
    """Base class of instruments with text protocols; a subclass implements ``_reply``.

    ``_now_s`` is the time of the last :meth:`feed`.
    """

    def __init__(self, latency_s: float) -> None:
        self.latency_s = latency_s
        self._now_s = 0.0
        self._discard_input()

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Receive bytes at time ``now_s``; returns the replies to the requests that they complete."""
        self._now_s = now_s
        return b"".join(self._reply(request) for request in self._take_requests(data))

    @abstractmethod
    def _reply(self, request: str) -> bytes:
        """Execute one request, which is not empty; returns the bytes of the reply."""

    def _discard_input(self) -> None:
        """Discard an incomplete request, as on power-off."""
        self._input, self._overlong = b"", False

    def _take_requests(self, data: bytes) -> list[str]:
        """Return the requests that these bytes complete; drops those that are too long."""
        *complete, self._input = _ENDS.split(self._input + data)
        requests = []
        for request in complete:
            too_long, self._overlong = self._overlong or len(request) > _MAX_CHARACTERS, False
            if request and not too_long:
                requests.append(request.decode("latin-1").strip())
        if len(self._input) > _MAX_CHARACTERS:
            self._input, self._overlong = b"", True
        return requests


def decimal(text: str) -> float | None:
    """Parse a decimal number without exponent; None for any other text."""
    return float(text) if _NUMBER.fullmatch(text.strip()) else None
