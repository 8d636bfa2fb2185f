"""What a journal tells of a run in short: what was run, on whom, how far it came and how it ended."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

#: What no run reaches; a later time is a damaged entry.
LONGEST_RUN_S = 1e9


@dataclass(frozen=True)
class RunFacts:
    """What the entries so far tell; empty where they do not.

    Attributes
    ----------
    procedure, station, unit : str
        What was run, on which bench, and the serial number of the INS.
    options : mapping
        Options of the command that began or resumed it.
    started_utc : str
        ISO 8601, when it began.
    last_s : float
        Latest time of an entry, on the run's clock.
    resumes : int
        How often it was resumed.
    dwells : int
        How many were measured.
    ended, reason : str
        How it ended and why: "finished", "stopped" or "failed". Empty for a run that was cut off, or goes
        on: what was said before it was resumed no longer holds.
    safe_state : tuple of mapping
        What was done at its end to make the bench safe.
    """

    procedure: str = ""
    station: str = ""
    unit: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    started_utc: str = ""
    last_s: float = 0.0
    resumes: int = 0
    dwells: int = 0
    ended: str = ""
    reason: str = ""
    safe_state: tuple[Mapping[str, Any], ...] = ()


def facts_of(entries: Iterable[Mapping[str, Any]]) -> RunFacts:
    """Read a journal with patience: entries that are not as they should be are passed over."""
    facts = RunFacts()
    for entry in entries:
        facts = _with(replace(facts, last_s=max(facts.last_s, _time_s(entry))), entry)
    return facts


def _with(facts: RunFacts, entry: Mapping[str, Any]) -> RunFacts:
    match entry.get("event"):
        case "run_started":
            return _begun(replace(facts, started_utc=_text(entry, "utc")), entry)
        case "run_resumed":
            return replace(_begun(facts, entry), resumes=facts.resumes + 1)
        case "ins_identified":
            return replace(facts, unit=_text(entry, "unit") or facts.unit)
        case "dwell_finished":
            return replace(facts, dwells=facts.dwells + 1)
        case "run_ended":
            return replace(
                facts,
                ended=_text(entry, "ended"),
                reason=_text(entry, "reason"),
                safe_state=_safe_state(entry.get("safe_state")),
            )
    return facts


def _begun(facts: RunFacts, entry: Mapping[str, Any]) -> RunFacts:
    options = entry.get("options")
    return replace(
        facts,
        procedure=_text(entry, "procedure") or facts.procedure,
        station=_text(entry, "station") or facts.station,
        options={**facts.options, **options} if isinstance(options, Mapping) else facts.options,
        ended="",
        reason="",
        safe_state=(),
    )


def _text(entry: Mapping[str, Any], key: str) -> str:
    value = entry.get(key)
    return "" if value is None else str(value)


def _time_s(entry: Mapping[str, Any]) -> float:
    value = entry.get("time_s")
    return float(value) if isinstance(value, int | float) and 0.0 <= value <= LONGEST_RUN_S else 0.0


def _safe_state(actions: object) -> tuple[Mapping[str, Any], ...]:
    return tuple(each for each in actions if isinstance(each, Mapping)) if isinstance(actions, list) else ()
