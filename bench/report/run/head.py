"""What the report says first: unit, bench, procedure, who and when, and how the run ended."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

from bench.procedure.timeline import hours_minutes
from bench.report.content import Entry, RunContent
from bench.report.verification.section import dwells_text
from bench.report.wording import counted

_PROGRAMS = ("gyrobench", "python", "platform")
_CUT_OFF = "It was killed or cut off, or has not ended yet: the journal does not tell of its end."
_TIME = "%Y-%m-%d %H:%M:%S"
_MOST_OFFSET_S = 86_000.0


def unit_of(content: RunContent) -> str:
    """Serial number of the unit, or of several; empty where none is known."""
    units = {row.unit for row in content.dwells} | {row.unit for row in content.verification}
    identified = content.last("ins_identified").get("unit")
    return ", ".join(sorted(units - {""})) or str(identified or "")


def _dwells_text(content: RunContent) -> str:
    flagged = sum(bool(row.flags) for row in content.dwells)
    texts = [f"{len(content.dwells)} measured, {flagged} of them flagged"] if content.dwells else []
    texts += [dwells_text(content.verification)] if content.verification else []
    return "; ".join(texts) or "none"


def facts_of(content: RunContent) -> dict[str, str]:
    """What was run, on what, by whom and when; what is not known is left out."""
    started = content.last("run_started")
    own = content.provenance
    options = {**own.get("options", {}), **started.get("options", {})}
    begun = _moment(own.get("started_utc") or started.get("utc"))
    end_s = max((_seconds(entry.get("time_s")) for entry in content.journal), default=0.0)
    facts = {
        "unit": unit_of(content) or "serial number not known",
        "procedure": started.get("procedure") or content.procedure.get("procedure"),
        "purpose": content.procedure.get("description"),
        "bench": started.get("station") or content.station.get("station"),
        "started by": " on ".join(str(own[name]) for name in ("operator", "host") if own.get(name)),
        "started": _both_times(begun, 0.0, own),
        "ended": _both_times(begun, end_s, own) if content.last("run_ended") else "",
        "duration": _duration(content, end_s),
        "dwells": _dwells_text(content),
        "options": ", ".join(f"{name} {value}" for name, value in options.items()),
    }
    return {name: str(value) for name, value in facts.items() if value}


def _duration(content: RunContent, end_s: float) -> str:
    resumed = len(content.entries("run_resumed"))
    more = f", gone on with {counted(resumed, 'time')}" if resumed else ""
    return f"{hours_minutes(end_s)} h{more}" if end_s else ""


def _moment(iso_time: object) -> datetime | None:
    try:
        moment = datetime.fromisoformat(str(iso_time))
    except ValueError:
        return None
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)


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


def _seconds(value: object) -> float:
    return float(value) if isinstance(value, int | float) else 0.0


def ending_of(content: RunContent) -> Entry:
    """Tell how the run ended: word, reason, the step that did not end, safe state."""
    end = content.last("run_ended")
    ended = str(end.get("ended", "not ended"))
    return {
        "word": ended,
        "reason": end.get("reason") or ("" if end else _CUT_OFF),
        "step": "" if ended == "finished" else _open_step(content),
        "safe_state": end.get("safe_state") or [],
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
