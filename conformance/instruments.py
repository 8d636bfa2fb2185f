"""A driver and its emulator on a line that can be silent, late or disturbed."""

from __future__ import annotations

import random
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

import pytest

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import InstrumentError
from gyrobench.bench.foundations.packages import CHAMBERS, EMULATORS, RATE_TABLES, load
from gyrobench.drivers.chamber import Chamber, ChamberDialect
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at
from gyrobench.drivers.emulators.dialect import ChamberEmulation, SerialInstrument, TableEmulation
from gyrobench.drivers.emulators.world.table_axis import TableAxis
from gyrobench.drivers.rate_table import RateTable, TableDialect
from gyrobench.drivers.serial_line import SerialLine

#: World of the tests: sensors without noise.
_WORLD = "ideal"
#: Longest random reply of :class:`Noise`.
_MAX_NOISE_BYTES = 40
_INNER = 2

ResultT = TypeVar("ResultT")


class Wire:
    """The line between a driver and an emulator."""

    def __init__(self, emulator: SerialInstrument) -> None:
        self.emulator = emulator
        self.requests: list[bytes] = []  #: The requests that the driver has sent.
        self.is_connected = True  #: Whether requests reach the emulator.
        self.latency_s = emulator.latency_s  #: Time until a reply begins.
        #: Applied to each reply.
        self.disturb: Callable[[bytes], bytes] = lambda reply: reply

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Pass a request to the emulator; returns the disturbed reply."""
        self.requests.append(data)
        return self.disturb(self.emulator.feed(data, now_s)) if self.is_connected else b""


class UnderTest:
    """Common base of a chamber and a table under test."""

    def __init__(self, port: str) -> None:
        self.clock = VirtualClock()
        self.bench = bench_at(BenchAddress(self.clock.name, _WORLD))
        self._port = port

    def connect(self, emulator: SerialInstrument) -> None:
        """Connect the emulator to the port."""
        self.emulator = emulator
        self.wire = Wire(emulator)
        self.bench.serial[self._port] = self.wire

    def line(self) -> SerialLine:
        """Open a line to the emulator."""
        url = f"emulator://{self._port}?clock={self.clock.name}&world={_WORLD}"
        return SerialLine(self._port, url, self.clock)

    def wait(self, duration_s: float) -> None:
        """Let time pass."""
        self.clock.sleep(duration_s)
        self.bench.advance()

    def sent_by(self, action: Callable[[], object]) -> bytes:
        """Return the bytes that an action sends, even if it is refused."""
        self.wire.requests.clear()
        with suppress(InstrumentError):
            action()
        return b"".join(self.wire.requests)

    def require_capability(self, capability: type[ResultT]) -> ResultT:
        """Return the emulator if it has the capability that a test needs; otherwise skip the test."""
        if not isinstance(self.emulator, capability):
            pytest.skip(f"its emulator is not {capability.__name__} (gyrobench.drivers.emulators.dialect)")
        return self.emulator

    def retry(self, action: Callable[[], ResultT], max_s: float = 60.0) -> ResultT:
        """Repeat an action until it succeeds, for at most ``max_s``, as the bench does."""
        end_s = self.clock.now() + max_s
        while self.clock.now() < end_s:
            with suppress(InstrumentError):
                return action()
            self.wait(1.0)
        return action()


class ChamberUnderTest(UnderTest):
    """A chamber: its driver, its emulator, and the simulated air."""

    def __init__(self, name: str, options: dict[str, Any]) -> None:
        super().__init__("chamber")
        self._dialect = load(CHAMBERS, name, ChamberDialect)
        self._options = self._dialect.options.model_validate(options)
        self.air = self.bench.world.air
        self.events: dict[
            int, bool
        ] = {}  #: State of the event outputs that the emulator has switched, by number.
        self.connect(load(EMULATORS, name, ChamberEmulation).make(self.air, self.events.__setitem__))

    def open(self) -> Chamber:
        """Open a new line with a driver of the dialect."""
        return self._dialect.open(self.line(), self._options)


class TableUnderTest(UnderTest):
    """A table: its driver, its emulator, and the simulated axes."""

    def __init__(self, name: str, options: dict[str, Any]) -> None:
        super().__init__("table")
        self._dialect = load(RATE_TABLES, name, TableDialect)
        self._options = self._dialect.options.model_validate(options)
        #: Numbers of the axes; a table with a single axis has the inner one.
        self.axes = [1, _INNER] if self._dialect.max_axes > 1 else [_INNER]
        self.connect(load(EMULATORS, name, TableEmulation).make(self.bench.world.axes))

    def open(self) -> RateTable:
        """Open a new line with a driver of the dialect."""
        return self._dialect.open(self.line(), self.axes, self._options)

    def open_prepared(self) -> RateTable:
        """Open a driver, set limits, and close the servos."""
        table = self.open()
        table.set_limits(30.0, 20.0, 80.0)
        table.prepare()
        return table

    def axis(self, number: int) -> TableAxis:
        """Return the physics of an axis."""
        return self.bench.world.axes[number]

    def true_deg(self) -> tuple[float, ...]:
        """True angles of the axes."""
        return tuple(self.axis(number).encoder(self.clock.now()).position_deg for number in self.axes)

    def wait_until_in_position(self, table: RateTable, max_s: float = 120.0) -> bool:
        """Wait until the driver reports that the axes are in position; False after ``max_s``."""
        for _ in range(round(max_s)):
            if table.in_position():
                return True
            self.wait(1.0)
        return False


class Noise:
    """Disturbs replies at random: truncates, changes, repeats or replaces them; reproducible by the seed."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)  # noqa: S311 - not for secrets

    def __call__(self, reply: bytes) -> bytes:
        """Disturb one reply."""
        random_source = self._random
        kind = random_source.randrange(6)
        if kind == 0 or not reply:
            return random_source.randbytes(random_source.randrange(_MAX_NOISE_BYTES))
        index = random_source.randrange(len(reply))
        if kind == 1:
            return reply[:index]
        if kind == 2:
            return reply[:index] + random_source.randbytes(1) + reply[index + 1 :]
        if kind == 3:
            return reply + reply
        if kind == 4:
            return random_source.randbytes(1) + reply
        return reply
