"""CAN frame formats of an emulated INS: their common base; each other module is one format."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import can
import numpy as np
from numpy.typing import NDArray

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.drivers.emulators.world.inertial_unit import Epochs, InertialUnit
from gyrobench.drivers.emulators.world.world import World
from gyrobench.drivers.frames import FRAME_DTYPE, FrameBlock, concatenate

#: Time that a frame takes on the bus, s.
FRAME_S = 0.00025


class CanFormat(ABC):
    """Base class of the frame formats of an emulated INS, named by its DBC file.

    A subclass encodes the output of the simulated INS, ``self._world``, and executes the commands that it
    receives. ``epoch_unix_s`` is the Unix time at world time zero, for the time stamps of the frames.
    """

    def __init__(self, world: World, epoch_unix_s: float) -> None:
        self._world = world
        self._epoch_unix_s = epoch_unix_s
        self.reset_counters()

    @abstractmethod
    def frames(self, epochs: Epochs) -> FrameBlock:
        """Encode the output of the INS at these epochs, in the order of sending.

        Called with successive epochs. Slow frames, such as status and temperatures, are sent at the epochs
        that are whole seconds.
        """

    @abstractmethod
    def receive(self, message: can.Message) -> None:
        """Execute a command, received as a data frame with an 11-bit identifier; ignores unknown frames."""

    def reset_counters(self) -> None:  # noqa: B027 - a format may have none
        """Reset all counters, as at power-on."""

    def skip_epochs(self, count: int) -> None:  # noqa: B027
        """Make the epoch counter jump by ``count``, if there is one."""


def execute_command(unit: InertialUnit, command: int, argument: int = 0) -> None:
    """Execute a command of the bench by its number; ignores unknown commands."""
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
        case 7 if argument in (0, 1):
            unit.sends_increments = argument == 1


def empty_frames(
    time_s: FloatArray, identifiers: Sequence[int], lengths: int | Sequence[int]
) -> NDArray[np.void]:
    """Return empty frames, shape (n, k): from each of n times on, the k identifiers one after the other."""
    rows = np.zeros((len(time_s), len(identifiers)), FRAME_DTYPE)
    rows["time_s"] = time_s[:, None] + FRAME_S * np.arange(len(identifiers))
    rows["id"], rows["length"] = identifiers, lengths
    return rows


def in_order(*groups: NDArray[np.void]) -> FrameBlock:
    """Join groups of frames in the order of sending."""
    return concatenate([FrameBlock(group.ravel()) for group in groups]).in_order()
