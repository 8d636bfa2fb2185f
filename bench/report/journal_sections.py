"""The journal in the report of a run: faults, holds, repeats, commands, notes; durations."""

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

    kind: str  #: Name of the kind for people: "go to".
    count: int  #: Finished steps of the plan.
    #: planned_s, took_s: Sums over them; of a step that was done again, took_s has each time.
    planned_s: float
    took_s: float
    repeats: int = 0  #: How often one of them was done again.

    @property
    def difference(self) -> str:
        """Actual minus planned duration: "+0:12:05", and in percent of the plan."""
        late_s = self.took_s - self.planned_s
        text = f"{'-' if round(late_s) < 0 else '+'}{clock_time(abs(late_s))}"
        return f"{text} ({100.0 * late_s / self.planned_s:+.1f} %)" if self.planned_s > 0.0 else text

    @property
    def cells(self) -> list[str]:
        """Kind, number, planned and actual duration, and their difference."""
        durations = clock_time(self.planned_s), clock_time(self.took_s)
        return [self.kind, str(self.count), *durations, self.difference]


def durations_by_kind(took: Iterable[KindDuration]) -> list[KindDuration]:
    """Sums by kind, longest first, and the total last; empty if no step has finished."""
    kinds = sorted(took, key=lambda each: -each.took_s)
    count, planned_s, took_s, repeats = (sum(getattr(each, name) for each in kinds) for name in _SUMS)
    return [*kinds, KindDuration("all", count, planned_s, took_s, repeats)] if kinds else []


def add_step(took: dict[str, KindDuration], entry: Mapping[str, Any], finished: set[object]) -> None:
    """Add an entry of a journal to the sums by kind, if a step has finished with it.

    ``finished``: numbers of the steps before it, to which its own is added.
    """
    if entry.get("event") == "step_finished" and {"kind", "step", "planned_s", "took_s"} <= entry.keys():
        kind = str(entry["kind"]).replace("_", " ")
        sums, again = took.get(kind, KindDuration(kind, 0, 0.0, 0.0)), entry["step"] in finished
        finished.add(entry["step"])
        took[kind] = KindDuration(
            kind,
            sums.count + (not again),
            sums.planned_s + (0.0 if again else float(entry["planned_s"])),
            sums.took_s + float(entry["took_s"]),
            sums.repeats + again,
        )


def step_durations(journal: Iterable[Mapping[str, Any]]) -> list[KindDuration]:
    """Durations of the finished steps of a journal, by kind."""
    took: dict[str, KindDuration] = {}
    finished: set[object] = set()
    for entry in journal:
        add_step(took, entry, finished)
    return list(took.values())


def clock_time(duration_s: float) -> str:
    """Write a duration as h:mm:ss, to the nearest second."""
    seconds = round(duration_s)
    return f"{seconds // 3600}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"


Entry = Mapping[str, Any]

_SUMS = ("count", "planned_s", "took_s", "repeats")
#: Longest table; beyond it, events are grouped.
MAX_ROWS = 60

_MAX_TIME_S = 1e12
_NUMBERS = re.compile(r"\d+(?:[.:]\d+)*")
#: Most important first: these keep their rows when events are grouped.
_KINDS = (
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
_MARKS: Mapping[str, Mark] = MappingProxyType(
    {
        "interlock": "bad",
        "ended": "bad",
        "held": "doubtful",
        "dwell flagged": "doubtful",
        "soak not settled": "doubtful",
    }
)
_QUIET = "The journal has no fault, hold, repeat, command or note."
_ALL = "Times from the start. Repeated events are counted in one row; journal.jsonl has all of them"


@dataclass(frozen=True)
class RunEvent:
    """An event, or several alike: times of the first and last, number, and outcome."""

    first_s: float
    last_s: float
    kind: str
    what: str
    outcome: str
    count: int = 1

    @property
    def time(self) -> str:
        """Time of the first, and of the last where there are several, as h:mm:ss."""
        if self.count == 1:
            return clock_time(self.first_s)
        return f"{clock_time(self.first_s)} to {clock_time(self.last_s)}"


def run_events(journal: Sequence[Entry]) -> list[RunEvent]:
    """Events of a journal in order, equal ones grouped.

    More than :data:`MAX_ROWS` are grouped further: first those that differ only in numbers, then all of a
    kind, repeated exchanges first.
    """
    events = _grouped(_events(journal), lambda each: (each.kind, each.what, each.outcome))
    if len(events) > MAX_ROWS:
        events = _grouped(events, lambda each: (each.kind, _shape(each.what), _shape(each.outcome)))
    for kind in reversed(_KINDS):
        if len(events) > MAX_ROWS:
            events = _grouped(events, partial(_kind_or_itself, kind))
    return sorted(events, key=lambda each: each.first_s)


def durations_section(took: Iterable[KindDuration]) -> Section:
    """Planned and actual durations in a table."""
    kinds = durations_by_kind(took)
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
        return Section("Flags, holds and retries", [_QUIET])
    counts: Counter[str] = Counter()
    for each in events:
        counts[each.kind] += each.count
    summary = ", ".join(f"{kind} ({counts[kind]})" for kind in _KINDS if counts[kind])
    rows = [
        (
            each.time,
            f"{each.kind}{f' ({each.count} times)' if each.count > 1 else ''}",
            each.what,
            each.outcome,
        )
        for each in events
    ]
    table = SectionTable(
        _ALL,
        ["time / h:mm:ss", "kind", "what", "outcome"],
        rows,
        words=4,
        marks=[_MARKS.get(each.kind, "") for each in events],
    )
    texts = [f"Events: {summary}.", *_unsettled_sentence(journal)]
    return Section("Flags, holds and retries", texts, tables=[table])


def _unsettled_sentence(journal: Iterable[Entry]) -> list[str]:
    """How many soaks ended by their time, and the largest rate at their end; empty without any."""
    found = [entry for entry in journal if entry.get("event") == "soak_not_settled"]
    rates = [rate for entry in found if isinstance(rate := entry.get("rate_c_per_h"), int | float)]
    worst = f"; the largest rate of a gyro was {max(rates):.3g} °C/h" if rates else ""
    number = f"{counted(len(found), 'soak')} ended by at_most_s before the gyros had settled"
    return [f"{number}{worst}."] if found else []


def _events(journal: Iterable[Entry]) -> list[RunEvent]:
    gathered = _Gathered()
    for entry in journal:
        if read := gathered.readers.get(str(entry.get("event"))):
            read(entry)
    return gathered.events


class _Gathered:
    """Events in order; later entries add the outcome of earlier ones."""

    def __init__(self) -> None:
        self.events: list[RunEvent] = []
        self._open: dict[tuple[str, str], list[int]] = {}
        self._dropped: object = ""
        self.readers: Mapping[str, Callable[[Entry], object]] = {
            "tripped": self._tripped,
            "made_safe": self._made_safe,
            "held": self._held,
            "continued": self._continued,
            "retry": self._retry,
            "answers_again": lambda entry: self._close("retry", entry.get("instrument"), "answers again"),
            "dwell_given_up": self._given_up,
            "dwell_finished": self._finished,
            "dwell_skipped": lambda entry: self._add(entry, "dwell skipped", f"dwell {entry.get('dwell')}"),
            "ordered": lambda entry: self._add(
                entry, "command", str(entry.get("order")), f"by {_who(entry)}"
            ),
            "run_started": self._started,
            "run_resumed": self._resumed,
            "compensation_decided": lambda entry: self._add(
                entry, "command", f"compensation {entry.get('which')}: {entry.get('answer')}", _by(entry)
            ),
            "unit_dropped": self._unit_dropped,
            "run_ended": self._ended,
            "soak_not_settled": lambda entry: self._add(
                entry, "soak not settled", str(entry.get("text")), "continued"
            ),
            "note": lambda entry: self._add(entry, "note", str(entry.get("text"))),
            "journal_repaired": lambda entry: self._add(
                entry, "note", "The last line of the journal was incomplete and has been removed."
            ),
        }

    def _add(self, entry: Entry, kind: str, what: str, outcome: str = "") -> int:
        at_s = _seconds(entry.get("time_s")) or 0.0
        self.events.append(RunEvent(at_s, at_s, kind, what, outcome))
        return len(self.events) - 1

    def _await(self, topic: str, key: object, index: int) -> None:
        self._open.setdefault((topic, str(key)), []).append(index)

    def _close(self, topic: str, key: object, outcome: str) -> None:
        for index in self._open.pop((topic, str(key)), []):
            self.events[index] = replace(self.events[index], outcome=outcome)

    def _tripped(self, entry: Entry) -> None:
        self._await("safe", None, self._add(entry, "interlock", str(entry.get("why"))))

    def _made_safe(self, entry: Entry) -> None:
        found = entry.get("actions")
        actions = [each for each in found if isinstance(each, Mapping)] if isinstance(found, list) else []
        failed = [str(action.get("what")) for action in actions if action.get("problem")]
        self._close("safe", None, f"safe state NOT reached: {listed(failed)}" if failed else "made safe")

    def _held(self, entry: Entry) -> None:
        index = self._add(entry, "held", str(entry.get("why")), f"waits for {entry.get('waits_for')}")
        self._await("hold", None, index)

    def _continued(self, entry: Entry) -> None:
        held_s = _seconds(entry.get("held_s"))
        after = f" after {clock_time(held_s)}" if held_s is not None else ""
        self._close("hold", None, f"continued by {_who(entry)}{after}")

    def _retry(self, entry: Entry) -> None:
        instrument = entry.get("instrument")
        error = str(entry.get("error"))
        what = error if error.startswith(f"{instrument}") else f"{instrument}: {error}"
        self._await("retry", instrument, self._add(entry, "exchange repeated", what))

    def _given_up(self, entry: Entry) -> None:
        dwell = entry.get("dwell")
        index = self._add(entry, "dwell repeated", f"dwell {dwell}: {entry.get('why')}", "not measured again")
        self._await("dwell", dwell, index)

    def _finished(self, entry: Entry) -> None:
        marks, flags = entry.get("marks"), entry.get("flags")
        dwell = marks.get("dwell") if isinstance(marks, Mapping) else None
        self._close("dwell", dwell, "measured again, flagged" if flags else "measured again, good")
        if flags:
            self._add(entry, "dwell flagged", f"dwell {dwell}: {flags}", "excluded from the bins")

    def _started(self, entry: Entry) -> None:
        if entry.get("operator"):
            self._add(entry, "command", "start", _by(entry))

    def _resumed(self, entry: Entry) -> None:
        next_step = entry.get("next_step")
        self._close("hold", None, "the run ended during the hold")
        by = f" by {entry['operator']}" if entry.get("operator") else ""
        self._add(entry, "resumed", f"The run was interrupted and resumed{by}.", f"from step {next_step}")

    def _unit_dropped(self, entry: Entry) -> None:
        self._dropped = entry.get("why")  # with which the journal of the unit ends
        self._add(entry, "unit dropped", f"{entry.get('unit')}: {self._dropped}")

    def _ended(self, entry: Entry) -> None:
        if entry.get("ended") != "finished" and entry.get("reason") != self._dropped:
            ending = run_ending(str(entry.get("ended")), str(entry.get("reason")))
            self._add(entry, "ended", f"The run {ending}")


def _by(entry: Entry) -> str:
    return f"by {entry['operator']}" if entry.get("operator") else ""


def _who(entry: Entry) -> str:
    """Source of a command, with the operator's name where it is known and not in the source."""
    by, operator = describe_source(str(entry.get("by"))), str(entry.get("operator") or "")
    return f"{operator} ({by})" if operator and operator not in by else by


def _seconds(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) and abs(value) < _MAX_TIME_S else None


def _grouped(events: Iterable[RunEvent], key: Callable[[RunEvent], object]) -> list[RunEvent]:
    """Group events of the same key at the place of the first."""
    groups: dict[object, RunEvent] = {}
    for each in events:
        first = groups.setdefault(key(each), each)
        if first is not each:
            groups[key(each)] = replace(first, last_s=each.last_s, count=first.count + each.count)
    return list(groups.values())


def _kind_or_itself(kind: str, event: RunEvent) -> object:
    return kind if event.kind == kind else event


def _shape(text: str) -> str:
    """Text without its numbers."""
    return _NUMBERS.sub("…", text)
