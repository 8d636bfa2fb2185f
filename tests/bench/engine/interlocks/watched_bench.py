"""A watched bench whose readings a test makes up."""

from dataclasses import dataclass, field, replace

import numpy as np

from gyrobench.bench.engine.bench_state import ExpectedState, Readings
from gyrobench.bench.engine.interlocks.watch import InterlockWatch
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.drivers.chamber import ChamberReading
from gyrobench.drivers.ins.readout import InsMode
from gyrobench.drivers.rate_table import TableReading


@dataclass
class FakeStatus:
    """Status of an INS, with the fields of :class:`gyrobench.drivers.ins.ins_status.InsStatus`."""

    age_s: float = 0.5
    mode: InsMode = InsMode.NAVIGATE
    optics_c: np.ndarray = field(default_factory=lambda: np.full(3, 30.0))
    electronics_c: np.ndarray = field(default_factory=lambda: np.full(3, 32.0))
    case_c: float = 28.0


ALL_WELL = ExpectedState(chamber_set_c=20.0, chamber_on=True, ins_on=True, table_prepared=True)


def air(*values, alarms=()):
    """Reading of a chamber, without alarms unless given."""
    return ChamberReading(*values, alarms=alarms)


def at(*values, faults=()):
    """Reading of a table, without faults unless given."""
    return TableReading(*values, faults=faults)


class WatchedBench:
    """An interlock watch, the clock that it lives on, and the readings that come next."""

    def __init__(self, station):
        self.clock = VirtualClock()
        self.watch = InterlockWatch(station, self.clock)
        self.expected = ALL_WELL
        self.table = at((0.0, 0.0), (0.0, 0.0))
        self.chamber = air(20.0, 20.0, True)
        self.ins = FakeStatus()
        self._table_s = self._chamber_s = 0.0

    def poll(self, after_s=10.0, answering=("table", "chamber")):
        """Let time pass and give the readings of those that answer; returns the trips by name."""
        self.clock.sleep(after_s)
        now_s = self.clock.now()
        self._table_s = now_s if "table" in answering else self._table_s
        self._chamber_s = now_s if "chamber" in answering else self._chamber_s
        self.watch.observe(
            Readings(self.table, self._table_s, self.chamber, self._chamber_s, replace(self.ins), now_s)
        )
        return self.trips()

    def trips(self):
        """Trips by name, as the engine asks for them at a tick."""
        return {trip.name: trip for trip in self.watch.trips(self.clock.now(), self.expected)}

    def poll_for(self, duration_s, period_s=10.0):
        """Poll over some time; returns the trips of the last poll."""
        trips = {}
        for _ in range(round(duration_s / period_s)):
            trips = self.poll(period_s)
        return trips
