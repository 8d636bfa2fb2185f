"""Journal sections of a run report: faults, holds, repeats, commands, notes; durations of steps."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Any

from gyrobench.bench.foundations.operator_name import describe_source
from gyrobench.bench.foundations.text import counted, listed, run_ending
from gyrobench.bench.report.page import Mark, Section, SectionTable


@dataclass(frozen=True)
class KindDuration:
    """Planned and actual duration of the steps of one kind."""

    kind: str  #: Name of the kind as displayed: "go to".
    count: int  #: Finished steps of the plan.
    #: planned_s, actual_s: Sums over the steps; actual_s includes every execution of a repeated step.
    planned_s: float
    actual_s: float
    repeats: int = 0  #: Number of repeated executions.

    @property
    def difference(self) -> str:
        """Actual minus planned duration: "+0:12:05", and in percent of the plan."""
        late_s = self.actual_s - self.planned_s
        text = f"{'-' if round(late_s) < 0 else '+'}{duration_text(abs(late_s))}"
        return f"{text} ({100.0 * late_s / self.planned_s:+.1f} %)" if self.planned_s > 0.0 else text

    @property
    def cells(self) -> list[str]:
        """Cells of a table row: kind, number, planned and actual duration, and their difference."""
        durations = duration_text(self.planned_s), duration_text(self.actual_s)
        return [self.kind, str(self.count), *durations, self.difference]


def durations_by_kind(durations: Iterable[KindDuration]) -> list[KindDuration]:
    """Durations by kind, longest first, followed by the total; empty if no step has finished."""
    by_duration = sorted(durations, key=lambda each: -each.actual_s)
    count, planned_s, actual_s, repeats = (
        sum(getattr(each, name) for each in by_duration) for name in _SUMMED_FIELDS
    )
    return [*by_duration, KindDuration("all", count, planned_s, actual_s, repeats)] if by_duration else []


def add_step_duration(
    durations: dict[str, KindDuration], entry: Mapping[str, Any], finished_steps: set[object]
) -> None:
    """Add a journal entry to the durations by kind if it is the end of a step.

    ``finished_steps``: numbers of the steps finished before; the number of this step is added.
    """
    planned_s, took_s = (_valid_seconds(entry.get(key)) for key in ("planned_s", "took_s"))
    is_end = entry.get("event") == "step_finished" and "kind" in entry and isinstance(entry.get("step"), int)
    if is_end and planned_s is not None and took_s is not None:
        kind = str(entry["kind"]).replace("_", " ")
        sums = durations.get(kind, KindDuration(kind, 0, 0.0, 0.0))
        is_repeat = entry["step"] in finished_steps
        finished_steps.add(entry["step"])
        durations[kind] = KindDuration(
            kind,
            sums.count + (not is_repeat),
            sums.planned_s + (0.0 if is_repeat else planned_s),
            sums.actual_s + took_s,
            sums.repeats + is_repeat,
        )


def step_durations(journal: Iterable[Mapping[str, Any]]) -> list[KindDuration]:
    """Durations of the finished steps of a journal, by kind."""
    durations: dict[str, KindDuration] = {}
    finished_steps: set[object] = set()
    for entry in journal:
        add_step_duration(durations, entry, finished_steps)
    return list(durations.values())


def duration_text(duration_s: float) -> str:
    """Write a duration as h:mm:ss, to the nearest second."""
    seconds = round(duration_s)
    return f"{seconds // 3600}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"


Entry = Mapping[str, Any]

_SUMMED_FIELDS = ("count", "planned_s", "actual_s", "repeats")
#: Largest number of rows; if there are more events, they are grouped.
MAX_ROWS = 60

_MAX_TIME_S = 1e12
_NUMBERS = re.compile(r"\d+(?:[.:]\d+)*")
#: Kinds of events, most important first: the less important are grouped first.
_KINDS_BY_IMPORTANCE = (
    "interlock",
    "held",
    "dwell flagged",
    "dwell repeated",
    "dwell skipped",
    "soak not settled",
    "command",
    "resumed",
    "ended",
    "note",
    "exchange repeated",
)
_ROW_MARKS: Mapping[str, Mark] = MappingProxyType(
    {
        "interlock": "bad",
        "ended": "bad",
        "held": "doubtful",
        "dwell flagged": "doubtful",
        "soak not settled": "doubtful",
    }
)
_NO_EVENTS = "The journal has no fault, hold, repeat, command or note."
_TABLE_CAPTION = "Times from the start. Repeated events are counted in one row; journal.jsonl has all of them"


@dataclass(frozen=True)
class RunEvent:
    """An event, or several equal ones: times of the first and last, number, and outcome."""

    first_s: float
    last_s: float
    kind: str
    description: str
    outcome: str
    count: int = 1

    @property
    def time(self) -> str:
        """Time of the event, or of the first and last of several, as h:mm:ss."""
        if self.count == 1:
            return duration_text(self.first_s)
        return f"{duration_text(self.first_s)} to {duration_text(self.last_s)}"


def run_events(journal: Sequence[Entry]) -> list[RunEvent]:
    """Events of a journal in order; equal events are grouped.

    If there are more than :data:`MAX_ROWS`, events that differ only in numbers are grouped, then all events
    of one kind after another, least important kinds first.
    """
    collector = _EventCollector()
    for entry in journal:
        collector.add_entry(entry)
    events = _group_events(collector.events, lambda each: (each.kind, each.description, each.outcome))
    if len(events) > MAX_ROWS:
        events = _group_events(
            events,
            lambda each: (each.kind, _NUMBERS.sub("…", each.description), _NUMBERS.sub("…", each.outcome)),
        )
    for kind in reversed(_KINDS_BY_IMPORTANCE):
        if len(events) > MAX_ROWS:
            events = _group_events(events, partial(_kind_key, kind))
    return sorted(events, key=lambda each: each.first_s)


def durations_section(durations: Iterable[KindDuration]) -> Section:
    """Planned and actual durations in a table."""
    kinds = durations_by_kind(durations)
    title = "Planned and actual duration"
    if not kinds:
        return Section(title, ["No step was finished."])
    header = ["kind of step", "steps", "planned / h:mm:ss", "actual / h:mm:ss", "difference"]
    marks: list[Mark] = ["sum" if each is kinds[-1] else "" for each in kinds]
    again = kinds[-1].repeats
    caption = f"The actual duration includes {counted(again, 'step')} done again" if again else ""
    return Section(title, tables=[SectionTable(caption, header, [each.cells for each in kinds], marks=marks)])


def events_section(journal: Sequence[Entry]) -> Section:
    """Events of a run in a table."""
    events = run_events(journal)
    if not events:
        return Section("Flags, holds and retries", [_NO_EVENTS])
    counts: Counter[str] = Counter()
    for each in events:
        counts[each.kind] += each.count
    summary = ", ".join(f"{kind} ({counts[kind]})" for kind in _KINDS_BY_IMPORTANCE if counts[kind])
    rows = [
        (
            each.time,
            f"{each.kind}{f' ({each.count} times)' if each.count > 1 else ''}",
            each.description,
            each.outcome,
        )
        for each in events
    ]
    table = SectionTable(
        _TABLE_CAPTION,
        ["time / h:mm:ss", "kind", "what", "outcome"],
        rows,
        words=4,
        marks=[_ROW_MARKS.get(each.kind, "") for each in events],
    )
    texts = [f"Events: {summary}.", *_unsettled_soaks(journal)]
    return Section("Flags, holds and retries", texts, tables=[table])


def _unsettled_soaks(journal: Iterable[Entry]) -> list[str]:
    """Sentence with the number of soaks that reached their time limit, and the largest rate; else empty."""
    soaks = [entry for entry in journal if entry.get("event") == "soak_not_settled"]
    rates = [rate for entry in soaks if isinstance(rate := entry.get("rate_c_per_h"), int | float)]
    worst = f"; the largest rate of a gyro was {max(rates):.3g} °C/h" if rates else ""
    sentence = f"{counted(len(soaks), 'soak')} ended by at_most_s before the gyros had settled"
    return [f"{sentence}{worst}."] if soaks else []


class _EventCollector:
    """Events in order; later entries set the outcome of earlier events."""

    def __init__(self) -> None:
        self.events: list[RunEvent] = []
        self._without_outcome: dict[str, list[int]] = {}
        self._drop_reason: object = ""

    def add_entry(self, entry: Entry) -> None:
        """Add what an entry states: an event, or the outcome of earlier ones."""
        self._add_events_of_dwells(entry)
        by_operator = _by_operator(entry)
        match entry.get("event"):
            case "tripped":
                self._add(entry, "interlock", entry.get("why"), topic="safe")
            case "made_safe":
                actions = entry.get("actions")
                failed = [
                    str(each.get("what"))
                    for each in (actions if isinstance(actions, list) else ())
                    if isinstance(each, Mapping) and each.get("problem")
                ]
                self._set_outcome(
                    "safe", f"safe state NOT reached: {listed(failed)}" if failed else "made safe"
                )
            case "held":
                self._add(entry, "held", entry.get("why"), f"waits for {entry.get('waits_for')}", "hold")
            case "continued":
                held_s = _valid_seconds(entry.get("held_s"))
                after = f" after {duration_text(held_s)}" if held_s is not None else ""
                self._set_outcome("hold", f"continued by {_command_source(entry)}{after}")
            case "retry":
                instrument, error = entry.get("instrument"), str(entry.get("error"))
                description = error if error.startswith(f"{instrument}") else f"{instrument}: {error}"
                self._add(entry, "exchange repeated", description, topic=f"retry {instrument}")
            case "answers_again":
                self._set_outcome(f"retry {entry.get('instrument')}", "answers again")
            case "ordered":
                self._add(entry, "command", entry.get("order"), f"by {_command_source(entry)}")
            case "compensation_decided":
                decision = f"compensation {entry.get('which')}: {entry.get('answer')}"
                self._add(entry, "command", decision, by_operator)
            case "run_started" if by_operator:
                self._add(entry, "command", "start", by_operator)
            case "run_resumed":
                self._set_outcome("hold", "the run ended during the hold")
                description = f"The run was interrupted and resumed {by_operator}".strip()
                self._add(entry, "resumed", f"{description}.", f"from step {entry.get('next_step')}")
            case "unit_dropped":
                self._drop_reason = entry.get("why")  # also the reason at the end of the unit's journal
                self._add(entry, "unit dropped", f"{entry.get('unit')}: {self._drop_reason}")
            case "run_ended" if entry.get("ended") != "finished" and entry.get("reason") != self._drop_reason:
                ending = run_ending(str(entry.get("ended")), str(entry.get("reason")))
                self._add(entry, "ended", f"The run {ending}")
            case "soak_not_settled":
                self._add(entry, "soak not settled", entry.get("text"), "continued")
            case "note":
                self._add(entry, "note", entry.get("text"))
            case "journal_repaired":
                text = "The last line of the journal was incomplete and has been removed."
                self._add(entry, "note", text)

    def _add_events_of_dwells(self, entry: Entry) -> None:
        """Add repeated, skipped and flagged dwells."""
        dwell = entry.get("dwell")
        match entry:
            case {"event": "dwell_given_up"}:
                description = f"dwell {dwell}: {entry.get('why')}"
                self._add(entry, "dwell repeated", description, "not measured again", f"dwell {dwell}")
            case {"event": "repeat_commanded", "dwells": list(dwells), "why": list(reasons)}:
                for each, reason in zip(dwells, reasons, strict=False):
                    named = f"dwell {each} ({reason})" if reason else f"dwell {each}"
                    description = f"{named}, commanded {_by_operator(entry)}".strip()
                    self._add(entry, "dwell repeated", description, "not measured again", f"dwell {each}")
            case {"event": "dwell_skipped"}:
                self._add(entry, "dwell skipped", f"dwell {dwell}")
            case {"event": "dwell_finished"}:
                marks, flags = entry.get("marks"), entry.get("flags")
                measured = f"dwell {marks.get('dwell') if isinstance(marks, Mapping) else None}"
                replaced = "; replaces the earlier measurement" if entry.get("replaces_earlier") else ""
                self._set_outcome(measured, f"measured again, {'flagged' if flags else 'good'}{replaced}")
                if flags:
                    self._add(entry, "dwell flagged", f"{measured}: {flags}", "excluded from the bins")

    def _add(self, entry: Entry, kind: str, description: object, outcome: str = "", topic: str = "") -> None:
        """Add an event; a later entry about its ``topic`` replaces the outcome."""
        if topic:
            self._without_outcome.setdefault(topic, []).append(len(self.events))
        time_s = _valid_seconds(entry.get("time_s")) or 0.0
        self.events.append(RunEvent(time_s, time_s, kind, str(description), outcome))

    def _set_outcome(self, topic: str, outcome: str) -> None:
        for index in self._without_outcome.pop(topic, []):
            self.events[index] = replace(self.events[index], outcome=outcome)


def _by_operator(entry: Entry) -> str:
    return f"by {entry['operator']}" if entry.get("operator") else ""


def _command_source(entry: Entry) -> str:
    """Source of a command, with the operator's name if known and not part of the source."""
    source, operator = describe_source(str(entry.get("by"))), str(entry.get("operator") or "")
    return f"{operator} ({source})" if operator and operator not in source else source


def _valid_seconds(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and abs(value) < _MAX_TIME_S else None


def _group_events(events: Iterable[RunEvent], key: Callable[[RunEvent], object]) -> list[RunEvent]:
    """Merge events with equal keys into one, at the position of the first."""
    groups: dict[object, RunEvent] = {}
    for event in events:
        first = groups.setdefault(key(event), event)
        if first is not event:
            groups[key(event)] = replace(first, last_s=event.last_s, count=first.count + event.count)
    return list(groups.values())


def _kind_key(kind: str, event: RunEvent) -> object:
    return kind if event.kind == kind else event
