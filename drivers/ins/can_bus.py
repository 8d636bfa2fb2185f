"""The CAN bus of the INS: opened and closed, and its frames in blocks of numpy arrays."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from functools import partial
from itertools import islice
from typing import Any

import can
from can.interfaces.slcan import slcanBus

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import ConnectionFailedError
from gyrobench.drivers.frames import FrameBlock

# python-can warns at each frame that socketcand delivers in two pieces, which is normal over TCP.
logging.getLogger("can.interfaces.socketcand").setLevel(logging.ERROR)

#: Name of the instrument in errors.
INSTRUMENT = "INS"

#: Frames taken at once; a bus of 1 Mbit/s carries fewer than 10,000 in a second.
_MAX_FRAMES = 100_000


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


def block_receiver(bus: can.BusABC) -> Callable[[], FrameBlock]:
    """Return the function that takes the frames that have arrived, in order and without waiting.

    A bus that can hand over blocks has it as its method ``recv_block``; any other is read message by message.
    An error of the bus is raised by the first call that has no frame from before it.
    """
    return getattr(bus, "recv_block", None) or _MessageReader(bus).recv_block


class _MessageReader:
    """Blocks from a bus that hands over messages."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._error: Exception | None = None

    def recv_block(self) -> FrameBlock:
        messages: list[can.Message] = []
        try:
            if self._error is not None:
                raise self._error
            # extend() keeps the frames before an exception.
            messages.extend(islice(iter(partial(self._bus.recv, 0.0), None), _MAX_FRAMES))
        except Exception as error:
            self._error = error if messages else None
            if not messages:
                raise
        return FrameBlock.from_messages(messages)
