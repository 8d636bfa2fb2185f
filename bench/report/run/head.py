"""What the report says first: unit, bench, procedure, who and when, and how the run ended."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

from gyrobench.bench.foundations.clock import parsed_utc
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.procedure.timeline import hours_minutes
from gyrobench.bench.report.calibration_check.section import dwells_text
from gyrobench.bench.report.content import Entry, RunContent
from gyrobench.bench.runs.journal import RunFacts

_PROGRAMS = ("gyrobench", "python", "platform")
_CUT_OFF = "It was killed or cut off, or has not ended yet: the journal does not tell of its end."
_TIME = "%Y-%m-%d %H:%M:%S"
_MOST_OFFSET_S = 86_000.0


def serial_number_of(content: RunContent) -> str:
    """Serial number of the unit, or of several; empty where none is known."""
    units = {row.unit for row in content.dwells} | {row.unit for row in content.verification}
    return ", ".join(sorted(units - {""})) or content.facts.unit


def _dwells_text(content: RunContent) -> str:
    flagged = sum(bool(row.flags) for row in content.dwells)
    texts = [f"{len(content.dwells)} measured, {flagged} of them flagged"] if content.dwells else []
    texts += [dwells_text(content.verification)] if content.verification else []
    return "; ".join(texts) or "none"


def head_lines(content: RunContent) -> dict[str, str]:
    """What was run, on what, by whom and when; what is not known is left out."""
    told, own = content.facts, content.provenance
    options = {**own.get("options", {}), **told.options}
    begun = parsed_utc(own.get("started_utc") or told.started_utc)
    lines = {
        "unit": serial_number_of(content) or "serial number not known",
        "procedure": told.procedure or content.procedure.get("procedure"),
        "purpose": content.procedure.get("description"),
        "bench": told.station or content.station.get("station"),
        "started by": " on ".join(str(own[name]) for name in ("operator", "host") if own.get(name)),
        "started": _both_times(begun, 0.0, own),
        "ended": _both_times(begun, told.last_s, own) if told.ended else "",
        "duration": _duration(told),
        "dwells": _dwells_text(content),
        "options": ", ".join(f"{name} {value}" for name, value in options.items()),
    }
    return {name: str(value) for name, value in lines.items() if value}


def _duration(told: RunFacts) -> str:
    more = f", gone on with {counted(told.resumes, 'time')}" if told.resumes else ""
    return f"{hours_minutes(told.last_s)} h{more}" if told.last_s else ""


def _both_times(begun: datetime | None, after_s: float, provenance: Entry) -> str:
    """Write a time in UTC, and as clocks on the bench showed it, where that is known."""
    if begun is None:
        return ""
    try:
        moment = begun.astimezone(UTC) + timedelta(seconds=after_s)
        text = f"{moment.strftime(_TIME)} UTC"
        offset_s = provenance.get("utc_offset_s")
        if not isinstance(offset_s, int | float) or not abs(offset_s) < _MOST_OFFSET_S:
            return text
        if not offset_s:
            return f"{text}, which is local time too"
        local = moment.astimezone(timezone(timedelta(seconds=offset_s)))
    except OverflowError:
        return ""
    return f"{text}, {local.strftime(_TIME)} local time ({local.tzname()})"


def ending_of(content: RunContent) -> Entry:
    """Tell how the run ended: word, reason, the step that did not end, safe state."""
    told = content.facts
    return {
        "word": told.ended or "not ended",
        "reason": told.reason or ("" if told.ended else _CUT_OFF),
        "step": "" if told.ended == "finished" else _open_step(content),
        "safe_state": told.safe_state,
    }


def _open_step(content: RunContent) -> str:
    """Say which step had begun and not ended; empty where none had."""
    steps = [entry for entry in content.journal if entry.get("event") in ("step_started", "step_finished")]
    if not steps or steps[-1]["event"] == "step_finished":
        return ""
    last = steps[-1]
    where = f" ({last['label']})" if last.get("label") else ""
    return f"step {last.get('step', '?')}, {last.get('what', 'of unknown kind')}{where}"


def instruments_of(content: RunContent) -> dict[str, str]:
    """What each instrument said it is."""
    known = dict(content.provenance.get("instruments", {}))
    identity = content.last("ins_identified").get("identity")
    if isinstance(identity, Mapping):
        identity = ", ".join(f"{name} {value}" for name, value in identity.items())
    return known | ({"INS": identity} if identity else {})


def versions_of(provenance: Entry) -> dict[str, Any]:
    """Versions of the programs that made the run."""
    own = {name: provenance[name] for name in _PROGRAMS if name in provenance}
    return {**own, **provenance.get("packages", {})}
