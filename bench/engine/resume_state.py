"""Progress of a run: kept up to date by the run, and read from its journal when it resumes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.procedure.approach import RetainedState, index_after_dwell, remaining_steps
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.runs.journal import MAX_RUN_S

#: Source of a continuation without an operator, in the journal.
ITSELF = "itself"
#: Unsafe outputs of a run whose engine and guard both ended without making the bench safe.
_NO_SAFE_STATE = {"safe state": "neither the run nor its guard recorded one"}
#: Stands for the checksum of a compensation in the INS; older journals have "a compensation".
UNKNOWN_CHECKSUM = "checksum unknown"
#: Event of the journal: the operator has dwells measured again.
REPEAT = "repeat_commanded"
#: Larger than in any run; a higher number means a damaged journal.
_MAX_POWER_ONS = 1_000_000


@dataclass
class ResumeState:
    """Progress of a run: empty for a new run, read from the journal for a resumed one; kept up to date."""

    next_index: int = 0  #: first step of the plan that is not finished
    finished: set[int] = field(default_factory=set)  #: dwells that are over
    #: Dwells before ``next_index`` whose data were lost; they are measured again first.
    lost: set[int] = field(default_factory=set)
    #: Of these, dwells that the operator has measured again: until then the earlier measurement counts.
    replaced: set[int] = field(default_factory=set)
    skipped: set[int] = field(default_factory=set)  #: dwells that the operator skipped
    repeats: Counter[int] = field(default_factory=Counter)  #: repeats of each dwell because of invalid data
    #: Continuations without an operator after a trip, by interlock.
    resumes: Counter[str] = field(default_factory=Counter)
    power_ons: int = 0  #: how often the INS was switched on
    unit: str = ""  #: serial number of the INS; empty before it is known
    last_s: float = 0.0  #: time of the last entry, on the run's clock
    ended: str = ""  #: how the run ended; empty if the journal has no end
    reason: str = ""  #: why it did not finish
    #: Safe actions that failed at the end of the run, and why; empty if the bench was made safe.
    unsafe: dict[str, str] = field(default_factory=dict)
    in_progress: str = ""  #: the step in progress at the last entry; empty if there was none
    resumes_without_progress: int = 0  #: resumes since a step was finished
    dropped: dict[str, str] = field(default_factory=dict)  #: dropped units, and why
    #: The operator's decision on each compensation found in the INS.
    stored_compensation_answers: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of_journal(cls, entries: Iterable[Mapping[str, Any]], plan: Plan) -> ResumeState:
        """Read the progress of a run from its journal.

        A dwell without an end although later steps are finished is lost. Raises RunFolderError if the journal
        does not belong to this plan.
        """
        state = cls()
        for entry in entries:
            try:
                state._add(entry, plan)
            except (KeyError, TypeError, ValueError, OverflowError) as error:
                raise RunFolderError(
                    f"the entry {entry.get('event')!r} at {entry.get('time_s')!r} s does not belong to "
                    f"this procedure: {error}"
                ) from error
        passed_dwells = {planned.dwell for planned in plan.steps[: state.next_index] if planned.dwell}
        state.lost |= passed_dwells - state.finished - state.skipped
        return state

    def is_over(self, plan: Plan) -> bool:
        """Whether every step of the plan is finished."""
        return self.resume_index(plan) >= len(plan.steps)

    def resume_index(self, plan: Plan) -> int:
        """Index of the step to resume with: the start of a lost dwell, or the first step not finished."""
        if not self.lost:
            return self.next_index
        return next(i for i, planned in enumerate(plan.steps) if planned.dwell in self.lost)

    def remaining_plan(self, plan: Plan) -> Plan:
        """The remaining steps with their re-approaches, from a bench at room temperature."""
        room_c = plan.steps[0].before.thermal.room_c
        cold = RetainedState(is_ins_on=False, is_at_temperature=False, chamber_c=room_c)
        retained = cold if self.resume_index(plan) else None
        return replace(plan, steps=tuple(remaining_steps(plan, self.next_index, self.lost, retained)))

    def mark_lost(self, dwells: Collection[int]) -> None:
        """Mark finished dwells as lost."""
        self.finished.difference_update(dwells)
        self.lost.update(dwells)

    def finish(self, dwell: int) -> None:
        """Record the end of a dwell."""
        self.finished.add(dwell)
        self.replaced.discard(dwell)

    def skip(self, dwell: int) -> None:
        """Record that a dwell is skipped; if it was to replace a measurement, that one counts."""
        if dwell in self.replaced:
            self.finish(dwell)
        else:
            self.skipped.add(dwell)

    def _repeat(self, dwells: Collection[int], plan: Plan) -> None:
        """Have dwells measured again, and the steps after the last dwell done again."""
        self.replaced |= self.finished.intersection(dwells)
        self.mark_lost(dwells)
        self.skipped.difference_update(dwells)
        for dwell in dwells:
            del self.repeats[dwell]
        self.next_index = min(self.next_index, index_after_dwell(plan, plan.dwell_count))
        self.resumes_without_progress = 0

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
                    self.finish_up_to(step)
            case "dwell_finished":
                dwell = _number(entry["marks"]["dwell"], plan.dwell_count)
                self.finish(dwell)
                self.lost.discard(dwell)
                self.resumes_without_progress = 0
                self.unit = self.unit or str(entry["marks"].get("unit", ""))
                self.finish_up_to(index_after_dwell(plan, dwell))
            case "dwell_skipped":
                dwell = _number(entry["dwell"], plan.dwell_count)
                self.skip(dwell)
                self.lost.discard(dwell)
                self.finish_up_to(index_after_dwell(plan, dwell))
            case "dwell_given_up" if entry["counts"]:
                self.repeats[_number(entry["dwell"], plan.dwell_count)] += 1
            case "continued" if entry.get("by") == ITSELF:
                self.resumes.update(map(str, entry["after"]))
            case "repeat_commanded":  # as REPEAT
                self._repeat([_number(dwell, plan.dwell_count) for dwell in entry["dwells"]], plan)
            case "data_given_up":
                self.mark_lost([_number(dwell, plan.dwell_count) for dwell in entry["dwells"]])
                self.replaced.difference_update(entry["dwells"])
                # A lost line may have held a power-on, whose number must not come twice.
                self.power_ons += _number(entry["lines"] + 1, _MAX_POWER_ONS) - 1
            case "compensation_decided":
                checksum = str(entry["which"]).replace("a compensation", UNKNOWN_CHECKSUM)
                self.stored_compensation_answers[checksum] = str(entry["answer"])
            case "dwell_over":  # in all journals of a run with several units
                self.finish_up_to(index_after_dwell(plan, _number(entry["dwell"], plan.dwell_count)))
            case "unit_dropped":
                self.dropped[str(entry["unit"])] = str(entry["why"])
            case "powered_on":
                self.power_ons = max(self.power_ons, _number(entry["run"], _MAX_POWER_ONS))
            case "ins_identified":
                self.unit = str(entry["unit"])
            case "run_started":
                self.unsafe = dict(_NO_SAFE_STATE)
                if "power_ons" in entry:  # those of the runs that it continues
                    self.unit = str(entry["unit"])
                    self.power_ons = _number(entry["power_ons"], _MAX_POWER_ONS)
            case "guard_acted":
                self._update_unsafe(entry)
            case "run_resumed":
                self.unsafe = dict(_NO_SAFE_STATE)
                self.ended = self.reason = ""
                self.resumes_without_progress += 1
            case "run_ended":
                self.ended, self.reason = str(entry["ended"]), str(entry["reason"])
                self._update_unsafe(entry)

    def _update_unsafe(self, entry: Mapping[str, Any]) -> None:
        problems = {str(action["what"]): str(action["problem"]) for action in entry.get("safe_state", ())}
        earlier_problems = {} if self.unsafe == _NO_SAFE_STATE else self.unsafe
        self.unsafe = {what: problem for what, problem in {**earlier_problems, **problems}.items() if problem}

    def finish_up_to(self, next_index: int) -> None:
        """Record that the steps before ``next_index`` are finished."""
        if next_index > self.next_index:
            self.next_index = next_index
            self.resumes_without_progress = 0


def _time_s(entry: Mapping[str, Any]) -> float:
    time_s = float(entry["time_s"])
    if not 0.0 <= time_s <= MAX_RUN_S:
        raise ValueError(f"{time_s} s is not a time of a run")
    return time_s


def _number(value: Any, max_value: int) -> int:
    if not isinstance(value, int) or not 1 <= value <= max_value:
        raise ValueError(f"{value!r} is not an integer from 1 to {max_value}")
    return value
