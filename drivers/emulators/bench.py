"""The emulated bench: one world and its three instruments, shared by all clients.

An address selects it: ``emulator://table?clock=NAME&world=FILE&seed=N&faults=FILE`` (pyserial), or
the same keys as options of python-can's ``interface="emulator"``. Equal clock, world, seed and list of
faults select the same bench. Without a clock the bench runs on wall time, without a world it is
``gyro_a``, without a list of faults nothing fails.

The keys ``table`` and ``chamber`` select their dialects, ``units`` is the number of inertial units on the
table; the first address of a bench decides, and later ones may omit them.
"""

from __future__ import annotations

import functools
import logging
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from inspect import Parameter, signature
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import parse_qsl, urlsplit

from pydantic import TypeAdapter, ValidationError

from gyrobench.bench.foundations.clock import Clock, VirtualClock, WallClock, clock_named
from gyrobench.bench.foundations.documents import in_plain_words
from gyrobench.bench.foundations.errors import DocumentError, GyrobenchError
from gyrobench.bench.foundations.kernels import Kernel
from gyrobench.bench.foundations.packages import EMULATORS, load
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.drivers.emulators.can_ins import CanChannel, CanInsEmulator, EmulatedUnit
from gyrobench.drivers.emulators.dialect import ChamberEmulation, Connection, SerialInstrument, TableEmulation
from gyrobench.drivers.emulators.world.world import OUTER, World
from gyrobench.drivers.emulators.world.world_file import load_world

if TYPE_CHECKING:
    from gyrobench.drivers.emulators.faults.fault import BenchParts, FaultySerial
    from gyrobench.drivers.emulators.faults.injector import Injection, Injector

_LOG = logging.getLogger("gyrobench")
_DEFAULT_WORLD = "gyro_a"
_DEFAULT_TABLE, _DEFAULT_CHAMBER = "acutrol3000", "watlow_f4"


@dataclass(frozen=True)
class BenchAddress:
    """Selection of an emulated bench, and the dialects of its table and chamber."""

    clock: str = ""
    world: str = _DEFAULT_WORLD
    seed: int = 0
    faults: str = ""
    table: str = ""
    chamber: str = ""
    units: int = 1  #: Minimum number of units; a world may have more.


ADDRESS_KEYS = tuple(field.name for field in fields(BenchAddress))


class EmulatedBench:
    """One simulated world behind the emulators of its instruments.

    It starts at the clock's present time, everything switched off and at room temperature, with ``units`` or
    as many as the world has. ``faults`` are injected, and logged in ``faults_log`` in place of the list's own
    ``log``; ``table`` and ``chamber`` are the dialects of these two; ``chamber_options`` are keyword
    arguments of the chamber's emulator. Raises DocumentError if the world file, the list of faults or an
    option is wrong, the seed is negative, or no emulator of a dialect is installed.
    """

    def __init__(
        self,
        clock: Clock,
        world: Path,
        seed: int,
        faults: Path | None = None,
        faults_log: Path | None = None,
        table: str = _DEFAULT_TABLE,
        chamber: str = _DEFAULT_CHAMBER,
        chamber_options: Mapping[str, str] | None = None,
        units: int = 1,
    ) -> None:
        if seed < 0:
            raise DocumentError(f"emulated bench: the seed must not be negative; found {seed}")
        self.clock = clock
        self._injector: Injector | None = None
        self._seed, self._start_s = seed, math.floor(clock.now())
        self._file = load_world(world)
        #: The units in order of their numbers, from 1; ``world``, ``ins`` and ``bus`` are those of the first.
        self.units: list[EmulatedUnit] = []
        self.world = World(self._file, seed, self._start_s)
        self.dialects = {"table": table, "chamber": chamber}
        #: table, chamber, ins: The emulated instruments.
        self.table = load(EMULATORS, table, TableEmulation).make(self.world.axes)
        self.chamber = self._chamber(chamber, chamber_options or {})
        #: serial, bus: ``table`` and ``chamber`` at their ports, and the INS at the bus, with faults.
        self.serial: dict[str, SerialInstrument] = {"table": self.table, "chamber": self.chamber}
        #: The plugs of ``table`` and ``chamber``, and of each unit's bus: ``ins``, ``ins-2`` and so on.
        self.connections = {"table": Connection(), "chamber": Connection()}
        #: CAN buses with clients, by channel: they connect the units.
        self.channels: dict[str, CanChannel] = {}
        self.injected: list[Injection] = []  #: The faults injected so far.
        self._lines: dict[str, FaultySerial] = {}
        self._parts: list[BenchParts] = []
        if faults is not None:  # without, a run starts faster without their models
            from gyrobench.drivers.emulators.faults.fault import FaultySerial

            self._lines = {name: FaultySerial(instrument) for name, instrument in self.serial.items()}
            self.serial = dict(self._lines)
            self.connections = {name: line.connection for name, line in self._lines.items()}
        self.has_units(max(units, 1 + len(self._file.units)))
        self.ins, self.bus = self.units[0].ins, self.units[0].bus
        if faults is not None:
            self._inject(faults, faults_log)
        self.advance()

    def has_units(self, count: int) -> None:
        """Put further units on the table until there are that many."""
        for number in range(len(self.units) + 1, count + 1):
            world = self.world
            if number > 1:
                file = self._file.of_unit(number)
                world = World(file, self._seed, self._start_s, self.world.surroundings, number)
            ins = CanInsEmulator(world, self.clock.epoch.timestamp())
            unit = EmulatedUnit(world, ins, ins, Connection(), self._file.power_event(number))
            if self._lines:
                from gyrobench.drivers.emulators.faults.fault import BenchParts, FaultyCan

                unit.bus = bus = FaultyCan(ins)
                unit.connection = bus.connection
                self._parts.append(
                    BenchParts(world, self.table, self.chamber, ins, self._lines, bus, self.dialects)
                )
            self.connections[channel_name(number)] = unit.connection
            self.units.append(unit)

    def _inject(self, path: Path, log: Path | None) -> None:
        from gyrobench.drivers.emulators.faults.injector import (
            InjectionLog,
            Injector,
            check_faults,
            load_faults,
        )

        listed = load_faults(path)
        check_faults(path, listed, self._parts)
        self.injected = injected = InjectionLog(log or (path.parent / listed.log if listed.log else None))
        self._injector = Injector(listed.faults, self._parts, self._seed, self._start_s, injected)

    def advance(self, units: Sequence[EmulatedUnit] | None = None) -> None:
        """Advance the world to the present: some units, if there are no faults, or all."""
        now_s = self.clock.now()
        if self._injector is not None:
            self._injector.advance(now_s)
            return
        for unit in self.units if units is None else units:
            unit.world.advance(now_s)

    def advance_instruments(self) -> None:
        """Advance what table and chamber depend on: the air alone, if there are no faults."""
        if self._injector is not None:
            self.advance()
        else:
            self.world.advance_air(self.clock.now())

    @property
    def keeps_frames(self) -> bool:
        """Whether it makes no difference when the frames of the INS are received: no real time, no faults."""
        return self.clock.is_virtual and self._injector is None

    def _chamber(self, dialect: str, options: Mapping[str, str]) -> SerialInstrument:
        make = load(EMULATORS, dialect, ChamberEmulation).make
        parameters = signature(make, eval_str=True).parameters
        known = [name for name, each in parameters.items() if each.kind is Parameter.KEYWORD_ONLY]
        given = {}
        for key, text in options.items():
            try:
                given[key] = TypeAdapter(parameters[key].annotation).validate_python(text)
            except (KeyError, ValidationError) as error:
                why = f"no such option; there are {', '.join(known)}"
                if isinstance(error, ValidationError):
                    why = in_plain_words(error.errors()[0]["msg"])
                raise DocumentError(f"emulated chamber {dialect}: {key}={text}: {why}") from error
        return make(self.world.air, self.chamber_event, **given)

    def chamber_event(self, number: int, on: bool) -> None:
        """Switch the units that this event output of the chamber powers."""
        units = [unit for unit in self.units if unit.power_event == number]
        if units and self._injector is None:
            self.advance()
        for unit in units:
            unit.world.power_unit(on)


def channel_name(number: int) -> str:
    """CAN channel of the unit of that number: ``ins``, ``ins-2`` and so on."""
    return "ins" if number == 1 else f"ins-{number}"


@functools.cache
def compile_world() -> None:
    """Compile everything that simulated benches compute, or load it from numba's cache, once per process.

    A temporary bench aligns, navigates, compensates and turns. Where the first function was not in the cache,
    the start and the duration are logged.
    """
    started_s, compilations = time.perf_counter(), Kernel.compilations()
    bench = EmulatedBench(VirtualClock(), find_document("worlds", _DEFAULT_WORLD), 0)
    is_first_time = Kernel.compilations() > compilations
    if is_first_time:
        _LOG.warning("Compiling the simulated bench, once after installation; this takes some 10 s.")
    unit = bench.world.unit
    bench.world.power_unit(True)
    for duration_s, act in (
        (20.0, unit.align),
        (60.0, unit.navigate),
        (5.0, unit.apply_compensation),
        (5.0, lambda: bench.world.axes[OUTER].move_to(10.0, bench.clock.now())),
        (10.0, unit.standby),
    ):
        bench.clock.sleep(duration_s)
        bench.advance()
        act()
    if is_first_time:
        _LOG.warning(f"Compiled the simulated bench in {time.perf_counter() - started_s:.1f} s.")


_wall_clocks: dict[str, WallClock] = {}


def bench_at(address: BenchAddress) -> EmulatedBench:
    """Find the bench of that address, or create it.

    Raises DocumentError if the world file or the list of faults is wrong or missing, the seed is negative, no
    clock has that name. Raises GyrobenchError if the bench has other dialects.
    """
    clock: Clock
    try:
        clock = clock_named(address.clock) if address.clock else _wall_clocks.setdefault("", WallClock())
    except KeyError:
        raise DocumentError(f"emulator address: no clock is named {address.clock!r}") from None
    world = find_document("worlds", address.world).resolve()
    faults = find_document("faults", address.faults).resolve() if address.faults else None
    key = (world, address.seed, faults)
    bench = clock.companions.get(key)
    if not isinstance(bench, EmulatedBench):
        compile_world()
        bench = clock.companions[key] = EmulatedBench(
            clock,
            world,
            address.seed,
            faults,
            table=address.table or _DEFAULT_TABLE,
            chamber=address.chamber or _DEFAULT_CHAMBER,
            units=address.units,
        )
    bench.has_units(address.units)
    for name, dialect in (("table", address.table), ("chamber", address.chamber)):
        if dialect and dialect != bench.dialects[name]:
            raise GyrobenchError(
                f"emulator address: the {name} of this bench is a {bench.dialects[name]}, not a {dialect}"
            )
    return bench


def parse_address(url: str) -> tuple[str, BenchAddress]:
    """Instrument name and bench of ``emulator://instrument?clock=..&world=..`` and so on.

    Raises DocumentError if the address has an unknown key, a seed that is not an integer, or is not a URL.
    """
    try:
        parts = urlsplit(url)
    except ValueError as error:
        raise DocumentError(f"{url}: not a valid address: {error}") from error
    values = dict(parse_qsl(parts.query, keep_blank_values=True))
    unknown = values.keys() - ADDRESS_KEYS
    if unknown:
        found = ", ".join(map(repr, sorted(unknown)))
        raise DocumentError(f"{url}: unknown option {found}; allowed: {', '.join(ADDRESS_KEYS)}")
    numbers = {key: values.get(key, default) for key, default in (("seed", "0"), ("units", "1"))}
    for key, text in numbers.items():
        if not text.isdecimal():
            raise DocumentError(f"{url}: {key} must be a non-negative integer; found {text!r}")
    given = {**values, **{key: int(text) for key, text in numbers.items()}}
    return parts.netloc, BenchAddress(**given)  # type: ignore[arg-type]
