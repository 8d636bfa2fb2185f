"""What an emulator of a dialect is, and what faults can do to it beyond its line.

Every emulator is at least a :class:`SerialInstrument`; those with text protocols are a
:class:`TextInstrument`. The capabilities below are optional; a fault that needs one of them is refused where
the emulator lacks it.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from gyrobench.drivers.emulators.world.table_axis import TableAxis

#: Called for every event output that changes: its number, counted from 1, and its state.
OnEvent = Callable[[int, bool], None]


class SerialInstrument(Protocol):
    """An instrument that takes bytes and answers with bytes."""

    latency_s: float  #: Time from the last byte of a request to the first byte of its reply.

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the line at time ``now_s`` and return the reply, if one is complete.

        The world has already been advanced to ``now_s``. Any byte sequence is accepted.
        """


class Connection:
    """The plug between an instrument and its clients."""

    def __init__(self) -> None:
        self.broken = False  #: Whether nothing is transmitted at present.
        #: Changes with every disconnect and reconnect: a client that opened an earlier one must reopen.
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
    """A dialect of emulated tables; offered as an entry point of the group ``gyrobench.emulators``."""

    #: Makes the controller from the physics of each axis by its number: 1 outer, 2 inner. A table with a
    #: single axis is the inner one.
    make: Callable[[Mapping[int, TableAxis]], SerialInstrument]


@dataclass(frozen=True)
class ChamberEmulation:
    """A dialect of emulated chambers; offered as an entry point of the group ``gyrobench.emulators``."""

    #: Makes the controller from the air that it controls, a function to call when an event output changes,
    #: and options by keyword.
    make: Callable[..., SerialInstrument]


@runtime_checkable
class Restartable(Protocol):
    """It can lose power and restart."""

    def power_off(self, now_s: float) -> None:
        """Lose power: outputs drop, a table stops by its brakes."""

    def power_on(self, now_s: float) -> None:
        """Restart with the settings that survive without power."""


@runtime_checkable
class Servoed(Protocol):
    """A table whose axes are held by servos."""

    def is_servoed(self, axis: int) -> bool:
        """Whether the servo of that axis is closed; KeyError where there is no such axis."""


@runtime_checkable
class WithTemperatureSensor(Protocol):
    """A chamber whose temperature sensor can fail."""

    def break_sensor(self, error: int) -> None:
        """Make the sensor fail with that error; control stops."""

    def repair_sensor(self) -> None:
        """End the sensor's failure."""


@runtime_checkable
class WithAlarms(Protocol):
    """A chamber with alarms."""

    def raise_alarm(self, number: int, high: bool) -> None:
        """Set the condition of alarm 1 or 2."""

    def end_alarm(self, number: int) -> None:
        """End the condition of the alarm."""


@runtime_checkable
class WithProfiles(Protocol):
    """A chamber whose controller can run a profile by itself."""

    def start_profile(self, to_c: float) -> None:
        """Start a profile to a temperature at the panel."""


@runtime_checkable
class WithTemperatureUnit(Protocol):
    """A chamber whose panel can change the unit of temperatures."""

    def use_fahrenheit(self, fahrenheit: bool) -> None:
        """Change the unit."""


@runtime_checkable
class WithDecimals(Protocol):
    """A chamber whose numbers have decimals that its panel can change."""

    decimals: int  #: Decimals of temperatures.


@runtime_checkable
class WithRamp(Protocol):
    """A chamber of which some models do not ramp their set point."""

    def remove_ramp(self) -> None:
        """Become a model without ramps."""


@runtime_checkable
class SpeaksModbus(Protocol):
    """A device with Modbus RTU frames."""

    def refusal(self, function: int, code: int) -> bytes:
        """Frame with an exception code in reply to that function."""


_MAX_CHARACTERS = 200
_ENDS = re.compile(rb"[\r\n]+")
_NUMBER = re.compile(r"[-+]?(?:[0-9]{1,9}(?:\.[0-9]{0,9})?|\.[0-9]{1,9})")


class TextInstrument(ABC):
    """An instrument that answers lines of text; a subclass gives the answer to each."""

    def __init__(self, latency_s: float) -> None:
        self.latency_s = latency_s
        self._now_s = 0.0
        self._discard_input()

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Take bytes at time ``now_s``; return the replies to the requests that they complete."""
        self._now_s = now_s
        return b"".join(self._reply(request) for request in self._take_requests(data))

    @abstractmethod
    def _reply(self, request: str) -> bytes:
        """Execute one request, never empty, and return the bytes of the reply."""

    def _discard_input(self) -> None:
        """Discard an incomplete request, as on power-off."""
        self._input, self._overlong = b"", False

    def _take_requests(self, data: bytes) -> list[str]:
        """Requests that these bytes complete; overlong ones are dropped."""
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
    """Value of a plain decimal number; None for any other text."""
    return float(text) if _NUMBER.fullmatch(text.strip()) else None
