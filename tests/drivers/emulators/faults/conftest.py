from urllib.parse import urlencode

import can
import pytest
import serial

import gyrobench.drivers.serial_line  # noqa: F401  registers emulator:// with pyserial
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.drivers.emulators.bench import BenchAddress, bench_at


class Rig:
    """An emulated bench with a list of faults, and ports to it."""

    def __init__(self, path, world="quick", seed=0, start_s=0.0):
        self.clock = VirtualClock()
        self.clock.sleep_until(start_s)
        self._address = BenchAddress(self.clock.name, world, seed, str(path))
        self.bench = bench_at(self._address)
        self.world = self.bench.world

    def port(self, name):
        options = {
            "clock": self.clock.name,
            "world": self._address.world,
            "seed": self._address.seed,
            "faults": self._address.faults,
        }
        return serial.serial_for_url(f"emulator://{name}?{urlencode(options)}", timeout=1.0)

    def bus(self):
        return can.Bus(
            interface="emulator", channel="ins", clock=self.clock.name, world=self._address.world,
            seed=self._address.seed, faults=self._address.faults, ignore_config=True,
        )  # fmt: skip

    def until(self, time_s):
        self.clock.sleep_until(time_s)
        self.bench.advance()

    @property
    def kinds(self):
        return [kind for _, kind in self.bench.injected]


@pytest.fixture
def rig(tmp_path):
    """Make a rig from entries such as ``{"fault": "lost_reply", "target": "table", "at_s": 1}``."""

    def make(*entries, **options):
        path = tmp_path / "faults.yaml"
        lines = ", ".join(
            "{" + ", ".join(f"{key}: {_yaml(value)}" for key, value in entry.items()) + "}"
            for entry in entries
        )
        path.write_text(f"faults: [{lines}]\n")
        return Rig(path, **options)

    return make


def _yaml(value):
    return str(value).lower() if isinstance(value, bool) else value
