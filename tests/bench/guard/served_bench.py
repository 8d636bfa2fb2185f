"""Emulators as a separate process, a station file for them, and a small engine."""

import contextlib
import struct
import time
from pathlib import Path

import serial

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.guard.process import guard_for
from gyrobench.bench.station.bench_lock import BenchLock
from gyrobench.bench.station.instruments import Outputs
from gyrobench.bench.station.station import Station
from tests.drivers.emulators.forked import ForkedProcess, served
from tests.drivers.emulators.quick_world import LIMIT_S, QUICK_WORLD


def hold_bench(station_file, folder):
    """Open the bench, set the table turning and the chamber heating, and beat until the process ends."""
    station, clock = Station(station_file), WallClock()
    with (
        BenchLock(station, folder, clock),
        guard_for(station, folder, clock) as guard,
        Outputs(station, clock) as outputs,
    ):
        outputs.table.prepare()
        outputs.table.turn_at(2, 10.0)
        outputs.chamber.set_temperature(60.0, None)
        print(guard.pid, flush=True)
        while True:
            if note := guard.beat():
                print(note, guard.pid, flush=True)
            clock.sleep(0.1)


def station_file(path, table, chamber, ins="/dev/unused"):
    """The shipped station with these ports, on a wall clock, its guard quick to act."""
    text = find_document("stations", "emulated").read_text()
    for old, new in {
        "clock: virtual": "clock: wall",
        "emulator://table": table,
        "emulator://chamber": chamber,
        "interface: emulator": "interface: slcan",
        "channel: ins": f"channel: {ins}",
    }.items():
        assert old in text
        text = text.replace(old, new)
    path.write_text(text + "\nguard: {silence_s: 5}\n")
    return path


class ServedBench:
    """The emulators of one bench over pseudo-terminals."""

    def __init__(self, folder):
        world = folder / "world.yaml"
        world.write_text(QUICK_WORLD)
        self.process, self.urls = served("--world", world, "--for-s", "1000")
        path = station_file(
            folder / "station.yaml", self.urls["table"], self.urls["chamber"], self.urls["ins"]
        )
        self.station = Station(path)

    def close(self):
        self.process.close()

    def disturb(self):
        """Set the table turning and the chamber heating."""
        with Outputs(self.station, WallClock()) as outputs:
            outputs.table.prepare()
            outputs.table.turn_at(2, 10.0)
            outputs.chamber.set_temperature(60.0, None)

    def state(self):
        """State of the bench: rates of the table, its interlocks, set point of the chamber."""
        with Outputs(self.station, WallClock()) as outputs:
            rate_dps = outputs.table.read().rate_dps
            set_point_c = outputs.chamber.set_point_c()
        return rate_dps, [self._interlock(axis) for axis in (1, 2)], set_point_c

    def _interlock(self, axis):
        """Answer of the controller: error word, length, text."""
        with serial.Serial(self.urls["table"], timeout=LIMIT_S, exclusive=True) as port:
            port.write(f":Interlock? {axis}\r\n".encode())
            error, length = struct.unpack("<II", port.read(8))
            assert error == 0
            return port.read(length).decode().strip()


class SmallEngine:
    """A process that holds the bench and has a guard."""

    def __init__(self, station_path, folder):
        self.folder = folder
        folder.mkdir(exist_ok=True)
        self.process = ForkedProcess(hold_bench, station_path, folder)
        self.guard_pid = int(self.process.stdout.readline())

    def close(self):
        self.process.close()
        with contextlib.suppress(FileNotFoundError):
            wait_for(lambda: "in its safe state" in self.log() or "without acting" in self.log())

    def log(self):
        return (self.folder / "guard.log").read_text()


def wait_for(condition, limit_s=LIMIT_S):
    """Wait until a condition is true; fails if it never is."""
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s, "the condition never became true"
        time.sleep(0.05)


def is_running(pid):
    """Whether a process exists and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
