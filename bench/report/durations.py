"""Planned against real duration, by kind of step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

#: Planned and real duration, s, of every step done, by kind.
Took = Mapping[str, Sequence[tuple[float, float]]]


@dataclass(frozen=True)
class KindDuration:
    """What the steps of one kind were to take together, and took.

    Attributes
    ----------
    kind : str
        Name of the kind for people: "go to".
    count : int
        Steps done.
    planned_s, took_s : float
        Sums over these.
    """

    kind: str
    count: int
    planned_s: float
    took_s: float

    @property
    def difference(self) -> str:
        """How much more it took than planned: "+0:12:05", and in percent of the plan."""
        late_s = self.took_s - self.planned_s
        text = f"{'-' if round(late_s) < 0 else '+'}{clock_time(abs(late_s))}"
        return f"{text} ({100.0 * late_s / self.planned_s:+.1f} %)" if self.planned_s > 0.0 else text


def durations_by_kind(took: Took) -> list[KindDuration]:
    """Sum up by kind, what took longest first, and all together at the end; empty if nothing was done."""
    kinds = [_summed(kind.replace("_", " "), pairs) for kind, pairs in took.items() if pairs]
    kinds.sort(key=lambda each: -each.took_s)
    everything = [pair for pairs in took.values() for pair in pairs]
    return [*kinds, _summed("all", everything)] if kinds else []


def took_in_journal(journal: Iterable[Mapping[str, Any]]) -> dict[str, list[tuple[float, float]]]:
    """Gather the durations of the steps that a journal tells the end of."""
    took: dict[str, list[tuple[float, float]]] = {}
    for entry in journal:
        if entry.get("event") == "step_finished" and {"kind", "planned_s", "took_s"} <= entry.keys():
            pair = (float(entry["planned_s"]), float(entry["took_s"]))
            took.setdefault(str(entry["kind"]), []).append(pair)
    return took


def clock_time(duration_s: float) -> str:
    """Write a duration as h:mm:ss, to the nearest second."""
    seconds = round(duration_s)
    return f"{seconds // 3600}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"


def _summed(kind: str, pairs: Sequence[tuple[float, float]]) -> KindDuration:
    return KindDuration(kind, len(pairs), sum(pair[0] for pair in pairs), sum(pair[1] for pair in pairs))
