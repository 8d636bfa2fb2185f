"""What all faults have in common, and the parts of the bench that they act on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from gyrobench.drivers.emulators.can_ins import CanInsEmulator
from gyrobench.drivers.emulators.faults.faulty_can import FaultyCan
from gyrobench.drivers.emulators.faults.faulty_serial import FaultySerial
from gyrobench.drivers.emulators.faults.timing import Timing
from gyrobench.drivers.emulators.serial_instrument import SerialInstrument
from gyrobench.drivers.emulators.world.world import World

#: Ends a fault; nothing to do where None stands for it.
End = Callable[[], None] | None

AbilityT = TypeVar("AbilityT")


class UnfitError(Exception):
    """A fault that this bench can't have; never leaves the checks of a list."""


@dataclass(frozen=True)
class BenchParts:
    """The emulated bench as faults see it.

    Attributes
    ----------
    lines : mapping of str to FaultySerial
        ``table`` and ``chamber`` at their ports.
    dialects : mapping of str to str
        What these two speak.
    """

    world: World
    table: SerialInstrument
    chamber: SerialInstrument
    ins: CanInsEmulator
    lines: Mapping[str, FaultySerial]
    bus: FaultyCan
    dialects: Mapping[str, str] = field(default_factory=dict)

    def able(self, name: str, ability: type[AbilityT]) -> AbilityT:
        """Table or chamber as something that a fault needs.

        Raises
        ------
        UnfitError
            An emulator of this dialect is nothing such.
        """
        instrument = self.table if name == "table" else self.chamber
        if not isinstance(instrument, ability):
            raise UnfitError(f"an emulated {name} of the dialect {self.dialects.get(name)} can't have it")
        return instrument


@dataclass(frozen=True)
class Occurrence:
    """One time that a fault comes.

    Attributes
    ----------
    now_s : callable
        The time on the bench's clock.
    random : Generator
        For what is random in it.
    record : callable
        To be called when the fault takes effect; only the first call of an occurrence counts.
    """

    now_s: Callable[[], float]
    random: np.random.Generator
    record: Callable[[], None]


class Fault(Timing):
    """One entry of the list; a subclass is one kind, named by its key ``fault``."""

    @property
    def kind(self) -> str:
        """Name of the kind."""
        return str(getattr(self, "fault"))  # noqa: B009

    def check(self, bench: BenchParts) -> None:
        """Raise UnfitError where this bench can't have the fault."""

    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        """Begin on the bench, whose world is at the present; returns what ends it."""
        raise NotImplementedError
