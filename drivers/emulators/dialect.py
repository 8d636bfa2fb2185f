"""What makes an emulator one of a dialect, and what faults can do to it beyond its line.

Every emulator is at least a :class:`~gyrobench.drivers.emulators.serial_instrument.SerialInstrument`. The
protocols below are what it may offer besides; a fault that needs one of them is refused where the
emulator lacks it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from gyrobench.drivers.emulators.serial_instrument import SerialInstrument
from gyrobench.drivers.emulators.world.chamber_air import ChamberAir
from gyrobench.drivers.emulators.world.table_axis import TableAxis

#: Told of every event output that changes: its number, counted from 1, and its state.
OnEvent = Callable[[int, bool], None]


@dataclass(frozen=True)
class TableEmulation:
    """A dialect of emulated tables; offered as an entry point of the group ``gyrobench.emulators``.

    Attributes
    ----------
    make : callable
        Makes the controller from the physics of each axis by its number: 1 outer, 2 inner. A table
        with a single axis is the inner one.
    """

    make: Callable[[Mapping[int, TableAxis]], SerialInstrument]


@dataclass(frozen=True)
class ChamberEmulation:
    """A dialect of emulated chambers; offered as an entry point of the group ``gyrobench.emulators``.

    Attributes
    ----------
    make : callable
        Makes the controller from the air that it controls, and from what it has to call when an
        event output changes.
    """

    make: Callable[[ChamberAir, OnEvent], SerialInstrument]


@runtime_checkable
class Restartable(Protocol):
    """It can lose power and come back."""

    def power_off(self, now_s: float) -> None:
        """Lose power: outputs drop, a table stops by its brakes."""
        ...

    def power_on(self, now_s: float) -> None:
        """Come back with what it keeps without power."""
        ...


@runtime_checkable
class Servoed(Protocol):
    """A table whose axes are held by servos."""

    def is_servoed(self, axis: int) -> bool:
        """Whether the servo of that axis is closed; KeyError where there is no such axis."""
        ...


@runtime_checkable
class WithSensor(Protocol):
    """A chamber whose temperature sensor can fail."""

    def break_sensor(self, error: int) -> None:
        """Let the sensor fail with that error; the control stops."""
        ...

    def mend_sensor(self) -> None:
        """Let the sensor be well again."""
        ...


@runtime_checkable
class WithAlarms(Protocol):
    """A chamber that tells of alarms."""

    def raise_alarm(self, number: int, high: bool) -> None:
        """Give alarm 1 or 2 a cause."""
        ...

    def end_alarm(self, number: int) -> None:
        """Take its cause away."""
        ...


@runtime_checkable
class SpeaksModbus(Protocol):
    """A device with Modbus RTU frames."""

    def refusal(self, function: int, code: int) -> bytes:
        """Frame with an exception code in reply to that function."""
        ...
