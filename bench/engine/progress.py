"""How far a run has come, told by its journal alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.procedure.approach import end_of_dwell
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.runs.journal import MAX_RUN_S

#: What no run reaches; more is a damaged journal.
_MOST_POWER_ONS = 1_000_000
#: Why a run is over that did not say so itself.
WITHOUT_A_WORD = "stopped without a word, as after a power cut or a kill"


@dataclass
class RunProgress:
    """What is done and stays done.

    Attributes
    ----------
    next_index : int
        The first step of the plan that has to be done yet.
    finished, skipped : set of int
        Dwells that are over, and those left out by order.
    repeats : Counter
        How often each dwell was given up to be repeated because its data were spoilt.
    resumes : Counter
        How often the run went on by itself after a trip of each interlock.
    power_ons : int
        How often the INS was switched on.
    unit : str
        Serial number of the INS; empty before it is known.
    last_s : float
        Time of the last entry, on the run's clock.
    ended, reason : str
        How the run ended; both empty where it just stopped.
    under_way : str
        The step that was under way at the last entry, in words; empty where none was.
    resumed_in_vain : int
        How often it was resumed since anything was finished.
    decided : dict of str to str
        What the operator decided about compensations that the INS had of its own.
    """

    next_index: int = 0
    finished: set[int] = field(default_factory=set)
    skipped: set[int] = field(default_factory=set)
    repeats: Counter[int] = field(default_factory=Counter)
    resumes: Counter[str] = field(default_factory=Counter)
    power_ons: int = 0
    unit: str = ""
    last_s: float = 0.0
    ended: str = ""
    reason: str = ""
    under_way: str = ""
    resumed_in_vain: int = 0
    decided: dict[str, str] = field(default_factory=dict)

    def is_over(self, plan: Plan) -> bool:
        """Whether nothing is left to be done."""
        return self.next_index >= len(plan.steps)


def progress_of(entries: Iterable[Mapping[str, Any]], plan: Plan) -> RunProgress:
    """Read the progress of a run of ``plan`` out of its journal.

    Raises
    ------
    RunFolderError
        The journal is not one of this plan, or lacks entries before its last one.
    """
    progress = RunProgress()
    for entry in entries:
        try:
            _take(progress, entry, plan)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise RunFolderError(
                f"the entry {entry.get('event')!r} at {entry.get('time_s')!r} s does not belong to "
                f"this procedure: {error}"
            ) from error
    done = {planned.dwell for planned in plan.steps[: progress.next_index] if planned.dwell}
    if lost := done - progress.finished - progress.skipped:
        raise RunFolderError(
            f"lacks the end of dwell {', '.join(map(str, sorted(lost)))}, although what comes after is done: "
            "lines are missing. The run can't be resumed; `gyrobench bins` still tells what it measured"
        )
    return progress


def _take(progress: RunProgress, entry: Mapping[str, Any], plan: Plan) -> None:
    progress.last_s = max(progress.last_s, _time_s(entry))
    match entry.get("event"):
        case "step_started" | "approach_started":
            progress.under_way = (
                f"{entry['label']}: {entry['what']}" if entry["label"] else str(entry["what"])
            )
        case "step_finished":
            progress.under_way = ""
            step = _whole(entry["step"], len(plan.steps))
            if plan.steps[step - 1].dwell is None:
                _settle(progress, step)
        case "dwell_finished":
            dwell = _whole(entry["marks"]["dwell"], plan.dwell_count)
            progress.finished.add(dwell)
            _settle(progress, end_of_dwell(plan, dwell))
        case "dwell_skipped":
            dwell = _whole(entry["dwell"], plan.dwell_count)
            progress.skipped.add(dwell)
            _settle(progress, end_of_dwell(plan, dwell))
        case "dwell_given_up" if entry["counts"]:
            progress.repeats[_whole(entry["dwell"], plan.dwell_count)] += 1
        case "continued" if entry.get("by") == "itself":
            progress.resumes.update(map(str, entry["after"]))
        case "compensation_decided":
            progress.decided[str(entry["which"])] = str(entry["answer"])
        case "powered_on":
            progress.power_ons = _whole(entry["run"], _MOST_POWER_ONS)
        case "ins_identified":
            progress.unit = str(entry["unit"])
        case "run_resumed":
            progress.ended = progress.reason = ""
            progress.resumed_in_vain += 1
        case "run_ended":
            progress.ended, progress.reason = str(entry["ended"]), str(entry["reason"])


def _time_s(entry: Mapping[str, Any]) -> float:
    time_s = float(entry["time_s"])
    if not 0.0 <= time_s <= MAX_RUN_S:
        raise ValueError(f"{time_s} s is no time of a run")
    return time_s


def _whole(value: Any, most: int) -> int:
    if not isinstance(value, int) or not 1 <= value <= most:
        raise ValueError(f"{value!r} is no whole number from 1 to {most}")
    return value


def _settle(progress: RunProgress, next_index: int) -> None:
    if next_index > progress.next_index:
        progress.next_index = next_index
        progress.resumed_in_vain = 0
