"""What replaces an instrument that is left out because it does not answer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from uuid import uuid4

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import InstrumentError, RefusedError
from gyrobench.bench.station.station import Station
from gyrobench.drivers.chamber import ChamberReading
from gyrobench.drivers.ins.can_bus import open_bus
from gyrobench.drivers.ins.can_ins import CanIns
from gyrobench.drivers.rate_table import TableReading


class AbsentInstrument:
    """Replaces a table or chamber that does not answer: reads nothing and refuses every command."""

    def __init__(self, error: InstrumentError, empty_reading: TableReading | ChamberReading) -> None:
        self._instrument, self._empty_reading = error.instrument, empty_reading

    def __getattr__(self, name: str) -> Callable[..., Any]:
        def refuse(*_: object, **__: object) -> None:
            raise RefusedError(
                self._instrument, "did not answer when the bench was opened. Start jog again once it answers."
            )

        return refuse

    def read(self) -> TableReading | ChamberReading:
        """Read nothing."""
        return self._empty_reading

    def close(self) -> None:
        """Do nothing: it has no port."""


def disconnected_ins(station: Station, clock: Clock) -> CanIns:
    """An INS on a virtual bus inside this process, on which no node sends."""
    section = station.file.ins
    bus = open_bus("virtual", f"absent INS {uuid4()}", clock)
    return CanIns(bus, section.signals, station.database(), clock, section.commands, name=station.instrument)
