"""Lines to emulated instruments on virtual time."""

from functools import cache

import pytest

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at
from gyrobench.drivers.serial_line import SerialLine


class Scripted:
    """Answers each write with the next of the given replies, then with nothing; remembers what came."""

    latency_s = 0.01

    def __init__(self, *replies):
        self.replies = list(replies)
        self.received = []

    def feed(self, data, now_s):
        self.received.append(data)
        return self.replies.pop(0) if self.replies else b""


class Heard:
    """An instrument, and every request that it got."""

    def __init__(self, instrument):
        self.instrument = instrument
        self.requests = []

    @property
    def latency_s(self):
        return self.instrument.latency_s

    def feed(self, data, now_s):
        self.requests.append(data)
        return self.instrument.feed(data, now_s)


class ChamberBench:
    """An emulated chamber at its port, with the events that it switched and the requests that it got.

    A driver's tests name the emulator and the driver.
    """

    emulator: type
    driver_of: type

    def __init__(self, rig, **options):
        self.rig, self.air, self.events = rig, rig.air, []
        self.chamber = self.emulator(rig.air, lambda number, on: self.events.append((number, on)), **options)
        self._line, self.heard = rig.line("chamber", self.chamber)

    def driver(self, **options):
        return self.driver_of(self._line, **options)

    def requests_of(self, action):
        self.heard.requests.clear()
        action()
        return self.heard.requests


class Rig:
    """An emulated bench whose table or chamber may be replaced, with lines to it."""

    def __init__(self):
        self.clock = VirtualClock()
        self.bench = bench_at(BenchAddress(self.clock.name, "ideal"))
        self.air, self.axis = self.bench.world.air, self.bench.world.axes[2]

    def line(self, name, instrument):
        """Line to an instrument at the port of that name, and what is heard there."""
        heard = self.bench.serial[name] = Heard(instrument)
        url = f"emulator://{name}?clock={self.clock.name}&world=ideal"
        return SerialLine({"table": "rate table"}.get(name, name), url, self.clock), heard

    def wait(self, duration_s):
        self.clock.sleep(duration_s)
        self.bench.advance()


@cache
def any_rig():
    """One rig for many examples of a test, each with a separate instrument."""
    return Rig()


@pytest.fixture
def rig():
    return Rig()
