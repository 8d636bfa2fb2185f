"""Resuming an interrupted run: the finished steps according to its journal, and the remaining ones."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gyrobench.bench.engine.damage import Damage, find_damage
from gyrobench.bench.engine.job import Job, read_job
from gyrobench.bench.foundations.clock import RESUME_STEP_S, Clock, VirtualClock, WallClock
from gyrobench.bench.foundations.errors import (
    GyrobenchError,
    InstrumentError,
    RunFinishedError,
    RunFolderError,
)
from gyrobench.bench.foundations.text import hours_minutes, listed, run_ending
from gyrobench.bench.procedure.approach import index_after_dwell
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.runs.folder import UNITS_FOLDER, RunFolder, open_run_folder
from gyrobench.bench.runs.journal import MAX_RUN_S
from gyrobench.bench.runs.locks import RunLock
from gyrobench.bench.runs.provenance import identities_in, start_from_journal, started_utc
from gyrobench.bench.runs.seal import require_sealed_inputs
from gyrobench.bench.runs.telemetry import last_reading_s
from gyrobench.bench.station.bench_lock import BenchLock
from gyrobench.bench.station.instruments import Outputs
from gyrobench.bench.station.station import Station
from gyrobench.drivers.chamber import running_profile

#: After this number of successive resumes without a finished step, the cause has to be found first.
MAX_RESUMES_WITHOUT_PROGRESS = 5
#: Source of a continuation without an operator, in the journal.
ITSELF = "itself"
#: Description of the end of a run whose journal has no end.
NO_END_RECORDED = "stopped without recording its end, as after a power cut or a kill"
#: Unsafe outputs of a run whose engine and guard both ended without making the bench safe.
_NO_SAFE_STATE = {"safe state": "neither the run nor its guard recorded one"}
#: Stands for the checksum of a compensation in the INS; older journals have "a compensation".
UNKNOWN_CHECKSUM = "checksum unknown"

#: Larger than in any run; a higher number means a damaged journal.
_MAX_POWER_ONS = 1_000_000


@dataclass
class ResumeState:
    """Progress of a run: empty for a new run, read from the journal for a resumed one; kept up to date."""

    next_index: int = 0  #: first step of the plan that is not finished
    finished: set[int] = field(default_factory=set)  #: dwells that are over
    #: Dwells before ``next_index`` whose data were lost; they are measured again first.
    lost: set[int] = field(default_factory=set)
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

    def is_over(self, plan: Plan) -> bool:
        """Whether every step of the plan is finished."""
        return self.resume_index(plan) >= len(plan.steps)

    def resume_index(self, plan: Plan) -> int:
        """Index of the step to resume with: the start of a lost dwell, or the first step not finished."""
        if not self.lost:
            return self.next_index
        return next(i for i, planned in enumerate(plan.steps) if planned.dwell in self.lost)

    def mark_lost(self, dwells: Collection[int]) -> None:
        """Mark finished dwells as lost."""
        self.finished.difference_update(dwells)
        self.lost.update(dwells)

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
                self.finished.add(dwell)
                self.lost.discard(dwell)
                self.unit = self.unit or str(entry["marks"].get("unit", ""))
                self.finish_up_to(index_after_dwell(plan, dwell))
            case "dwell_skipped":
                dwell = _number(entry["dwell"], plan.dwell_count)
                self.skipped.add(dwell)
                self.lost.discard(dwell)
                self.finish_up_to(index_after_dwell(plan, dwell))
            case "dwell_given_up" if entry["counts"]:
                self.repeats[_number(entry["dwell"], plan.dwell_count)] += 1
            case "continued" if entry.get("by") == ITSELF:
                self.resumes.update(map(str, entry["after"]))
            case "data_given_up":
                self.mark_lost([_number(dwell, plan.dwell_count) for dwell in entry["dwells"]])
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


def resume_state_of(entries: Iterable[Mapping[str, Any]], plan: Plan) -> ResumeState:
    """Read the progress of a run from its journal.

    A dwell without an end although later steps are finished is lost. Raises RunFolderError if the journal
    does not belong to this plan.
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
    passed_dwells = {planned.dwell for planned in plan.steps[: state.next_index] if planned.dwell}
    state.lost |= passed_dwells - state.finished - state.skipped
    return state


def _time_s(entry: Mapping[str, Any]) -> float:
    time_s = float(entry["time_s"])
    if not 0.0 <= time_s <= MAX_RUN_S:
        raise ValueError(f"{time_s} s is not a time of a run")
    return time_s


def _number(value: Any, max_value: int) -> int:
    if not isinstance(value, int) or not 1 <= value <= max_value:
        raise ValueError(f"{value!r} is not an integer from 1 to {max_value}")
    return value


@dataclass(frozen=True)
class InterruptedRun:
    """An interrupted run, or the run of one of its units, read from its folder."""

    folder: RunFolder
    plan: Plan
    state: ResumeState
    number: str  #: serial number of the unit; empty for the run as a whole
    damage: Damage = field(default_factory=Damage)  #: discarded before the run resumes


@dataclass(frozen=True)
class Resumption:
    """An interrupted run, its units and their states."""

    job: Job
    run: InterruptedRun
    #: Each unit in the order of the station file, including dropped ones; ``run`` for a single unit.
    units: tuple[InterruptedRun, ...]
    is_measured: bool = False  #: whether only results and report remain to be written

    @property
    def folder(self) -> RunFolder:
        """The run folder."""
        return self.run.folder

    @property
    def state(self) -> ResumeState:
        """State of the run as a whole."""
        return self.run.state

    @property
    def parts(self) -> tuple[InterruptedRun, ...]:
        """The run and its units, without duplicates."""
        return self.units if self.run in self.units else (self.run, *self.units)

    @property
    def damage(self) -> Damage:
        """Damage of the run and of all units."""
        return Damage.of_all([part.damage for part in self.parts])

    def clock(self) -> Clock:
        """Create the run's clock, continuing after its last record."""
        last_s = max(self.state.last_s, last_reading_s(self.folder.telemetry))
        if self.job.is_virtual:
            return VirtualClock(last_s + RESUME_STEP_S)
        return WallClock.resumed(started_utc(self.folder), last_s, self.job.station.file.speed)

    def check_unchanged(self) -> None:
        """Raise RunFolderError if the journal has changed.

        Another process may have resumed the run before this one locked it.
        """
        current = _read(self.folder, self.job, {part.number: part.damage for part in self.parts})
        if any(
            replace(new.state, last_s=old.state.last_s) != old.state
            for new, old in zip((current.run, *current.units), (self.run, *self.units), strict=True)
        ):
            raise RunFolderError(
                f"{self.folder.path}: another process has resumed this run in the meantime. Resume it again"
            )

    def describe_bench(self) -> str:
        """Describe a bench that was not made safe, and what it reads now; empty if it was made safe."""
        if not self.state.unsafe or self.job.is_virtual:
            return ""
        problems = "; ".join(f"{what}: {problem}" for what, problem in self.state.unsafe.items())
        lines = [f"The bench was NOT made safe at the end ({problems}). It reads now:"]
        station = self.job.station
        clock = station.new_clock()
        try:
            with (
                BenchLock(station, self.folder.path, clock),
                Outputs(station, clock, identities=identities_in(self.folder)) as outputs,
            ):
                for describe_now in (_table_now, _chamber_now):
                    try:
                        lines.append(describe_now(station, outputs))
                    except InstrumentError as error:
                        lines.append(str(error))
        except GyrobenchError as error:
            lines.append(f"Not read: {error}")
        return "\n".join(lines)

    def describe(self) -> str:
        """Describe the contents of the run folder and what resuming the run will do."""
        state, plan = self.state, self.job.plan
        unit_names = [part.state.unit or part.number for part in self.units]
        units = (
            f", {'unit' if len(unit_names) == 1 else 'units'} {listed(unit_names)}" if all(unit_names) else ""
        )
        ending = run_ending(state.ended, state.reason) if state.ended else NO_END_RECORDED
        lines = [
            f"{self.folder.path}: {plan.procedure.procedure}{units}; the run {ending.removesuffix('.')}.",
            f"{len(state.finished)} of {plan.dwell_count} dwells are finished and kept"
            f"{f', {len(state.skipped)} skipped' if state.skipped else ''}.",
        ]
        if not state.unsafe:
            lines.append("The bench was brought to its safe state.")
        lines += [
            f"Unit {number} was dropped and is not measured: {reason}"
            for number, reason in state.dropped.items()
        ]
        if state.in_progress:
            lines.append(f"Interrupted step: {state.in_progress}.")
        lines += self.damage.describe()
        if state.is_over(plan):
            remaining = "the results and the report remain" if self.is_measured else "the evaluation remains"
            return "\n".join([*lines, f"All steps are finished; only {remaining} to be done."])
        planned = plan.steps[state.resume_index(plan)]
        start = (
            f"dwell {planned.dwell} ({planned.label}) from its start"
            if planned.dwell
            else planned.step.describe()
        )
        remaining_h = hours_minutes(plan.duration_s - planned.start_s)
        lines.append(
            f"It resumes with step {planned.number} of {len(plan.steps)}, {start}; about {remaining_h} h "
            "remain."
        )
        if state.lost:
            numbers = listed([str(dwell) for dwell in sorted(state.lost)])
            lines.append(f"Measured again, before step {state.next_index + 1}: dwell {numbers}.")
        if state.next_index:
            lines.append(
                "Before that the INS is switched off and on, and temperature and position are approached "
                "again."
            )
        return "\n".join(lines)


def _table_now(station: Station, outputs: Outputs) -> str:
    reading = outputs.table.read()
    axes = zip(
        ("outer", "inner"),
        station.table_axes_of(reading.position_deg),
        station.table_axes_of(reading.rate_dps),
        strict=True,
    )
    motion = ", ".join(f"{axis} {angle:.3f} deg at {rate:.3f} deg/s" for axis, angle, rate in axes)
    return f"rate table: {motion}; servos {'on' if reading.is_servoed else 'off'}"


def _chamber_now(station: Station, outputs: Outputs) -> str:  # noqa: ARG001 - as for the table
    reading = outputs.chamber.read()
    set_c = "unknown" if reading.set_point_c is None else f"{reading.set_point_c:.1f} degC"
    state = "" if reading.is_on is None else ", on" if reading.is_on else ", off"
    profile = running_profile(outputs.chamber)
    runs = f", runs {profile}" if profile else ""
    return f"chamber: air {reading.temperature_c:.1f} degC, set point {set_c}{state}{runs}"


def prepare_resumption(path: Path, anyway: bool = False) -> Resumption:
    """Read the folder of an interrupted run; ``anyway``: also after many resumes without progress.

    Raises RunFinishedError if it is finished. Raises RunFolderError if there is no run, or it was resumed too
    often without progress. Raises DocumentError if its procedure, station or DBC file is wrong.
    """
    folder = open_run_folder(path, may_have_units=True)
    if folder.path.absolute().parent.name == UNITS_FOLDER:
        raise RunFolderError(
            f"{path}: is a unit of the run {folder.path.absolute().parents[1]}. Resume that run instead"
        )
    damage, entries = find_damage(folder)
    job = read_job(folder, start_from_journal(folder, entries)[1] if damage.is_provenance_lost else None)
    require_sealed_inputs(folder)
    resumption = _read(folder, job)
    state = resumption.state
    if all(unit.number in state.dropped for unit in resumption.units):
        raise RunFolderError(f"{path}: every unit of this run was dropped: nothing to resume.")
    is_measured = state.ended == "finished" and state.is_over(job.plan)
    if is_measured and not resumption.damage and all(_is_evaluated(unit.folder) for unit in resumption.units):
        raise RunFinishedError(f"{path}: this run is finished and has its report: nothing to resume.")
    if state.resumes_without_progress >= MAX_RESUMES_WITHOUT_PROGRESS and not anyway:
        raise RunFolderError(
            f"{path}: was resumed {state.resumes_without_progress} times without finishing a step. "
            "Find the cause (see the end of journal.jsonl), then resume it with --anyway"
        )
    return replace(resumption, is_measured=is_measured)


def _read(folder: RunFolder, job: Job, damaged: Mapping[str, Damage] | None = None) -> Resumption:
    """Read the progress of a run and of its units.

    ``damaged``: damage by the number of the unit, if it is already known.
    """
    stations = job.station.units
    run = _read_one(folder, job.plan, "", damaged, has_dwells=len(stations) == 1)
    if len(stations) == 1:
        return Resumption(job, run, (run,))
    units = tuple(
        _read_one(folder.unit(unit.number), job.plan_of(unit), unit.number, damaged) for unit in stations
    )
    _join(run, [unit.state for unit in units if unit.number not in run.state.dropped])
    return Resumption(job, run, units)


def _read_one(
    folder: RunFolder, plan: Plan, number: str, damaged: Mapping[str, Damage] | None, has_dwells: bool = True
) -> InterruptedRun:
    if number and not folder.journal.is_file():  # of a process that was killed before anything moved
        return InterruptedRun(folder, plan, ResumeState(), number)
    damage, entries = find_damage(folder, is_log_read=damaged is None)
    try:
        state = resume_state_of(entries, plan)
    except RunFolderError as error:
        raise RunFolderError(f"{folder.journal}: {error}") from error
    if not has_dwells:
        state.lost.clear()
    if damaged is None:
        given_up = (entry["dwells"] for entry in entries if entry.get("event") == "data_given_up")
        lost = state.lost.difference(*given_up)
        damage = replace(damage, dwells=(*damage.dwells, *sorted(lost)))
    else:
        damage = damaged[number]
    state.mark_lost(damage.dwells)
    return InterruptedRun(folder, plan, state, number, damage)


def _join(run: InterruptedRun, units: Sequence[ResumeState]) -> None:
    """Complete the state of a run from the states of its units."""
    state = run.state
    state.finished = set.intersection(*(unit.finished for unit in units)) if units else set()
    for dwell in state.finished:
        state.finish_up_to(index_after_dwell(run.plan, dwell))
    passed_dwells = {planned.dwell for planned in run.plan.steps[: state.next_index] if planned.dwell}
    state.lost = passed_dwells - state.finished - state.skipped
    state.power_ons = max([state.power_ons, *(unit.power_ons for unit in units)])


def give_up_damage(resumption: Resumption) -> None:
    """Move damaged files aside, and record in the journal which dwells are measured again.

    Raises BenchInUseError if another process holds the run. Raises RunFolderError if a file can't be
    written.
    """
    folder = resumption.folder
    with RunLock(folder.path, VirtualClock()):
        resumption.check_unchanged()
        for part in resumption.parts:
            if part.damage:
                part.damage.give_up(part.folder, resumption.clock)


def _is_evaluated(folder: RunFolder) -> bool:
    """Whether results and report were written after the run's end."""
    try:
        end_s = folder.journal.stat().st_mtime
        return all(path.stat().st_mtime >= end_s for path in (folder.acceptance, folder.report))
    except OSError:
        return False
