"""A driver and its emulator, on a line that can be silent, late or disturbed."""

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

#: The world behind the instruments: sensors without noise.
_WORLD = "ideal"
#: Replies that are longer than this are no answer to a request of a bench.
_MAX_NOISE_BYTES = 40
_INNER = 2

ResultT = TypeVar("ResultT")


class Wire:
    """The line between a driver and an emulator."""

    def __init__(self, emulator: SerialInstrument) -> None:
        self.emulator = emulator
        self.requests: list[bytes] = []  #: What the driver has sent.
        self.is_connected = True  #: Whether requests arrive.
        self.latency_s = emulator.latency_s  #: Time until a reply begins.
        #: Changes each reply.
        self.disturb: Callable[[bytes], bytes] = lambda reply: reply

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Pass a request on, and return the reply."""
        self.requests.append(data)
        return self.disturb(self.emulator.feed(data, now_s)) if self.is_connected else b""


class UnderTest:
    """What drivers of both kinds have in common."""

    def __init__(self, port: str) -> None:
        self.clock = VirtualClock()
        self.bench = bench_at(BenchAddress(self.clock.name, _WORLD))
        self._port = port

    def connect(self, emulator: SerialInstrument) -> None:
        """Put the emulator at the port."""
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
        """Bytes that an action sends, whether or not it is refused."""
        self.wire.requests.clear()
        with suppress(InstrumentError):
            action()
        return b"".join(self.wire.requests)

    def capable(self, capability: type[ResultT]) -> ResultT:
        """The emulator, if it can do what a test needs; else the test is skipped."""
        if not isinstance(self.emulator, capability):
            pytest.skip(f"its emulator is not {capability.__name__} (gyrobench.drivers.emulators.dialect)")
        return self.emulator

    def recovered(self, action: Callable[[], ResultT], longest_s: float = 60.0) -> ResultT:
        """Result of an action that may fail for a while, as the bench repeats it."""
        end_s = self.clock.now() + longest_s
        while self.clock.now() < end_s:
            with suppress(InstrumentError):
                return action()
            self.wait(1.0)
        return action()


class ChamberUnderTest(UnderTest):
    """A chamber's driver, its emulator, and the air behind it."""

    def __init__(self, name: str, options: dict[str, Any]) -> None:
        super().__init__("chamber")
        self._dialect = load(CHAMBERS, name, ChamberDialect)
        self._options = self._dialect.options.model_validate(options)
        self.air = self.bench.world.air
        self.events: dict[int, bool] = {}  #: Event outputs by number, as the emulator has switched them.
        self.connect(load(EMULATORS, name, ChamberEmulation).make(self.air, self.events.__setitem__))

    def open(self) -> Chamber:
        """Open another line with a driver of the dialect."""
        return self._dialect.open(self.line(), self._options)


class TableUnderTest(UnderTest):
    """A table's driver, its emulator, and the axes behind it."""

    def __init__(self, name: str, options: dict[str, Any]) -> None:
        super().__init__("table")
        self._dialect = load(RATE_TABLES, name, TableDialect)
        self._options = self._dialect.options.model_validate(options)
        #: Numbers of its axes; a table with a single one has the inner axis.
        self.axes = [1, _INNER] if self._dialect.max_axes > 1 else [_INNER]
        self.connect(load(EMULATORS, name, TableEmulation).make(self.bench.world.axes))

    def open(self) -> RateTable:
        """Open another line with a driver of the dialect."""
        return self._dialect.open(self.line(), self.axes, self._options)

    def prepared(self) -> RateTable:
        """Open a driver, with limits set and the servos closed."""
        table = self.open()
        table.set_limits(30.0, 20.0, 80.0)
        table.prepare()
        return table

    def axis(self, number: int) -> TableAxis:
        """The physics of an axis."""
        return self.bench.world.axes[number]

    def true_deg(self) -> tuple[float, ...]:
        """Where the axes are."""
        return tuple(self.axis(number).encoder(self.clock.now()).position_deg for number in self.axes)

    def arrives(self, table: RateTable, longest_s: float = 120.0) -> bool:
        """Wait until the driver reports that the axes are in position."""
        for _ in range(round(longest_s)):
            if table.in_position():
                return True
            self.wait(1.0)
        return False


class Noise:
    """Disturbs replies: cut, changed, doubled, replaced; the same for the same seed."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)  # noqa: S311 - not for secrets

    def __call__(self, reply: bytes) -> bytes:
        """Disturb one reply."""
        draw = self._random
        kind = draw.randrange(6)
        if kind == 0 or not reply:
            return draw.randbytes(draw.randrange(_MAX_NOISE_BYTES))
        place = draw.randrange(len(reply))
        if kind == 1:
            return reply[:place]
        if kind == 2:
            return reply[:place] + draw.randbytes(1) + reply[place + 1 :]
        if kind == 3:
            return reply + reply
        if kind == 4:
            return draw.randbytes(1) + reply
        return reply
