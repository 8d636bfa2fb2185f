"""The CAN bus that the INS hangs on."""

from __future__ import annotations

from typing import Any

import can

from bench.clock import Clock
from bench.errors import ConnectionFailedError

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
    if interface == "emulator":
        options["clock"] = clock.name
    try:
        return can.Bus(channel=channel, interface=interface, ignore_config=True, **options)
    except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
        raise ConnectionFailedError(
            INSTRUMENT,
            f"can't open the CAN interface '{interface}', channel {channel}: {error}. "
            "Check the station file's interface, channel and options, and the adapter.",
        ) from error
