"""Criteria that select runs of an index."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date, datetime, timedelta
from typing import Any


@dataclass(frozen=True)
class Selection:
    """Criteria for runs; None selects any."""

    #: unit, batch, bench: Serial number, batch of its gyros, name of the station.
    unit: str | None = None
    batch: str | None = None
    bench: str | None = None
    procedure: str | None = None  #: Name of the procedure, or the beginning of its SHA-256.
    #: since, until: First and last day (UTC) of the start of the run.
    since: date | None = None
    until: date | None = None
    verdict: str | None = None  #: Verdict of the search for effects, or of acceptance.
    ended: str | None = None  #: End of the run.

    def condition(self) -> tuple[str, list[Any]]:
        """SQL condition on the table of runs, and its parameters."""
        tests = [
            ("unit = ?", self.unit),
            ("batch = ?", self.batch),
            ("station = ?", self.bench),
            ("(procedure = ? OR starts_with(procedure_sha256, ?))", self.procedure),
            ("started_utc >= ?", _midnight(self.since)),
            ("started_utc < ?", _midnight(self.until, days=1)),
            ("(verdict = ? OR acceptance = ?)", self.verdict),
            ("ended = ?", self.ended),
        ]
        active = [(test, value) for test, value in tests if value is not None]
        parameters = [value for test, value in active for _ in range(test.count("?"))]
        return " AND ".join(test for test, _ in active) or "true", parameters


#: No criterion.
ANY_RUN = Selection()


def _midnight(day: date | None, days: int = 0) -> datetime | None:
    return None if day is None else datetime.combine(day + timedelta(days=days), datetime.min.time())
