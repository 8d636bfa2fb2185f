"""The emulated bench: one world and its three instruments, shared by all who open them.

An address says which: ``emulator://table?clock=NAME&world=FILE&seed=N`` (pyserial), or the same
keys as options of python-can's ``interface="emulator"``. Equal clock, world and seed mean the same
bench. Without a clock the bench runs on wall time, without a world it is ``gyro_a``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from urllib.parse import parse_qsl, urlsplit
from weakref import WeakKeyDictionary

from bench.clock import Clock, WallClock, clock_named
from bench.documents import find_document
from bench.errors import DocumentError
from drivers.emulators.acutrol3000 import Acutrol3000Emulator
from drivers.emulators.can_ins import CanInsEmulator
from drivers.emulators.serial_instrument import SerialInstrument
from drivers.emulators.watlow_f4 import WatlowF4Emulator
from drivers.emulators.world.document import load_world
from drivers.emulators.world.world import World

#: The chamber controller's event output that feeds the unit's power supply.
UNIT_POWER_EVENT = 2

_DEFAULT_WORLD = "gyro_a"


@dataclass(frozen=True)
class BenchAddress:
    """Which emulated bench is meant."""

    clock: str = ""
    world: str = _DEFAULT_WORLD
    seed: int = 0


class EmulatedBench:
    """One simulated world behind the emulators of its instruments.

    Attributes
    ----------
    serial : dict of str to SerialInstrument
        ``table`` and ``chamber``.
    ins : CanInsEmulator
        The INS at its CAN connector.

    Raises
    ------
    DocumentError
        The world file is wrong, or the seed is below zero.
    """

    def __init__(self, clock: Clock, world: Path, seed: int) -> None:
        if seed < 0:
            raise DocumentError(f"emulated bench: the seed must not be below zero; found {seed}")
        self.clock = clock
        self.world = World(load_world(world), seed)
        self.ins = CanInsEmulator(self.world, clock.epoch.timestamp())
        chamber = WatlowF4Emulator(self.world.air, on_event=self._chamber_event)
        self.serial: dict[str, SerialInstrument] = {
            "table": Acutrol3000Emulator(self.world.axes),
            "chamber": chamber,
        }
        self.world.advance(clock.now())

    def advance(self) -> None:
        """Bring the world to the present."""
        self.world.advance(self.clock.now())

    def _chamber_event(self, number: int, on: bool) -> None:
        if number == UNIT_POWER_EVENT:
            self.world.power_unit(on)


_benches: WeakKeyDictionary[Clock, dict[tuple[Path, int], EmulatedBench]] = WeakKeyDictionary()
_wall_clocks: dict[str, WallClock] = {}


def emulated_bench(address: BenchAddress) -> EmulatedBench:
    """Find the bench of that address; the first who asks makes it.

    Raises
    ------
    DocumentError
        The world file is wrong or absent, the seed is below zero, or no clock of that name exists.
    """
    clock: Clock
    try:
        clock = clock_named(address.clock) if address.clock else _wall_clocks.setdefault("", WallClock())
    except KeyError:
        raise DocumentError(f"emulator address: no clock is named {address.clock!r}") from None
    world = find_document("worlds", address.world).resolve()
    benches = _benches.setdefault(clock, {})
    key = (world, address.seed)
    if key not in benches:
        benches[key] = EmulatedBench(clock, world, address.seed)
    return benches[key]


def parse_address(url: str) -> tuple[str, BenchAddress]:
    """Instrument name and bench of ``emulator://instrument?clock=..&world=..&seed=..``.

    Raises
    ------
    DocumentError
        The address has another key, a seed that is no whole number, or is no URL.
    """
    try:
        parts = urlsplit(url)
    except ValueError as error:
        raise DocumentError(f"{url}: is no address: {error}") from error
    values = dict(parse_qsl(parts.query, keep_blank_values=True))
    unknown = values.keys() - {"clock", "world", "seed"}
    if unknown:
        raise DocumentError(f"{url}: unknown {sorted(unknown)}; allowed: clock, world, seed")
    seed = values.get("seed", "0")
    if not seed.isdecimal():
        raise DocumentError(f"{url}: seed must be a whole number; found {seed!r}")
    return parts.netloc, BenchAddress(values.get("clock", ""), values.get("world", _DEFAULT_WORLD), int(seed))
