"""The CAN bus of the INS: opened and closed, and its frames in blocks of numpy arrays."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import can
import numpy as np
from can.interfaces.slcan import slcanBus
from numpy.typing import NDArray

from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray
from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import ConnectionFailedError

# python-can warns at each frame that socketcand delivers in two pieces, which is normal over TCP.
logging.getLogger("can.interfaces.socketcand").setLevel(logging.ERROR)

#: Name of the instrument in errors.
INSTRUMENT = "INS"


def open_bus(
    interface: str, channel: str | int | None, clock: Clock, bitrate: int | None = None, **options: Any
) -> can.BusABC:
    """Open a CAN bus by its python-can interface name, without python-can's configuration files.

    Raises ConnectionFailedError if the interface or channel does not exist or can't be opened.
    """
    if bitrate is not None:
        options["bitrate"] = bitrate
    if interface in ("emulator", "replay"):
        options["clock"] = clock.name
    try:
        return can.Bus(channel=channel, interface=interface, ignore_config=True, **options)
    except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
        raise ConnectionFailedError(
            INSTRUMENT,
            f"can't open the CAN interface '{interface}', channel {channel}: {error}. "
            "Check the station file's interface, channel and options, and the adapter.",
        ) from error


def close_bus(bus: can.BusABC) -> None:
    """Close a bus, also one whose adapter is gone; a second call does nothing."""
    try:
        bus.shutdown()
    except (can.CanError, OSError):  # the adapter is gone
        if isinstance(bus, slcanBus):
            # Its shutdown() fails at its last message and leaves the port open.
            with contextlib.suppress(OSError):
                bus.serialPortOrig.close()


def is_garbage(bus: can.BusABC, error: Exception) -> bool:
    """Whether an error of the bus means that received bytes are no frame; else the bus is gone."""
    # slcan wraps the error of undecodable bytes.
    undecodable = isinstance(bus, slcanBus) and isinstance(error.__cause__, UnicodeDecodeError)
    return undecodable or isinstance(error, (ValueError, LookupError))


def stamp_in_time_of(clock: Clock, bus: can.BusABC, messages: list[can.Message]) -> None:
    """Convert stamps by the host's calendar, which slcan alone has, into times of a faster clock."""
    if clock.speed != 1.0 and isinstance(bus, slcanBus):
        for message in messages:
            message.timestamp = clock.stamp_s(message.timestamp)


def drop_half_line(bus: can.BusABC) -> None:
    """Discard the beginning of an invalid line, which would make the next one invalid too.

    Raises CanError if the bus is gone.
    """
    if isinstance(bus, slcanBus):
        bus.flush()


#: Flag of a 29-bit identifier, as in SocketCAN and in DBC files.
EXTENDED_ID = 0x8000_0000

#: Bytes of data in a classic CAN frame.
MAX_LENGTH = 8


@dataclass(frozen=True, eq=False)
class FrameBlock:
    """Data frames in order of arrival."""

    timestamp_s: FloatArray  #: Shape (n,). Time stamp of the CAN interface.
    #: Shape (n,). Identifier, with :data:`EXTENDED_ID` set if it has 29 bits.
    arbitration_id: NDArray[np.uint32]
    length: NDArray[np.uint8]  #: Shape (n,). Number of data bytes, 0 to 8.
    data: NDArray[np.uint8]  #: Shape (n, 8). Data bytes, zero beyond the length.

    @classmethod
    def from_messages(cls, messages: Sequence[can.Message]) -> FrameBlock:
        """Collect python-can messages; error, remote and FD frames are dropped."""
        # One list comprehension an attribute is the fastest way to read Message objects.
        messages = [m for m in messages if not (m.is_error_frame or m.is_remote_frame or m.is_fd)]
        payloads = [m.data for m in messages]
        lengths = np.array([len(payload) for payload in payloads], np.int64)
        if np.any(lengths > MAX_LENGTH):
            return cls.from_messages([m for m in messages if len(m.data) <= MAX_LENGTH])
        if np.any(lengths < MAX_LENGTH):
            payloads = [payload.ljust(MAX_LENGTH, b"\0") for payload in payloads]
        identifiers = np.array([m.arbitration_id for m in messages], np.uint32)
        extended = np.array([m.is_extended_id for m in messages], np.bool_)
        return cls(
            timestamp_s=np.array([m.timestamp for m in messages], np.float64),
            arbitration_id=np.where(extended, identifiers | np.uint32(EXTENDED_ID), identifiers),
            length=lengths.astype(np.uint8),
            data=np.frombuffer(b"".join(payloads), np.uint8).reshape(-1, MAX_LENGTH),
        )

    def __len__(self) -> int:
        return len(self.timestamp_s)

    def take(self, rows: IntArray | BoolArray | slice) -> FrameBlock:
        """Select frames by a numpy index."""
        return FrameBlock(
            self.timestamp_s[rows], self.arbitration_id[rows], self.length[rows], self.data[rows]
        )

    def with_id(self, arbitration_id: int) -> FrameBlock:
        """Select the frames of one identifier, with :data:`EXTENDED_ID` set if it has 29 bits."""
        return self.take(self.arbitration_id == arbitration_id)


def concatenate(blocks: Sequence[FrameBlock]) -> FrameBlock:
    """Join blocks in the order given, none to an empty block."""
    if not blocks:
        return FrameBlock.from_messages([])
    return FrameBlock(
        np.concatenate([block.timestamp_s for block in blocks]),
        np.concatenate([block.arbitration_id for block in blocks]),
        np.concatenate([block.length for block in blocks]),
        np.concatenate([block.data for block in blocks]),
    )
