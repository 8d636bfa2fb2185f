"""Trips: the interlocks that are tripped, and the interlock whose rule applies to a failed step."""

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
#: Instrument whose silence an interlock watches; the names of several INS begin with that of one.
SILENT_INSTRUMENT = {"table_silence": RATE_TABLE, "chamber_silence": CHAMBER, "ins_silence": INSTRUMENT}
_SILENCE = {instrument: name for name, instrument in SILENT_INSTRUMENT.items()}
_FAULT = {RATE_TABLE: "table_fault", CHAMBER: "chamber_alarm", INSTRUMENT: "ins_fault"}


@dataclass(frozen=True)
class Trip:
    """A tripped interlock."""

    name: str  #: key in the station file's ``interlocks``
    findings: tuple[InterlockFinding, ...]
    rule: InterlockRule  #: when the run may continue
    unit: str = ""  #: serial number of the only unit concerned, if there are several

    @property
    def text(self) -> str:
        """Problems and advice: value, limit, and what to do."""
        return text_of_findings(self.findings)


def text_of_trips(trips: Iterable[Trip]) -> str:
    """Return problems and advice as text, each advice once."""
    return text_of_findings(finding for trip in trips for finding in trip.findings)


class TrippedError(InterlockError):
    """Interlocks are tripped."""

    def __init__(self, trips: Sequence[Trip]) -> None:
        super().__init__(text_of_trips(trips))
        self.trips = trips


def trip_of_error(error: GyrobenchError, station: Station, step: Step | None = None) -> Trip:
    """Return the trip whose rule applies to a failed step: the instrument is silent or has a fault.

    A step that timed out for another reason needs the operator, unless the INS did not start.
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

    ``absent``: names of instruments that were not opened; they are not checked.
    """

    def __init__(self, station: Station, clock: Clock, absent: Collection[str] = ()) -> None:
        self._clock = clock
        self._rules = station.file.interlocks.rules()
        self._checks = [make(station) for name, make in _CHECKS.items() if name not in absent]
        self._readings: Readings | None = None
        self._untripped_since_s: dict[str, float] = {}
        #: With the present readings and this expected state, nothing trips before this time.
        self._untripped: tuple[ExpectedState | None, float] = (None, -math.inf)

    def is_implausible(self, reading: TableReading | ChamberReading, expected: ExpectedState) -> bool:
        """Whether a new reading by itself would trip an interlock, so that it should be read again."""
        if (previous := self._readings) is None:
            return False
        for checks in self._checks:
            if isinstance(checks, TableChecks) and isinstance(reading, TableReading):
                return checks.is_implausible(reading, previous, expected)
            if isinstance(checks, ChamberChecks) and isinstance(reading, ChamberReading):
                return checks.is_implausible(reading, previous, expected)
        return False

    def observe(self, readings: Readings) -> None:
        """Process the readings; call after every poll, whether the instruments answered or not."""
        now_s = self._clock.now()
        for each in self._checks:
            each.observe(readings, now_s)
        self._readings = readings
        self._untripped = (None, -math.inf)

    def trips(self, now_s: float, expected: ExpectedState) -> list[Trip]:
        """Return all interlocks that are tripped, each with all its findings; call at every tick.

        A command in ``expected`` is compared only with readings newer than the first call that contains it.
        """
        checked_expected, untripped_until_s = self._untripped
        if expected is checked_expected and now_s < untripped_until_s:
            return []
        findings: dict[str, list[InterlockFinding]] = {}
        if self._readings is not None:
            for each in self._checks:
                for finding in each.findings(self._readings, expected, now_s):
                    findings.setdefault(finding.interlock, []).append(finding)
        if findings or len(self._untripped_since_s) < len(self._rules):
            for name in self._rules:
                if name in findings:
                    self._untripped_since_s.pop(name, None)
                else:
                    self._untripped_since_s.setdefault(name, now_s)
        names = sorted(findings, key=list(self._rules).index) if findings else []
        trips = [Trip(name, tuple(findings[name]), self._rules[name]) for name in names]
        if self._readings is not None and not trips:
            self._untripped = (
                expected,
                min((each.untripped_until_s(self._readings) for each in self._checks), default=math.inf),
            )
        return trips

    def untripped_since_s(self, name: str) -> float | None:
        """Time of the call of :meth:`trips` since which an interlock is not tripped; None while it is."""
        return self._untripped_since_s.get(name)
