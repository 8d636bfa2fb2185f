"""Lines to emulated instruments on virtual time."""

from functools import cache

import pytest

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.drivers.chamber.thermotron_8800 import Thermotron8800
from gyrobench.drivers.chamber.watlow_f4t import WatlowF4T
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at
from gyrobench.drivers.emulators.thermotron_8800 import Thermotron8800Emulator
from gyrobench.drivers.emulators.watlow_f4t import WatlowF4TEmulator
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


class Echoing:
    """An instrument behind an adapter that echoes what is sent."""

    def __init__(self, instrument):
        self.instrument, self.latency_s = instrument, instrument.latency_s

    def feed(self, data, now_s):
        return data + self.instrument.feed(data, now_s)


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
    """An emulated chamber at its port, with the events that it switched and the requests that it got."""

    emulator: type
    driver_of: type
    opened: tuple[bytes, ...]  #: Replies to what the driver sends when it is opened.
    profile: str  #: Pattern of the description of a profile in progress.

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


class ThermotronBench(ChamberBench):
    emulator, driver_of, opened = Thermotron8800Emulator, Thermotron8800, (b"0\r",)
    profile = "program .MODE. 1."


class WatlowBench(ChamberBench):
    emulator, driver_of, opened = WatlowF4TEmulator, WatlowF4T, (b"F4T\n", b"", b"C\n", b"IDLE\n")
    profile = "profile .its state is RUNNING."


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
