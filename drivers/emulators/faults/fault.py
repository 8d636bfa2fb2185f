"""What all faults have in common, and the parts of the bench that they act on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from drivers.emulators.acutrol3000 import Acutrol3000Emulator
from drivers.emulators.can_ins import CanInsEmulator
from drivers.emulators.faults.faulty_can import FaultyCan
from drivers.emulators.faults.faulty_serial import FaultySerial
from drivers.emulators.faults.timing import Timing
from drivers.emulators.watlow_f4 import WatlowF4Emulator
from drivers.emulators.world.world import World

#: Ends a fault; nothing to do where None stands for it.
End = Callable[[], None] | None


@dataclass(frozen=True)
class BenchParts:
    """The emulated bench as faults see it.

    Attributes
    ----------
    lines : mapping of str to FaultySerial
        ``table`` and ``chamber`` at their ports.
    """

    world: World
    table: Acutrol3000Emulator
    chamber: WatlowF4Emulator
    ins: CanInsEmulator
    lines: Mapping[str, FaultySerial]
    bus: FaultyCan


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

    def begin(self, bench: BenchParts, occurrence: Occurrence) -> End:
        """Begin on the bench, whose world is at the present; returns what ends it."""
        raise NotImplementedError
