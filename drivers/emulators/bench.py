"""The emulated bench: a simulated world with its three instruments, shared by all clients.

An address selects the bench: ``emulator://table?clock=NAME&world=FILE&seed=N&faults=FILE`` (pyserial), or
the same keys as options of python-can's ``interface="emulator"``. The same clock, world, seed and list of
faults select the same bench. By default the bench runs on wall time, its world is ``gyro_a``, and there are
no faults.

The keys ``table`` and ``chamber`` select their dialects, and ``units`` is the number of inertial units on the
table. The first address of a bench sets them; later addresses may omit them.
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

from gyrobench.bench.foundations.clock import Clock, VirtualClock, WallClock, find_clock
from gyrobench.bench.foundations.documents import plain_message
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
    """Keys of the address of an emulated bench; see the documentation of this module."""

    clock: str = ""
    world: str = _DEFAULT_WORLD
    seed: int = 0
    faults: str = ""
    table: str = ""
    chamber: str = ""
    units: int = 1  #: Minimum number of units; the world may have more.


ADDRESS_KEYS = tuple(field.name for field in fields(BenchAddress))


class EmulatedBench:
    """One simulated world behind the emulators of its instruments.

    It starts at the clock's present time, with everything switched off and at room temperature, and at least
    ``units`` inertial units. ``faults`` is the list of faults to inject; they are logged in ``faults_log``,
    by default in the file that the list names. ``table`` and ``chamber`` are dialects; ``chamber_options``
    are keyword arguments of the chamber's emulator. Raises DocumentError if the world file, the list of
    faults or an option is wrong, the seed is negative, or no emulator of a dialect is installed.
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
        #: The units in the order of their numbers, from 1; ``world``, ``ins`` and ``bus`` are of the first.
        self.units: list[EmulatedUnit] = []
        self.world = World(self._file, seed, self._start_s)
        self.dialects = {"table": table, "chamber": chamber}
        #: table, chamber, ins: The emulated instruments.
        self.table = load(EMULATORS, table, TableEmulation).make(self.world.axes)
        self.chamber = self._chamber(chamber, chamber_options or {})
        #: serial, bus: The instruments as clients reach them, with faults: ``table`` and ``chamber`` at their
        #: ports, and the INS at its bus.
        self.serial: dict[str, SerialInstrument] = {"table": self.table, "chamber": self.chamber}
        #: The plugs of ``table`` and ``chamber``, and of each unit's bus: ``ins``, ``ins-2`` and so on.
        self.connections = {"table": Connection(), "chamber": Connection()}
        #: CAN buses with clients, by channel; each connects one or more units.
        self.channels: dict[str, CanChannel] = {}
        self.injected: list[Injection] = []  #: The faults injected so far.
        self._lines: dict[str, FaultySerial] = {}
        self._parts: list[BenchParts] = []
        if faults is not None:  # imported only if needed: a run without faults starts faster
            from gyrobench.drivers.emulators.faults.fault import FaultySerial

            self._lines = {name: FaultySerial(instrument) for name, instrument in self.serial.items()}
            self.serial = dict(self._lines)
            self.connections = {name: line.connection for name, line in self._lines.items()}
        self.ensure_units(max(units, 1 + len(self._file.units)))
        self.ins, self.bus = self.units[0].ins, self.units[0].bus
        if faults is not None:
            self._inject(faults, faults_log)
        self.advance()

    def ensure_units(self, count: int) -> None:
        """Add units to the table until there are at least ``count``."""
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

        fault_list = load_faults(path)
        check_faults(path, fault_list, self._parts)
        default_log = path.parent / fault_list.log if fault_list.log else None
        self.injected = injected = InjectionLog(log or default_log)
        self._injector = Injector(fault_list.faults, self._parts, self._seed, self._start_s, injected)

    def advance(self, units: Sequence[EmulatedUnit] | None = None) -> None:
        """Advance the world to the present; only some ``units`` if they are given and there are no faults."""
        now_s = self.clock.now()
        if self._injector is not None:
            self._injector.advance(now_s)
            return
        for unit in self.units if units is None else units:
            unit.world.advance(now_s)

    def advance_instruments(self) -> None:
        """Advance what table and chamber depend on: without faults, only the air of the chamber."""
        if self._injector is not None:
            self.advance()
        else:
            self.world.advance_air(self.clock.now())

    @property
    def keeps_frames(self) -> bool:
        """Whether clients may receive the frames of the INS at any later time: virtual time, no faults."""
        return self.clock.is_virtual and self._injector is None

    def _chamber(self, dialect: str, options: Mapping[str, str]) -> SerialInstrument:
        make = load(EMULATORS, dialect, ChamberEmulation).make
        parameters = signature(make, eval_str=True).parameters
        allowed = [name for name, each in parameters.items() if each.kind is Parameter.KEYWORD_ONLY]
        arguments = {}
        for key, text in options.items():
            try:
                arguments[key] = TypeAdapter(parameters[key].annotation).validate_python(text)
            except (KeyError, ValidationError) as error:
                reason = f"no such option; there are {', '.join(allowed)}"
                if isinstance(error, ValidationError):
                    reason = plain_message(error.errors()[0]["msg"])
                raise DocumentError(f"emulated chamber {dialect}: {key}={text}: {reason}") from error
        return make(self.world.air, self.chamber_event, **arguments)

    def chamber_event(self, number: int, on: bool) -> None:
        """Switch the supply of the units that this event output of the chamber powers."""
        units = [unit for unit in self.units if unit.power_event == number]
        if units and self._injector is None:
            self.advance()
        for unit in units:
            unit.world.power_unit(on)


def channel_name(number: int) -> str:
    """CAN channel of a unit by its number: ``ins``, ``ins-2`` and so on."""
    return "ins" if number == 1 else f"ins-{number}"


@functools.cache
def compile_world() -> None:
    """Compile all kernels of simulated benches, or load them from numba's cache, once per process.

    Runs a temporary bench that aligns, navigates, compensates and turns. If the first kernel is not in the
    cache, logs the start and the duration.
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
    """Return the bench of an address; creates it at the first call.

    Raises DocumentError if the world file or the list of faults is wrong or missing, the seed is negative, or
    there is no clock of that name. Raises GyrobenchError if the bench exists with other dialects.
    """
    clock: Clock
    try:
        clock = find_clock(address.clock) if address.clock else _wall_clocks.setdefault("", WallClock())
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
    bench.ensure_units(address.units)
    for name, dialect in (("table", address.table), ("chamber", address.chamber)):
        if dialect and dialect != bench.dialects[name]:
            raise GyrobenchError(
                f"emulator address: the {name} of this bench is a {bench.dialects[name]}, not a {dialect}"
            )
    return bench


def parse_address(url: str) -> tuple[str, BenchAddress]:
    """Parse ``emulator://instrument?clock=..&world=..`` to the instrument's name and the bench's address.

    Raises DocumentError if the address is not a URL, or has an unknown key or a value that is not valid.
    """
    try:
        parts = urlsplit(url)
    except ValueError as error:
        raise DocumentError(f"{url}: not a valid address: {error}") from error
    values = dict(parse_qsl(parts.query, keep_blank_values=True))
    unknown = values.keys() - ADDRESS_KEYS
    if unknown:
        keys = ", ".join(map(repr, sorted(unknown)))
        raise DocumentError(f"{url}: unknown option {keys}; allowed: {', '.join(ADDRESS_KEYS)}")
    numbers = {key: values.get(key, default) for key, default in (("seed", "0"), ("units", "1"))}
    for key, text in numbers.items():
        if not text.isdecimal():
            raise DocumentError(f"{url}: {key} must be a non-negative integer; found {text!r}")
    fields_of_address = {**values, **{key: int(text) for key, text in numbers.items()}}
    return parts.netloc, BenchAddress(**fields_of_address)  # type: ignore[arg-type]
