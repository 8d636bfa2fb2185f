"""The CAN bus of the INS: opened and closed, and its frames in blocks of numpy arrays."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial
from itertools import islice
from typing import Any

import can

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import ConnectionFailedError, DocumentError
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.text_buses import SlcanBus, SocketcandBus
from gyrobench.drivers.serial_line import system_reason

#: Name of the instrument in errors.
INSTRUMENT = "INS"

#: Adapters that are read in blocks from their bytes.
_TEXT_BUSES: dict[str, Callable[..., can.BusABC]] = {"slcan": SlcanBus, "socketcand": SocketcandBus}

#: Frames taken at once; a bus of 1 Mbit/s carries fewer than 10,000 in a second.
_MAX_FRAMES = 100_000


def open_bus(
    interface: str, channel: str | int | None, clock: Clock, bitrate: int | None = None, **options: Any
) -> can.BusABC:
    """Open a CAN bus by its python-can interface name, without python-can's configuration files.

    Raises ConnectionFailedError if the interface or channel does not exist or can't be opened. Raises
    DocumentError if the world behind an emulated bus is wrong.
    """
    if bitrate is not None:
        options["bitrate"] = bitrate
    try:
        if interface in _TEXT_BUSES:
            return _TEXT_BUSES[interface](channel, clock, **options)
        if interface in ("emulator", "replay"):
            options["clock"] = clock.name
        return can.Bus(channel=channel, interface=interface, ignore_config=True, **options)
    except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
        if isinstance(error.__cause__, DocumentError):  # the world behind an emulated bus is wrong
            raise error.__cause__ from None
        raise ConnectionFailedError(
            INSTRUMENT,
            f"can't open the CAN interface '{interface}', channel {channel}: {system_reason(error)}. "
            "Check the station file's interface, channel and options, and the adapter.",
        ) from error


def close_bus(bus: can.BusABC) -> None:
    """Close a bus, also one whose adapter is gone; a second call does nothing."""
    with contextlib.suppress(can.CanError, OSError):  # the adapter is gone
        bus.shutdown()


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
