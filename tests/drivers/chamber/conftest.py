import os
import select
import threading
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest

from gyrobench.bench.foundations.clock import Clock, VirtualClock, WallClock
from gyrobench.drivers.chamber.watlow_f4 import WatlowF4
from gyrobench.drivers.emulators.watlow_f4 import WatlowF4Emulator
from gyrobench.drivers.emulators.world.thermal import ChamberAir
from gyrobench.drivers.serial_line import SerialLine


class FarEnd(threading.Thread):
    """Serves the master sides of pseudo-terminals, until it is stopped."""

    def __init__(self, handlers: dict[int, Callable[[bytes], None]]) -> None:
        super().__init__(daemon=True)
        self._handlers = handlers
        self._wake = os.pipe()

    def run(self) -> None:
        while True:
            ready, _, _ = select.select([self._wake[0], *self._handlers], [], [])
            if self._wake[0] in ready:
                return
            for master in ready:
                self._handlers[master](os.read(master, 4096))

    def stop(self) -> None:
        os.write(self._wake[1], b".")
        self.join(5)
        for descriptor in self._wake:
            os.close(descriptor)


def open_terminals(count: int) -> list[tuple[int, int]]:
    terminals = [os.openpty() for _ in range(count)]
    for _, slave in terminals:
        tty.setraw(slave)
    return terminals


def close_terminals(terminals: list[tuple[int, int]]) -> None:
    for master, slave in terminals:
        os.close(master)
        os.close(slave)


@dataclass
class Bench:
    """An emulated chamber on a pseudo-terminal; ``respond`` may be replaced to misbehave."""

    url: str
    air: ChamberAir
    chamber: WatlowF4Emulator
    respond: Callable[[bytes], bytes]
    events: list[tuple[int, bool]] = field(default_factory=list)
    requests: list[bytes] = field(default_factory=list)
    drivers: list[WatlowF4] = field(default_factory=list)

    def driver(self, clock: Clock | None = None, **options: float) -> WatlowF4:
        line = SerialLine("chamber", self.url, clock or VirtualClock())
        try:
            self.drivers.append(WatlowF4(line, **{"reply_timeout_s": 120.0, **options}))
        except BaseException:
            line.close()
            raise
        return self.drivers[-1]


@pytest.fixture
def make_bench() -> Iterator[Callable[..., Bench]]:
    open_benches: list[tuple[Bench, FarEnd, list[tuple[int, int]]]] = []

    def make(**options) -> Bench:
        terminals = open_terminals(1)
        ((master, slave),) = terminals
        clock = WallClock()
        air, events = ChamberAir(), []
        chamber = WatlowF4Emulator(air, on_event=lambda number, on: events.append((number, on)), **options)
        bench = Bench(os.ttyname(slave), air, chamber, lambda data: chamber.feed(data, clock.now()), events)

        def serve(data: bytes) -> None:
            bench.requests.append(data)
            if reply := bench.respond(data):
                os.write(master, reply)

        far_end = FarEnd({master: serve})
        far_end.start()
        open_benches.append((bench, far_end, terminals))
        return bench

    yield make
    for bench, far_end, terminals in open_benches:
        for driver in bench.drivers:
            driver.close()
        far_end.stop()
        close_terminals(terminals)


@pytest.fixture
def bench(make_bench) -> Bench:
    return make_bench()


@pytest.fixture
def crossed_ports() -> Iterator[tuple[str, str]]:
    """Two serial ports, each of which receives what the other sends."""
    terminals = open_terminals(2)
    (master_a, slave_a), (master_b, slave_b) = terminals
    relay = FarEnd(
        {master_a: lambda data: os.write(master_b, data), master_b: lambda data: os.write(master_a, data)}
    )
    relay.start()
    yield os.ttyname(slave_a), os.ttyname(slave_b)
    relay.stop()
    close_terminals(terminals)
