"""Opening the instruments that a station file names."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from types import TracebackType
from urllib.parse import urlencode

from bench.clock import Clock
from bench.documents import find_document
from bench.errors import GyrobenchError
from bench.station.document import ChamberSection, RateTableSection
from bench.station.station import Station
from drivers.chamber import Chamber
from drivers.chamber.watlow_f4 import WatlowF4
from drivers.ins.can_bus import open_bus
from drivers.ins.can_ins import CanIns
from drivers.ins.dbc_codec import load_dbc
from drivers.rate_table import RateTable
from drivers.rate_table.acutrol3000 import Acutrol3000
from drivers.serial_line import SerialLine

#: Drivers by the dialects that a station file can name.
TABLE_DIALECTS: dict[str, Callable[[SerialLine, RateTableSection], RateTable]] = {
    "acutrol3000": lambda line, section: Acutrol3000(
        line, axes=sorted((section.outer_axis_number, section.inner_axis_number))
    ),
}
CHAMBER_DIALECTS: dict[str, Callable[[SerialLine, ChamberSection], Chamber]] = {
    "watlow_f4": lambda line, section: WatlowF4(line, address=section.address),
}

_EMULATOR = "emulator"


@dataclass(frozen=True)
class Emulation:
    """Which simulated world stands behind emulated instruments; real ones take no notice.

    Attributes
    ----------
    world : str
        World file by path or shipped name; only the emulators read it.
    seed : int
        Seed of everything random in it.
    """

    world: str = "gyro_a"
    seed: int = 0

    def options(self) -> dict[str, str | int]:
        """What an emulator's address says of the world."""
        return {"world": str(find_document("worlds", self.world)), "seed": self.seed}


class Instruments:
    """The opened instruments of a bench; a context manager that closes them.

    Attributes
    ----------
    table, chamber, ins
        The drivers.
    """

    def __init__(self, station: Station, clock: Clock, emulation: Emulation) -> None:
        self._station = station
        with ExitStack() as opened:
            self.table: RateTable = _open_table(station, clock, emulation)
            opened.callback(self.table.close)
            self.chamber: Chamber = _open_chamber(station, clock, emulation)
            opened.callback(self.chamber.close)
            self.ins = _open_ins(station, clock, emulation)
            opened.callback(self.ins.close)
            self._opened = opened.pop_all()

    def __enter__(self) -> Instruments:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opened.close()

    def power_unit(self, on: bool) -> None:
        """Switch the unit's supply where the bench can."""
        unit = self._station.unit
        if unit.power == "chamber_event":
            self.chamber.switch_event(unit.power_event, on)


def _open_table(station: Station, clock: Clock, emulation: Emulation) -> RateTable:
    section = station.file.rate_table
    line = SerialLine("rate table", _port(section.port, clock, emulation), clock, section.baudrate)
    table = TABLE_DIALECTS[section.dialect](line, section)
    limits = section.limits
    table.set_limits(limits.rate_dps, limits.acceleration_dps2, limits.jerk_dps3)
    return table


def _open_chamber(station: Station, clock: Clock, emulation: Emulation) -> Chamber:
    section = station.file.chamber
    line = SerialLine("chamber", _port(section.port, clock, emulation), clock, section.baudrate)
    return CHAMBER_DIALECTS[section.dialect](line, section)


def _open_ins(station: Station, clock: Clock, emulation: Emulation) -> CanIns:
    section = station.file.ins
    options: dict[str, str | int | float | bool] = dict(section.options)
    if section.interface == _EMULATOR:
        options.update(emulation.options())
    database = load_dbc(station.dbc_path)
    bus = open_bus(section.interface, section.channel, clock, section.bitrate, **options)
    try:
        return CanIns(bus, section.signals, database, clock, section.commands)
    except GyrobenchError:
        bus.shutdown()
        raise


def _port(url: str, clock: Clock, emulation: Emulation) -> str:
    if not url.startswith(f"{_EMULATOR}://") or "?" in url:
        return url
    return f"{url}?{urlencode({'clock': clock.name, **emulation.options()})}"
