"""Which runs of an index are meant: by unit, batch, bench, procedure, date, verdict, end."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date, datetime, timedelta
from typing import Any

from gyrobench.bench.runs.index import RunIndex


@dataclass(frozen=True)
class Selection:
    """What runs have to be to be meant; None for whatever they are.

    Attributes
    ----------
    unit, batch, bench : str
        Serial number, batch of its gyros, name of the station.
    procedure : str
        Name of the procedure, or the beginning of its SHA-256, which tells versions of one name.
    since, until : date
        Days (UTC) on which the run began, both among those meant.
    verdict : str
        Of the search for effects, or of the acceptance limits.
    ended : str
        How it ended.
    """

    unit: str | None = None
    batch: str | None = None
    bench: str | None = None
    procedure: str | None = None
    since: date | None = None
    until: date | None = None
    verdict: str | None = None
    ended: str | None = None

    def condition(self) -> tuple[str, list[Any]]:
        """Give an SQL condition on the table of runs, and its parameters."""
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
        asked = [(test, value) for test, value in tests if value is not None]
        parameters = [value for test, value in asked for _ in range(test.count("?"))]
        return " AND ".join(test for test, _ in asked) or "true", parameters


def find_runs(index: RunIndex, selection: Selection) -> list[dict[str, Any]]:
    """Rows of the table of runs that are meant, newest first."""
    condition, parameters = selection.condition()
    sql = f"SELECT * FROM runs WHERE {condition} ORDER BY started_utc DESC, path DESC"  # noqa: S608 - ours
    return index.query(sql, parameters).records()


def _midnight(day: date | None, days: int = 0) -> datetime | None:
    return None if day is None else datetime.combine(day + timedelta(days=days), datetime.min.time())
