"""Opening the instruments that a station file names, within a time limit."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from operator import methodcaller
from pathlib import Path
from typing import Any, Self, TypeVar, cast
from urllib.parse import urlencode

import can

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import (
    ConnectionFailedError,
    DocumentError,
    FaultError,
    GyrobenchError,
    InstrumentError,
    NoReplyError,
    RefusedError,
    ReplyError,
)
from gyrobench.bench.foundations.packages import CHAMBERS, RATE_TABLES, load
from gyrobench.bench.foundations.shipped import DEFAULT_WORLD, find_document, world_for
from gyrobench.bench.station.absent_instruments import AbsentInstrument, disconnected_ins
from gyrobench.bench.station.instrument_sections import DialectSection
from gyrobench.bench.station.station import Station
from gyrobench.bench.station.station_file import load_station_file
from gyrobench.bench.station.time_limit import LimitedCall, opening_time_s
from gyrobench.drivers.chamber import Chamber, ChamberDialect, ChamberReading, running_profile
from gyrobench.drivers.chamber.software_ramp import SoftwareRamp
from gyrobench.drivers.ins.can_bus import close_bus, open_bus
from gyrobench.drivers.ins.can_ins import CanIns
from gyrobench.drivers.rate_table import RateTable, TableDialect, TableReading
from gyrobench.drivers.serial_line import SerialLine

#: Names of the instruments in error messages and for :meth:`Instruments.reopen`.
RATE_TABLE, CHAMBER = "rate table", "chamber"
#: What to do where an INS sends although its supply is off.
CHECK_SUPPLY = (
    "Check the supply's wiring, whether the output is inverted, and unit.power_event of the station"
)

#: A reply to a request from before the line was opened arrives within this time.
_LATE_REPLY_S = 1.0

_close_driver = methodcaller("close")
_DriverT = TypeVar("_DriverT")
#: Functions that open the port of an instrument, and that close what comes too late.
_Opening = tuple[Callable[[], Any], Callable[[Any], None]]


@dataclass(frozen=True)
class Emulation:
    """Simulated world of emulated instruments; real instruments ignore it."""

    #: world, faults: World file and list of faults (empty: none), by path or shipped name. Paths become
    #: absolute: a run is resumed and verified from any folder.
    world: str = DEFAULT_WORLD
    seed: int = 0  #: Seed of everything random in the world.
    faults: str = ""

    def __post_init__(self) -> None:
        for name in ("world", "faults"):
            path = Path(getattr(self, name))
            if path.suffix and path.is_file():
                object.__setattr__(self, name, str(path.resolve()))

    @classmethod
    def of(cls, station: str, world: str | None = None, seed: int = 0, faults: str | None = None) -> Self:
        """Emulation for a station; without a world :func:`world_for` selects it by the station's name.

        Raises DocumentError if world or faults are given for a station without any emulated instrument: the
        caller then expects that nothing real moves.
        """
        if world or faults:
            path = find_document("stations", station)
            if not any(load_station_file(path)[1].emulated_instruments()):
                raise DocumentError(
                    f"{station}: no instrument of this station is emulated, so --world and --faults have no "
                    "effect on it. Leave them out to use its instruments, or choose an emulated --station"
                )
        return cls(world_for(station, world), seed, faults or "")

    def options(self) -> dict[str, str | int]:
        """Parameters of the world in an emulator's address."""
        faults = {"faults": str(find_document("faults", self.faults))} if self.faults else {}
        return {"world": str(find_document("worlds", self.world)), "seed": self.seed, **faults}


class Outputs:
    """Rate table and chamber, whose outputs can do harm; a context manager that closes them.

    Each is opened at its first use, independently of the other. If its port can't be opened, that use raises,
    and the next one tries again. The same holds if the instrument that answers has another identity than in
    ``identities``, by name, or in the station file. An instrument that does not answer may be the right one.
    """

    def __init__(
        self,
        station: Station,
        clock: Clock,
        emulation: Emulation | None = None,
        identities: Mapping[str, str] | None = None,
    ) -> None:
        self.clock = clock
        self._station = station
        self._emulation = emulation or Emulation()
        self._drivers: dict[str, Any] = {}  # opened so far
        self._identities = dict(identities or {})
        #: What :meth:`try_reopen` has begun, by instrument, until it returns True or raises; None where an
        #: exchange has taken the result.
        self.reopenings: dict[str, LimitedCall[Any] | None] = {}
        #: Whether :meth:`try_reopen` uses a thread: emulators inside this process share one simulated bench.
        self.reopens_in_thread = not (clock.is_virtual or any(station.file.emulated_instruments()))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def table(self) -> RateTable:
        """The rate table's driver."""
        return cast(RateTable, self._driver(RATE_TABLE))

    @property
    def chamber(self) -> Chamber:
        """The chamber's driver."""
        return cast(Chamber, self._driver(CHAMBER))

    @property
    def is_ramping(self) -> bool:
        """Whether the bench moves the chamber's set point along a ramp, as its controller has no ramps."""
        chamber = self._drivers.get(CHAMBER)
        return isinstance(chamber, SoftwareRamp) and chamber.is_ramping

    def advance_ramp(self) -> None:
        """Move the chamber's set point along such a ramp; call at every tick."""
        chamber = self._drivers.get(CHAMBER)
        if isinstance(chamber, SoftwareRamp):
            chamber.advance()

    def require_no_profile(self) -> None:
        """Raise RefusedError if the chamber runs a profile that the station file forbids to end."""
        if getattr(self._station.file.chamber, "running_profile", "refuse") == "refuse" and (
            profile := running_profile(self.chamber)
        ):
            raise RefusedError(
                CHAMBER,
                f"runs {profile} by itself. End it at its panel, or set chamber.running_profile: end in the "
                "station file. Nothing was moved.",
            )

    def power_unit(self, on: bool, excluded: Collection[int] = ()) -> None:
        """Switch the supplies of all units, if the bench can, except by event outputs ``excluded``."""
        for event in self._station.power_events:
            if event not in excluded:
                self.chamber.switch_event(event, on)

    def identify(self, instrument: str) -> str:
        """Identification of the rate table or the chamber; stored for :meth:`reopen`.

        Raises ConnectionFailedError if it differs from the expected one.
        """
        identity = self._checked_identity(instrument, self._driver(instrument))
        return self._identities.setdefault(instrument, identity)

    def reopen(self, instrument: str) -> None:
        """Close and reopen the port of one instrument, named as in errors; after a failure it stays closed.

        Raises ConnectionFailedError if it can't be opened, does not answer, or has another identity than
        before: adapters that were reconnected may have exchanged their names.
        """
        limit_s = opening_time_s(self.clock)
        begun = self.reopenings.get(instrument)
        if begun is not None:
            self.reopenings[instrument] = None
        self._use(instrument, begun or self._begin_reopening(instrument, limit_s), limit_s)

    def try_reopen(self, instrument: str) -> bool:
        """Reopen as :meth:`reopen`, in a thread: returns False until it has ended; call again until then.

        An exchange with table or chamber before that waits for the thread and takes its result. Table and
        chamber must also answer a reading. If :attr:`reopens_in_thread` is False, reopens at once.
        """
        if not self.reopens_in_thread:
            self.reopen(instrument)
            return True
        if instrument not in self.reopenings:
            # Twice the time of opening, as the instrument must also answer.
            limit_s = 2.0 * opening_time_s(self.clock)
            self.reopenings[instrument] = self._begin_reopening(instrument, limit_s, must_answer=True)
        begun = self.reopenings[instrument]
        if begun is not None and not begun.is_over:
            return False
        del self.reopenings[instrument]
        if begun is not None:
            self._use(instrument, begun)
        return True

    def _begin_reopening(
        self, instrument: str, limit_s: float, must_answer: bool = False
    ) -> LimitedCall[Any]:
        return LimitedCall(self.clock, limit_s, instrument, *self._reopening(instrument, must_answer))

    def _use(self, instrument: str, opening: LimitedCall[Any], limit_s: float | None = None) -> None:
        """Use what is opened, awaited for ``limit_s`` from now, by default for the limit of its thread."""
        try:
            opened = opening.result(limit_s)
        except ConnectionFailedError:
            raise
        except InstrumentError as error:
            raise ConnectionFailedError(instrument, f"its port is open, but {error.message}") from error
        self._replace(instrument, opened)

    def end_reopening(self, instrument: str) -> None:
        """Wait no longer for a thread of :meth:`try_reopen`: what it opens is closed."""
        if opening := self.reopenings.pop(instrument, None):
            opening.abandon()
            self._drivers.pop(instrument, None)  # closed by the thread

    def _reopening(self, instrument: str, must_answer: bool) -> _Opening:
        """Functions that open the port of an instrument again, and that close what comes too late."""
        if instrument not in (RATE_TABLE, CHAMBER):
            raise ValueError(f"no instrument is called {instrument!r}")
        previous = self._drivers.get(instrument)

        def open_again() -> RateTable | Chamber:
            if previous is not None:
                previous.close()
            driver = self._open_driver(instrument)
            try:
                if must_answer:
                    _require_answer(driver.read, self.clock)
            except InstrumentError:
                driver.close()
                raise
            return driver

        return open_again, _close_driver

    def _replace(self, instrument: str, opened: Any) -> None:
        """Use what was opened from now on."""
        previous, self._drivers[instrument] = self._drivers.get(instrument), opened
        if isinstance(previous, SoftwareRamp) and isinstance(opened, SoftwareRamp):
            opened.continue_from(previous)

    def close(self) -> None:
        """Close the ports; table and chamber keep their state."""
        for instrument in list(self.reopenings):
            self.end_reopening(instrument)
        for driver in list(self._drivers.values()):
            driver.close()

    def _driver(self, instrument: str) -> Any:
        if self.reopenings.get(instrument):
            self.reopen(instrument)
        if instrument not in self._drivers:
            self._drivers[instrument] = self._open_in_time(instrument, partial(self._open_driver, instrument))
        return self._drivers[instrument]

    def _open_driver(self, instrument: str) -> RateTable | Chamber:
        open_instrument = open_table if instrument == RATE_TABLE else open_chamber
        driver: RateTable | Chamber = open_instrument(self._station, self.clock, self._emulation)
        if instrument in self._identities or self._required_identity(instrument):
            try:
                self._checked_identity(instrument, driver)
            except (NoReplyError, ReplyError, RefusedError):
                pass  # may be the right one, and has to be stopped in any case
            except InstrumentError:
                driver.close()
                raise
        return driver

    def _required_identity(self, instrument: str) -> str:
        """Text that the identification must contain according to the station file."""
        section = self._station.file
        return (section.rate_table if instrument == RATE_TABLE else section.chamber).identity

    def _checked_identity(self, instrument: str, driver: RateTable | Chamber) -> str:
        """Identify an instrument; raises ConnectionFailedError if it is not the expected one."""
        required, expected = self._required_identity(instrument), self._identities.get(instrument)

        def problem(identity: str) -> tuple[str, str] | None:
            if required not in identity:
                return f"{identity}, which lacks {required!r}", "else correct `identity` in the station file"
            if expected in (None, identity):
                return None
            advice = "if it was replaced, resume the run with --other-instruments"
            return f"{identity} in place of {expected}", advice

        identity = driver.identify()
        if problem(identity) and (
            mismatch := problem(identity := driver.identify())
        ):  # a damaged reply does not come twice
            raise ConnectionFailedError(
                instrument,
                f"another instrument answers on its port: {mismatch[0]}. Check cables and names of adapters "
                f"(those in /dev/serial/by-id stay); {mismatch[1]}.",
            )
        return identity

    def _open_in_time(self, instrument: str, open_it: Callable[[], _DriverT]) -> _DriverT:
        limit_s = opening_time_s(self.clock)
        opening: LimitedCall[_DriverT] = LimitedCall(self.clock, limit_s, instrument, open_it, _close_driver)
        return opening.result()


class Instruments(Outputs):
    """All instruments of a bench, opened; a context manager that closes them.

    ``may_be_absent``: whether an instrument that can't be opened, or a table or chamber that does not answer,
    is left out if another one answers. It then reads nothing and refuses commands. ``dropped``: numbers of
    units that are not opened. Raises ConnectionFailedError if an instrument can't be opened or, with
    ``may_be_absent``, if none can; the others are closed again.
    """

    def __init__(
        self,
        station: Station,
        clock: Clock,
        emulation: Emulation,
        may_be_absent: bool = False,
        dropped: Collection[str] = (),
        identities: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(station, clock, emulation, identities)
        #: Instruments that are left out, with their errors.
        self.absent: dict[str, InstrumentError] = {}
        #: The INS of each unit, by its name in messages, in the order of the station file.
        self.units: dict[str, CanIns] = {}
        self._stations = {unit.instrument: unit for unit in station.units if unit.number not in dropped}
        with contextlib.ExitStack() as resources:
            resources.callback(super().close)
            nan_values = (math.nan,) * len(station.file.rate_table.axis_numbers)
            self._open(
                RATE_TABLE, may_be_absent, TableReading(nan_values, nan_values, is_servoed=False, faults=())
            )
            self._open(CHAMBER, may_be_absent, ChamberReading(math.nan, alarms=()))
            for name, unit in self._stations.items():
                try:
                    open_unit = partial(open_ins, unit, clock, emulation, station)
                    self.units[name] = self._open_in_time(name, open_unit)
                except InstrumentError as error:
                    self._leave_out(error, may_be_absent)
                    self.units[name] = disconnected_ins(unit, clock)
                resources.callback(self.units[name].close)
            if len(self.absent) == len({RATE_TABLE, CHAMBER, *self.units}):
                causes = "\n  ".join(map(str, self.absent.values()))
                raise ConnectionFailedError("bench", f"no instrument answers:\n  {causes}")
            resources.pop_all()

    @property
    def ins(self) -> CanIns:
        """The INS of the first unit."""
        return next(iter(self.units.values()))

    def _open(
        self, instrument: str, may_be_absent: bool, empty_reading: TableReading | ChamberReading
    ) -> None:
        """Open table or chamber; if it may be absent and does not answer, it reads ``empty_reading``."""
        try:
            if may_be_absent:
                _require_answer(lambda: self._driver(instrument).read(), self.clock)
            self._driver(instrument)
        except InstrumentError as error:
            self._leave_out(error, may_be_absent)
            if instrument in self._drivers:
                self._drivers[instrument].close()
            self._drivers[instrument] = AbsentInstrument(error, empty_reading)

    def _leave_out(self, error: InstrumentError, may_be: bool) -> None:
        if not may_be:
            raise error
        self.absent[error.instrument] = error

    def _reopening(self, instrument: str, must_answer: bool) -> _Opening:
        """As :meth:`Outputs._reopening`, also of an INS, which need not send."""
        ins = self.units.get(instrument)
        if ins is None:
            return super()._reopening(instrument, must_answer)

        def open_again() -> can.BusABC:
            ins.close()  # first: closing the channel later would also close the new bus
            return _open_ins_bus(self._stations[instrument], self.clock, self._emulation, self._station)

        return open_again, close_bus

    def _replace(self, instrument: str, opened: Any) -> None:
        """As :meth:`Outputs._replace`. An INS stays the same object, with the data received before."""
        ins = self.units.get(instrument)
        if ins is None:
            super()._replace(instrument, opened)
        else:
            ins.replace_bus(opened)

    def close(self) -> None:
        """Close all ports; the instruments keep their state."""
        super().close()
        for ins in self.units.values():
            ins.close()


def _require_answer(read: Callable[[], object], clock: Clock) -> None:
    """Read an instrument; raises InstrumentError if its port can't be opened, or it does not answer twice."""
    for is_last in (False, True):
        try:
            read()
        except (FaultError, RefusedError):
            return  # it answers
        except InstrumentError as error:
            if is_last or isinstance(error, ConnectionFailedError):
                raise
            clock.sleep(_LATE_REPLY_S)
        else:
            return


def open_table(station: Station, clock: Clock, emulation: Emulation) -> RateTable:
    """Open the rate table; raises InstrumentError if it can't be opened."""
    section = station.file.rate_table
    dialect = load(RATE_TABLES, section.dialect, TableDialect)
    with _open_silent_line(RATE_TABLE, section, station, clock, emulation) as line:
        return dialect.open(line, section.axis_numbers, section)


def open_chamber(station: Station, clock: Clock, emulation: Emulation) -> Chamber:
    """Open the chamber, with ramps; raises InstrumentError if it can't be opened or does not answer."""
    section = station.file.chamber
    dialect = load(CHAMBERS, section.dialect, ChamberDialect)
    with _open_silent_line(CHAMBER, section, station, clock, emulation) as line:
        driver = dialect.open(line, section)
    return driver if getattr(driver, "can_ramp", True) else cast(Chamber, SoftwareRamp(driver, clock))


def open_ins(station: Station, clock: Clock, emulation: Emulation, bench: Station | None = None) -> CanIns:
    """Open the INS on its bus; ``bench`` is the station with all units, if there are several.

    Raises ConnectionFailedError if it can't be opened. Raises DocumentError if the maps of the station file
    do not fit the DBC file, or an emulated INS does not send as they describe.
    """
    section, database = station.file.ins, station.database()
    is_shared = bench is not None and bench.shares_bus(station)
    bus = _open_ins_bus(station, clock, emulation, bench)
    try:
        return CanIns(bus, section.signals, database, clock, section.commands, station.instrument, is_shared)
    except GyrobenchError:
        close_bus(bus)
        raise


def _open_ins_bus(station: Station, clock: Clock, emulation: Emulation, bench: Station | None) -> can.BusABC:
    """Open only the bus; arguments as for :func:`open_ins`."""
    section = station.file.ins
    options: dict[str, str | int | float | bool] = dict(section.options)
    if section.is_emulated:
        options.update(_emulation_parameters(bench or station, emulation))
        options["epoch_period_s"] = section.signals.epoch_period_s
        if section.identifier_offset:
            options["identifier_offset"] = section.identifier_offset
        if bench is not None and bench.power_events and len(bench.units) > 1:
            options["power_event"] = station.file.unit.power_event
    return open_bus(
        section.interface, section.channel, clock, section.bitrate, instrument=station.instrument, **options
    )


@contextlib.contextmanager
def _open_silent_line(
    instrument: str, section: DialectSection, station: Station, clock: Clock, emulation: Emulation
) -> Iterator[SerialLine]:
    """Open a line and wait until it is silent; an error of the driver closes it."""
    defaults, url = section.installed_dialect.line, section.port
    if section.is_emulated and "?" not in url:
        url += f"?{urlencode({'clock': clock.name, **_emulation_parameters(station, emulation)})}"
    baudrate, parity = section.baudrate or defaults.baudrate, section.parity or defaults.parity
    line = SerialLine(instrument, defaults.complete_url(url), clock, baudrate, parity)
    try:
        line.await_silence(_LATE_REPLY_S, opening_time_s(clock) / 2.0)
        yield line
    except BaseException:
        line.close()
        raise


def _emulation_parameters(station: Station, emulation: Emulation) -> dict[str, str | int]:
    """Parameters of the emulated bench in an address: its world, and the dialects of table and chamber."""
    sections = {"table": station.file.rate_table, "chamber": station.file.chamber}
    dialects = {name: section.dialect for name, section in sections.items() if section.is_emulated}
    units = {"units": len(station.units)} if len(station.units) > 1 else {}
    return {**emulation.options(), **dialects, **units}
