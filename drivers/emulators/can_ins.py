"""Emulated INS on CAN: sends frames and receives commands, in one of several frame formats."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType
from typing import Protocol

import can
import numpy as np

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.packages import CAN_FORMATS, installed, load
from gyrobench.bench.foundations.text import did_you_mean
from gyrobench.drivers.emulators.can_formats import CanFormat
from gyrobench.drivers.emulators.can_formats.canaerospace import CanaerospaceFormat
from gyrobench.drivers.emulators.can_formats.gyrobench_ins import GyrobenchFormat
from gyrobench.drivers.emulators.can_formats.sbg import SbgFormat
from gyrobench.drivers.emulators.dialect import Connection
from gyrobench.drivers.emulators.world.inertial_unit import Epochs, Mode
from gyrobench.drivers.emulators.world.world import World
from gyrobench.drivers.frames import FrameBlock, concatenate

#: Shipped frame formats by the name of the DBC file; packages add others (``CAN_FORMATS``).
SHIPPED_FORMATS: MappingProxyType[str, type[CanFormat]] = MappingProxyType(
    {"gyrobench_ins": GyrobenchFormat, "sbg": SbgFormat, "canaerospace": CanaerospaceFormat}
)
_DEFAULT_FORMAT = "gyrobench_ins"


class CanNode(Protocol):
    """A CAN node that represents the INS.

    As the world advances, each listener is called with the frames that the node sends.
    """

    listeners: list[Callable[[FrameBlock], None]]

    def receive(self, message: can.Message) -> None:
        """Receive a frame from the bus."""


class CanInsEmulator:
    """The INS at its CAN connector; a :class:`CanNode`.

    A client that waits for frames must advance the world. ``epoch_unix_s`` is the Unix time at world time
    zero.
    """

    def __init__(self, world: World, epoch_unix_s: float = 0.0) -> None:
        self._world = world
        self._epoch_unix_s = epoch_unix_s
        self.listeners: list[Callable[[FrameBlock], None]] = []
        self.use_format(_DEFAULT_FORMAT)
        world.on_epochs = self._send_epochs

    def use_format(self, name: str) -> None:
        """Use the frame format of the DBC file of that name.

        Raises DocumentError if there is no such format, or its package is broken.
        """
        offered = installed(CAN_FORMATS)
        if name not in SHIPPED_FORMATS and name not in offered:
            names = (*SHIPPED_FORMATS, *offered)
            raise DocumentError(
                f"no emulated INS sends the frames {name!r}{did_you_mean(name, names)}; "
                f"available: {', '.join(names)}. A package adds others by the entry point {CAN_FORMATS}"
            )
        make = SHIPPED_FORMATS.get(name) or load(CAN_FORMATS, name, type)
        if not issubclass(make, CanFormat):
            raise DocumentError(
                f"the set of CAN frames {name!r} is {make.__qualname__}, no subclass of CanFormat. "
                "Report this to the package's author"
            )
        self.format = make(self._world, self._epoch_unix_s)

    def receive(self, message: can.Message) -> None:
        """Receive a frame; ignores unknown frames, and all frames while the INS is off or boots."""
        if message.is_extended_id or message.is_error_frame or message.is_remote_frame:
            return
        if self._world.unit.mode is not Mode.OFF:
            self.format.receive(message)

    def _send_epochs(self, epochs: Epochs) -> None:
        try:
            frames = self.format.frames(epochs)
        except (ValueError, LookupError) as error:  # which a driver takes for bytes that are no frame
            raise RuntimeError(f"{type(self.format).__name__}.frames failed: {error}") from error
        for listener in self.listeners:
            listener(frames)


@dataclass
class EmulatedUnit:
    """One inertial unit on the table of an emulated bench."""

    world: World
    ins: CanInsEmulator
    bus: CanNode  #: The INS as clients reach it, with faults.
    connection: Connection  #: Plug of the bus.
    power_event: int  #: Event output of the chamber that powers the unit.


class CanChannel:
    """A CAN bus with one unit on it, or several whose identifiers differ by an offset; a :class:`CanNode`."""

    def __init__(self) -> None:
        self.listeners: list[Callable[[FrameBlock], None]] = []
        self.units: list[EmulatedUnit] = []  #: The connected units.
        self._offsets: list[int] = []

    def connect(self, unit: EmulatedUnit, identifier_offset: int = 0) -> None:
        """Connect a unit; a second call for the same unit does nothing."""

        def forward(frames: FrameBlock) -> None:
            if identifier_offset:
                frames = frames.with_fields(id=frames.arbitration_id + np.uint32(identifier_offset))
            for listener in self.listeners:
                listener(frames)

        if not any(connected is unit for connected in self.units):
            self.units.append(unit)
            self._offsets.append(identifier_offset)
            unit.bus.listeners.append(forward)

    @property
    def generation(self) -> int:
        """Changes whenever the bench's CAN controller leaves the bus or may reopen it."""
        return sum(unit.connection.generation for unit in self.units)

    def receive(self, message: can.Message) -> None:
        """Pass a frame to each unit, with the unit's offset subtracted from the identifier."""
        for unit, offset in zip(self.units, self._offsets, strict=True):
            if message.arbitration_id >= offset:
                unit_message = copy.copy(message)
                unit_message.arbitration_id -= offset
                unit.bus.receive(unit_message)

    def in_order(self, blocks: list[FrameBlock]) -> FrameBlock:
        """Join the blocks of all units in the order of their time stamps."""
        frames = concatenate(blocks)
        return frames.in_order() if len(self.units) > 1 else frames
