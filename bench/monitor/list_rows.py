"""The list of runs, as text."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from urllib.parse import quote

from gyrobench.bench.foundations.text import counted
from gyrobench.bench.monitor.headline import SIGNS, state_look
from gyrobench.bench.monitor.news import News
from gyrobench.bench.monitor.runs import RunSummary
from gyrobench.bench.procedure.timeline import hours_minutes


@dataclass(frozen=True)
class ListRow:
    """One run in the list: name and address, state with sign and CSS class, and the rest in a line."""

    name: str
    address: str
    look: str
    sign: str
    state: str
    reason: str
    facts: str


def list_row(run: RunSummary, news: News) -> ListRow:
    """Write a run as text."""
    is_silent = bool(news.warning)
    return ListRow(
        name=run.name,
        address=address_of(run.name),
        look="bad" if is_silent or run.alarms else state_look(run.state),
        sign="▲" if is_silent else SIGNS[run.state],
        state="silent" if is_silent else run.state.value,
        reason=news.warning or run.reason,
        facts=", ".join(_facts(run)),
    )


def unreadable_row(name: str, problem: str) -> ListRow:
    """Write a run that can't be read."""
    return ListRow(name, address_of(name), "bad", "▲", "can't be read", problem, "")


def address_of(name: str) -> str:
    """Address of a run's page, from the page of the list."""
    return f"runs/{quote(name, safe='')}/"


def _facts(run: RunSummary) -> Iterable[str]:
    if run.alarms:
        yield f"▲ {counted(run.alarms, 'alarm').upper()}"
    if run.procedure:
        yield run.procedure
    if run.unit:
        yield f"unit {run.unit}"
    yield (
        f"{run.dwells} of {counted(run.dwell_count, 'dwell')}"
        if run.dwell_count
        else counted(run.dwells, "dwell")
    )
    if run.left_s and not run.state.is_over:
        yield f"{hours_minutes(run.left_s)} h left"
    if run.started_utc:
        yield f"started {run.started_utc[:16].replace('T', ' ')} UTC"
