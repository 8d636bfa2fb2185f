"""Trips: which interlocks are tripped, and by whose rule a failed step is treated."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from gyrobench.bench.engine.bench_state import ExpectedState, Readings
from gyrobench.bench.engine.interlocks.checks import (
    ChamberChecks,
    InsChecks,
    InterlockFinding,
    TableChecks,
    text_of_findings,
)
from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import (
    FaultError,
    GyrobenchError,
    InstrumentError,
    InterlockError,
    RefusedError,
)
from gyrobench.bench.procedure.steps import PowerOn, Step
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE
from gyrobench.bench.station.interlocks import InterlockRule
from gyrobench.bench.station.station import Station
from gyrobench.drivers.chamber import ChamberReading
from gyrobench.drivers.ins.can_bus import INSTRUMENT
from gyrobench.drivers.rate_table import TableReading

_CHECKS: Mapping[str, type[TableChecks | ChamberChecks | InsChecks]] = {
    RATE_TABLE: TableChecks,
    CHAMBER: ChamberChecks,
    INSTRUMENT: InsChecks,
}
_SILENCE = {RATE_TABLE: "table_silence", CHAMBER: "chamber_silence", INSTRUMENT: "ins_silence"}
_FAULT = {RATE_TABLE: "table_fault", CHAMBER: "chamber_alarm", INSTRUMENT: "ins_fault"}


@dataclass(frozen=True)
class Trip:
    """A tripped interlock."""

    name: str  #: key in the station file's ``interlocks``
    findings: tuple[InterlockFinding, ...]
    rule: InterlockRule  #: when the run may continue
    unit: str = ""  #: serial number of the unit that alone is concerned, of several

    @property
    def text(self) -> str:
        """What is wrong: value, limit, and what to do."""
        return text_of_findings(self.findings)


def text_of_trips(trips: Iterable[Trip]) -> str:
    """Return what is wrong as text, each advice once."""
    return text_of_findings(finding for trip in trips for finding in trip.findings)


class TrippedError(InterlockError):
    """Interlocks are tripped."""

    def __init__(self, trips: Sequence[Trip]) -> None:
        super().__init__(text_of_trips(trips))
        self.trips = trips


def trip_of_error(error: GyrobenchError, station: Station, step: Step | None = None) -> Trip:
    """Return the trip by whose rule a failed step is treated: the instrument is silent, or has a fault.

    Another step that did not end in time needs the operator, unless the INS did not start.
    """
    name = "step"
    if isinstance(error, InstrumentError):
        has_fault = isinstance(error, FaultError | RefusedError)
        kind = INSTRUMENT if error.instrument.startswith(INSTRUMENT) else error.instrument
        name = (_FAULT if has_fault else _SILENCE)[kind]
    elif isinstance(step, PowerOn):
        name = "ins_silence"
    rule = InterlockRule() if name == "step" else getattr(station.file.interlocks, name)
    return Trip(name, (InterlockFinding(name, str(error), ""),), rule)


class InterlockWatch:
    """Watches the readings of one run.

    ``absent``: names of instruments that the bench was opened without; nothing is checked of them.
    """

    def __init__(self, station: Station, clock: Clock, absent: Collection[str] = ()) -> None:
        self._clock = clock
        self._rules = station.file.interlocks.rules()
        self._checks = [make(station) for name, make in _CHECKS.items() if name not in absent]
        self._readings: Readings | None = None
        self._good_since_s: dict[str, float] = {}
        #: Nothing was found wrong with these readings and this command, nor will be until that time.
        self._good: tuple[ExpectedState | None, float] = (None, -math.inf)

    def is_doubtful(self, reading: TableReading | ChamberReading, expected: ExpectedState) -> bool:
        """Whether a new reading alone would trip an interlock, so that it should be taken again."""
        if (before := self._readings) is None:
            return False
        for checks in self._checks:
            if isinstance(checks, TableChecks) and isinstance(reading, TableReading):
                return checks.is_doubtful(reading, before, expected)
            if isinstance(checks, ChamberChecks) and isinstance(reading, ChamberReading):
                return checks.is_doubtful(reading, before, expected)
        return False

    def observe(self, readings: Readings) -> None:
        """Take the readings; to be called after every poll, whether the instruments answered or not."""
        now_s = self._clock.now()
        for each in self._checks:
            each.observe(readings, now_s)
        self._readings = readings
        self._good = (None, -math.inf)

    def trips(self, now_s: float, expected: ExpectedState) -> list[Trip]:
        """Return all interlocks that are tripped, each with all its findings; to be called at every tick.

        Only readings newer than the first call with a command in ``expected`` are compared with it.
        """
        good_expected, good_until_s = self._good
        if expected is good_expected and now_s < good_until_s:
            return []
        found: dict[str, list[InterlockFinding]] = {}
        if self._readings is not None:
            for each in self._checks:
                for finding in each.findings(self._readings, expected, now_s):
                    found.setdefault(finding.interlock, []).append(finding)
        if found or len(self._good_since_s) < len(self._rules):
            for name in self._rules:
                if name in found:
                    self._good_since_s.pop(name, None)
                else:
                    self._good_since_s.setdefault(name, now_s)
        names = sorted(found, key=list(self._rules).index) if found else []
        trips = [Trip(name, tuple(found[name]), self._rules[name]) for name in names]
        if self._readings is not None and not trips:
            self._good = (
                expected,
                min((each.good_until_s(self._readings) for each in self._checks), default=math.inf),
            )
        return trips

    def good_since_s(self, name: str) -> float | None:
        """Time of the call of :meth:`trips` since which an interlock is good; None while it is tripped."""
        return self._good_since_s.get(name)
