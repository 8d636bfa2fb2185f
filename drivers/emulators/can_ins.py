"""Emulated INS on CAN: frames out, commands in, in one of several sets of frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import can

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers.emulators.can_formats import CAN_FORMATS
from gyrobench.drivers.emulators.world.inertial_unit import Epochs, Mode
from gyrobench.drivers.emulators.world.world import World

#: The set of frames of an INS that is told nothing else.
DEFAULT_FORMAT = "gyrobench_ins"


class CanNode(Protocol):
    """A side of the bus with the INS behind it.

    Attributes
    ----------
    listeners : list of callable
        Each is called with the messages of every stretch of time that the world advances.
    """

    listeners: list[Callable[[list[can.Message]], None]]

    def receive(self, message: can.Message) -> None:
        """Take a frame from the bus."""
        ...


class CanInsEmulator:
    """The INS at its CAN connector.

    Parameters
    ----------
    world : World
        Its unit is this INS; the world must be advanced by whoever waits for frames.
    epoch_unix_s : float
        Calendar time at world time zero, for the frames' time stamps.

    Attributes
    ----------
    listeners : list of callable
        Each is called with the messages of every stretch of time that the world advances.
    """

    def __init__(self, world: World, epoch_unix_s: float = 0.0) -> None:
        self._world = world
        self._epoch_unix_s = epoch_unix_s
        self.listeners: list[Callable[[list[can.Message]], None]] = []
        self.speak(DEFAULT_FORMAT)
        world.on_epochs = self._send_epochs

    def speak(self, name: str) -> None:
        """Put out, and understand, the frames of the DBC file of that name from now on.

        Raises
        ------
        DocumentError
            No emulated INS speaks it.
        """
        if name not in CAN_FORMATS:
            raise DocumentError(f"no emulated INS speaks {name!r}; there are: {', '.join(CAN_FORMATS)}")
        self._format = CAN_FORMATS[name](self._world, self._epoch_unix_s)

    def receive(self, message: can.Message) -> None:
        """Take a frame from the bus.

        Ones that are not meant for this INS change nothing, nor does any while it is off or boots.
        """
        if message.is_extended_id or message.is_error_frame or message.is_remote_frame:
            return
        if self._world.unit.mode is not Mode.OFF:
            self._format.receive(message)

    def count_anew(self) -> None:
        """Begin all counters at zero, as switching on does."""
        self._format.count_anew()

    def skip_epochs(self, count: int) -> None:
        """Let the epoch counter jump."""
        self._format.skip_epochs(count)

    def _send_epochs(self, epochs: Epochs) -> None:
        messages = self._format.frames(epochs)
        for listener in self.listeners:
            listener(messages)
