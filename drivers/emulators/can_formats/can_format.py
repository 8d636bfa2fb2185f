"""What all sets of frames have in common."""

from __future__ import annotations

from typing import Protocol

import can

from gyrobench.drivers.emulators.world.inertial_unit import Epochs, InertialUnit

#: Time that a frame takes on the bus.
FRAME_S = 0.00025


class CanFormat(Protocol):
    """A set of frames that an INS speaks."""

    def frames(self, epochs: Epochs) -> list[can.Message]:
        """Pack what the INS puts out in a stretch of time, in the order of sending."""
        ...

    def receive(self, message: can.Message) -> None:
        """Take a standard data frame; one that means nothing changes nothing."""
        ...

    def count_anew(self) -> None:
        """Begin all counters at zero, as switching on does."""
        ...

    def skip_epochs(self, count: int) -> None:
        """Let the epoch counter jump; where there is none, nothing happens."""
        ...


def obey(unit: InertialUnit, command: int, argument: int = 0) -> None:
    """Do what the number of a command of the bench means."""
    match command:
        case 1:
            unit.standby()
        case 2:
            unit.align()
        case 3:
            unit.navigate()
        case 4 if argument in (0, 1):
            unit.pitch_first = argument == 1
        case 5:
            unit.clear_compensation()
        case 6:
            unit.apply_compensation()


def frame(time_s: float, identifier: int, data: bytes) -> can.Message:
    """Make a standard data frame."""
    return can.Message(timestamp=time_s, arbitration_id=identifier, data=data, is_extended_id=False)
