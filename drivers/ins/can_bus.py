"""The CAN bus that the INS hangs on."""

from __future__ import annotations

import contextlib
import logging
from typing import Any

import can
from can.interfaces.slcan import slcanBus

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import ConnectionFailedError

# python-can warns of each frame that comes from socketcand in two pieces, as frames over TCP do.
logging.getLogger("can.interfaces.socketcand").setLevel(logging.ERROR)

#: What errors call the instrument.
INSTRUMENT = "INS"


def open_bus(
    interface: str, channel: str | int | None, clock: Clock, bitrate: int | None = None, **options: Any
) -> can.BusABC:
    """Open a CAN bus by its python-can interface name; python-can's own files are not read.

    Raises
    ------
    ConnectionFailedError
        There is no such interface or channel, or it can't be opened.
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
    """Leave a bus for good, also one whose adapter is gone; a second call does nothing."""
    try:
        bus.shutdown()
    except (can.CanError, OSError):  # gone already
        if isinstance(bus, slcanBus):
            # It says goodbye before it closes its port, and stops where that fails.
            with contextlib.suppress(OSError):
                bus.serialPortOrig.close()


def is_garbage(bus: can.BusABC, error: Exception) -> bool:
    """Whether an error of the bus means that what arrived is no frame, rather than that the bus is gone."""
    # slcan wraps what it raises for bytes that are no text.
    of_text = isinstance(bus, slcanBus) and isinstance(error.__cause__, UnicodeDecodeError)
    return of_text or isinstance(error, (ValueError, LookupError))


def stamp_in_time_of(clock: Clock, bus: can.BusABC, messages: list[can.Message]) -> None:
    """Turn stamps by the host's calendar into times of a clock that runs faster.

    slcan alone is stamped by the host; all others have the stamps of the bench itself.
    """
    if clock.speed != 1.0 and isinstance(bus, slcanBus):
        for message in messages:
            message.timestamp = clock.stamp_s(message.timestamp)


def drop_half_line(bus: can.BusABC) -> None:
    """Forget the begin of a line that can't be understood, or it would spoil the next one too.

    Raises
    ------
    CanError
        The bus went away.
    """
    if isinstance(bus, slcanBus):
        bus.flush()
