"""The watch over all interlocks of a run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from gyrobench.bench.engine.interlocks.chamber_checks import ChamberChecks
from gyrobench.bench.engine.interlocks.expected import Expected
from gyrobench.bench.engine.interlocks.findings import Finding, told
from gyrobench.bench.engine.interlocks.ins_checks import InsChecks
from gyrobench.bench.engine.interlocks.table_checks import TableChecks
from gyrobench.bench.engine.readings import Readings
from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.station.interlocks import InterlockRule
from gyrobench.bench.station.station import Station


@dataclass(frozen=True)
class Trip:
    """An interlock that is tripped now.

    Attributes
    ----------
    name : str
        Its key in the station file's ``interlocks``.
    findings : tuple of Finding
        What is wrong.
    rule : InterlockRule
        What becomes of the run.
    """

    name: str
    findings: tuple[Finding, ...]
    rule: InterlockRule

    @property
    def text(self) -> str:
        """What is wrong: value, limit, and what to do."""
        return told(self.findings)


def text_of(trips: Iterable[Trip]) -> str:
    """What is wrong by all of them, each advice once."""
    return told(finding for trip in trips for finding in trip.findings)


class InterlockWatch:
    """Watches the readings of one run.

    Parameters
    ----------
    station : Station
        The limits.
    clock : Clock
        The run's clock.
    """

    def __init__(self, station: Station, clock: Clock) -> None:
        self._clock = clock
        self._rules = station.file.interlocks.rules()
        self._table = TableChecks(station)
        self._chamber = ChamberChecks(station)
        self._ins = InsChecks(station)
        self._readings: Readings | None = None
        self._good_since_s: dict[str, float] = {}

    def observe(self, readings: Readings) -> None:
        """Take what the instruments said; to be called after every poll, whoever answered in it."""
        self._table.observe(readings)
        self._chamber.observe(readings)
        self._ins.observe(readings, self._clock.now())
        self._readings = readings

    def trips(self, now_s: float, expected: Expected) -> list[Trip]:
        """All interlocks that are tripped now; to be called at every tick.

        Parameters
        ----------
        now_s : float
            On the run's clock.
        expected : Expected
            What the bench told the instruments last. They are held to it by readings that are newer
            than the call that brought it first.

        Returns
        -------
        list of Trip
            In the order of the station file's model; one for each interlock, with all it finds.
        """
        found: dict[str, list[Finding]] = {name: [] for name in self._rules}
        for finding in self._findings(now_s, expected):
            found[finding.interlock].append(finding)
        for name, findings in found.items():
            if findings:
                self._good_since_s.pop(name, None)
            else:
                self._good_since_s.setdefault(name, now_s)
        return [Trip(name, tuple(each), self._rules[name]) for name, each in found.items() if each]

    def good_since_s(self, name: str) -> float | None:
        """Time of the call of :meth:`trips` since which an interlock is good; None while it is tripped."""
        return self._good_since_s.get(name)

    def _findings(self, now_s: float, expected: Expected) -> Iterator[Finding]:
        if self._readings is None:
            return
        for checks in (self._table, self._chamber, self._ins):
            yield from checks.findings(self._readings, expected, now_s)
