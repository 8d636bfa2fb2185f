"""Resuming an interrupted run: what its journal says is finished, and what is left to do."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gyrobench.bench.engine.job import Job, job_in
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.procedure.approach import end_of_dwell
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.procedure.timeline import hours_minutes
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.runs.journal import MAX_RUN_S, read_journal

#: After so many resumes in a row without a finished step the cause has to be found first.
MAX_RESUMES_WITHOUT_PROGRESS = 5
#: How a run ended whose journal has no end.
NO_END_RECORDED = "stopped without recording its end, as after a power cut or a kill"
#: In place of the checksum of a compensation in the INS; older journals have "a compensation".
UNKNOWN_CHECKSUM = "checksum unknown"

#: No run reaches it; a higher number is a damaged journal.
_MAX_POWER_ONS = 1_000_000


@dataclass
class ResumeState:
    """What is known of a run when it resumes: what is finished and stays finished."""

    next_index: int = 0  #: first step of the plan that is not finished
    finished: set[int] = field(default_factory=set)  #: dwells that are over
    skipped: set[int] = field(default_factory=set)  #: dwells that the operator skipped
    repeats: Counter[int] = field(default_factory=Counter)  #: repeats of each dwell because of invalid data
    #: Continuations without an operator after a trip, by interlock.
    resumes: Counter[str] = field(default_factory=Counter)
    power_ons: int = 0  #: how often the INS was switched on
    unit: str = ""  #: serial number of the INS; empty before it is known
    last_s: float = 0.0  #: time of the last entry, on the run's clock
    ended: str = ""  #: how the run ended; empty where the journal has no end
    reason: str = ""  #: why it did not finish
    in_progress: str = ""  #: the step in progress at the last entry; empty where there was none
    resumes_without_progress: int = 0  #: resumes since a step was finished
    #: The operator's decision on each compensation found in the INS.
    stored_compensation_answers: dict[str, str] = field(default_factory=dict)

    def is_over(self, plan: Plan) -> bool:
        """Whether every step of the plan is finished."""
        return self.next_index >= len(plan.steps)

    def _add(self, entry: Mapping[str, Any], plan: Plan) -> None:
        self.last_s = max(self.last_s, _time_s(entry))
        match entry.get("event"):
            case "step_started" | "approach_started":
                self.in_progress = (
                    f"{entry['label']}: {entry['what']}" if entry["label"] else str(entry["what"])
                )
            case "step_finished":
                self.in_progress = ""
                step = _number(entry["step"], len(plan.steps))
                if plan.steps[step - 1].dwell is None:
                    self._finish_up_to(step)
            case "dwell_finished":
                dwell = _number(entry["marks"]["dwell"], plan.dwell_count)
                self.finished.add(dwell)
                self._finish_up_to(end_of_dwell(plan, dwell))
            case "dwell_skipped":
                dwell = _number(entry["dwell"], plan.dwell_count)
                self.skipped.add(dwell)
                self._finish_up_to(end_of_dwell(plan, dwell))
            case "dwell_given_up" if entry["counts"]:
                self.repeats[_number(entry["dwell"], plan.dwell_count)] += 1
            case "continued" if entry.get("by") == "itself":
                self.resumes.update(map(str, entry["after"]))
            case "compensation_decided":
                which = str(entry["which"]).replace("a compensation", UNKNOWN_CHECKSUM)
                self.stored_compensation_answers[which] = str(entry["answer"])
            case "powered_on":
                self.power_ons = _number(entry["run"], _MAX_POWER_ONS)
            case "ins_identified":
                self.unit = str(entry["unit"])
            case "run_resumed":
                self.ended = self.reason = ""
                self.resumes_without_progress += 1
            case "run_ended":
                self.ended, self.reason = str(entry["ended"]), str(entry["reason"])

    def _finish_up_to(self, next_index: int) -> None:
        if next_index > self.next_index:
            self.next_index = next_index
            self.resumes_without_progress = 0


def resume_state_of(entries: Iterable[Mapping[str, Any]], plan: Plan) -> ResumeState:
    """Read from the journal of a run what is finished of its plan.

    Raises RunFolderError if the journal does not belong to this plan, or lacks entries before its last one.
    """
    state = ResumeState()
    for entry in entries:
        try:
            state._add(entry, plan)  # noqa: SLF001 - its own module
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise RunFolderError(
                f"the entry {entry.get('event')!r} at {entry.get('time_s')!r} s does not belong to "
                f"this procedure: {error}"
            ) from error
    done = {planned.dwell for planned in plan.steps[: state.next_index] if planned.dwell}
    if missing := done - state.finished - state.skipped:
        raise RunFolderError(
            f"the end of dwell {', '.join(map(str, sorted(missing)))} is missing, although later steps are "
            "finished. The run can't be resumed; `gyrobench bins` recomputes what it measured"
        )
    return state


def _time_s(entry: Mapping[str, Any]) -> float:
    time_s = float(entry["time_s"])
    if not 0.0 <= time_s <= MAX_RUN_S:
        raise ValueError(f"{time_s} s is not a time of a run")
    return time_s


def _number(value: Any, highest: int) -> int:
    if not isinstance(value, int) or not 1 <= value <= highest:
        raise ValueError(f"{value!r} is not an integer from 1 to {highest}")
    return value


@dataclass(frozen=True)
class Resumption:
    """An interrupted run and its state."""

    job: Job
    folder: RunFolder
    state: ResumeState

    def check_unchanged(self) -> None:
        """Refuse where another process has resumed the run before this one locked it.

        Raises RunFolderError if the journal has changed.
        """
        now = _state_in(self.folder, self.job.plan)
        if replace(now, last_s=self.state.last_s) != self.state:
            raise RunFolderError(
                f"{self.folder.path}: another process has resumed this run in the meantime. Resume it again"
            )

    def describe(self) -> str:
        """Describe what the run folder holds and what resuming it will do."""
        state, plan = self.state, self.job.plan
        how = f"{state.ended}: {state.reason}" if state.ended else NO_END_RECORDED
        lines = [
            f"{self.folder.path}: {plan.procedure.procedure}{f', unit {state.unit}' if state.unit else ''}; "
            f"the run {how}.",
            f"{len(state.finished)} of {plan.dwell_count} dwells are finished and kept"
            f"{f', {len(state.skipped)} were skipped' if state.skipped else ''}.",
        ]
        if state.in_progress:
            lines.append(f"Interrupted step: {state.in_progress}.")
        if state.is_over(plan):
            return "\n".join([*lines, "All steps are finished; only the evaluation is left."])
        planned = plan.steps[state.next_index]
        what = (
            f"dwell {planned.dwell} ({planned.label}) from its start"
            if planned.dwell
            else planned.step.describe()
        )
        left = hours_minutes(plan.duration_s - planned.start_s)
        lines.append(
            f"It resumes with step {planned.number} of {len(plan.steps)}, {what}; about {left} h are left."
        )
        if state.next_index:
            lines.append(
                "Before that the INS is switched off and on, and temperature and position are approached "
                "again."
            )
        return "\n".join(lines)


def prepare_resumption(path: Path, anyway: bool = False) -> Resumption:
    """Read the folder of an interrupted run; ``anyway`` also after many resumes without progress.

    Raises RunFolderError if there is no run, it is finished, or it was resumed too often without progress.
    Raises DocumentError if its procedure, station or DBC file is wrong.
    """
    folder = open_run_folder(path)
    job = job_in(folder)
    state = _state_in(folder, job.plan)
    if state.is_over(job.plan) and state.ended == "finished":
        raise RunFolderError(
            f"{path}: this run is finished, so there is nothing to resume. If tables or the report are "
            f"missing, write them with: gyrobench bins {path}"
        )
    if state.resumes_without_progress >= MAX_RESUMES_WITHOUT_PROGRESS and not anyway:
        raise RunFolderError(
            f"{path}: was resumed {state.resumes_without_progress} times without finishing a step. "
            "Find the cause (see the end of journal.jsonl), then resume it with --anyway"
        )
    return Resumption(job, folder, state)


def _state_in(folder: RunFolder, plan: Plan) -> ResumeState:
    entries = list(read_journal(folder.journal))
    try:
        return resume_state_of(entries, plan)
    except RunFolderError as error:
        raise RunFolderError(f"{folder.journal}: {error}") from error
