"""Resuming an interrupted run: what its folder holds, and what remains to be done."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.engine.damage import Damage, find_damage
from gyrobench.bench.engine.job import Job, read_job
from gyrobench.bench.engine.resume_state import REPEAT, ResumeState
from gyrobench.bench.foundations.clock import RESUME_STEP_S, Clock, VirtualClock, WallClock
from gyrobench.bench.foundations.errors import (
    DocumentError,
    GyrobenchError,
    InstrumentError,
    RunFinishedError,
    RunFolderError,
)
from gyrobench.bench.foundations.operator_name import operator_name
from gyrobench.bench.foundations.text import flag_text, hours_minutes, listed, plural, run_ending
from gyrobench.bench.procedure.approach import index_after_dwell
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.runs.folder import UNITS_FOLDER, RunFolder, open_run_folder
from gyrobench.bench.runs.journal import Journal, read_journal
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
#: Description of the end of a run whose journal has no end.
NO_END_RECORDED = "stopped without recording its end, as after a power cut or a kill"


@dataclass(frozen=True)
class InterruptedRun:
    """An interrupted run, or the run of one of its units, read from its folder."""

    folder: RunFolder
    plan: Plan
    progress: ResumeState
    number: str  #: serial number of the unit; empty for the run as a whole
    damage: Damage = field(default_factory=Damage)  #: discarded before the run resumes


@dataclass(frozen=True)
class Resumption:
    """An interrupted run, its units and their progress."""

    job: Job
    run: InterruptedRun
    #: Each unit in the order of the station file, including dropped ones; ``run`` for a single unit.
    units: tuple[InterruptedRun, ...]
    is_measured: bool = False  #: whether only results and report remain to be written
    #: Dwells that the operator commands to measure again, with the reason, by the number of the unit;
    #: recorded in the journals when the run resumes.
    repeats: Mapping[str, Mapping[int, str]] = field(default_factory=dict)

    @property
    def folder(self) -> RunFolder:
        """The run folder."""
        return self.run.folder

    @property
    def progress(self) -> ResumeState:
        """Progress of the run as a whole."""
        return self.run.progress

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
        last_s = max(self.progress.last_s, last_reading_s(self.folder.telemetry))
        if self.job.is_virtual:
            return VirtualClock(last_s + RESUME_STEP_S)
        return WallClock.resumed(started_utc(self.folder), last_s, self.job.station.file.speed)

    def check_unchanged(self) -> None:
        """Raise RunFolderError if the journal has changed.

        Another process may have resumed the run before this one locked it.
        """
        current = _read(self.folder, self.job, self._damages, self.repeats)
        if any(
            replace(new.progress, last_s=old.progress.last_s) != old.progress
            for new, old in zip((current.run, *current.units), (self.run, *self.units), strict=True)
        ):
            raise RunFolderError(
                f"{self.folder.path}: another process has resumed this run in the meantime. Resume it again"
            )

    @property
    def _damages(self) -> dict[str, Damage]:
        return {part.number: part.damage for part in self.parts}

    def with_repeats(self, selection: Sequence[str]) -> Resumption:
        """The resumption that also measures dwells again.

        ``selection``: numbers of dwells, "flagged", "skipped", or "plateaus" for all dwells of the plateaus
        with a flagged or skipped one. Raises DocumentError for another word, and if a dwell was neither
        measured nor skipped.
        """
        parts = [part for part in self.units if part.number not in self.progress.dropped]
        repeats = {part.number: _selected_dwells(part, selection) for part in parts}
        repeats[""] = {dwell: reason for each in repeats.values() for dwell, reason in each.items()}
        return _read(self.folder, self.job, self._damages, repeats)

    def record_repeats(self, clock: Clock) -> None:
        """Record the dwells to measure again in the journals."""
        for part in self.parts:
            if dwells := self.repeats.get(part.number):
                with Journal(part.folder.journal, clock) as journal:
                    journal.record(
                        REPEAT, dwells=list(dwells), why=list(dwells.values()), operator=operator_name()
                    )

    def describe_bench(self) -> str:
        """Describe a bench that was not made safe, and what it reads now; empty if it was made safe."""
        if not self.progress.unsafe or self.job.is_virtual:
            return ""
        problems = "; ".join(f"{what}: {problem}" for what, problem in self.progress.unsafe.items())
        lines = [f"The bench was NOT made safe at the end ({problems}). It reads now:"]
        station = self.job.station
        clock = station.new_clock()
        try:
            with (
                BenchLock(station, self.folder.path, clock),
                Outputs(station, clock, identities=identities_in(self.folder)) as outputs,
            ):
                for describe_now in (partial(_table_now, station), _chamber_now):
                    try:
                        lines.append(describe_now(outputs))
                    except InstrumentError as error:
                        lines.append(str(error))
        except GyrobenchError as error:
            lines.append(f"Not read: {error}")
        return "\n".join(lines)

    def describe(self) -> str:
        """Describe the contents of the run folder and what resuming the run will do."""
        progress, plan = self.progress, self.job.plan
        unit_names = [part.progress.unit or part.number for part in self.units]
        units = (
            f", {'unit' if len(unit_names) == 1 else 'units'} {listed(unit_names)}" if all(unit_names) else ""
        )
        ending = run_ending(progress.ended, progress.reason) if progress.ended else NO_END_RECORDED
        lines = [
            f"{self.folder.path}: {plan.procedure.procedure}{units}; the run {ending.removesuffix('.')}.",
            f"{len(progress.finished | progress.replaced)} of {plan.dwell_count} dwells are finished and kept"
            f"{f', {len(progress.skipped)} skipped' if progress.skipped else ''}.",
        ]
        if not progress.unsafe:
            lines.append("The bench was brought to its safe state.")
        lines += [
            f"Unit {number} was dropped and is not measured: {reason}"
            for number, reason in progress.dropped.items()
        ]
        if progress.in_progress:
            lines.append(f"Interrupted step: {progress.in_progress}.")
        lines += self.damage.describe()
        if progress.is_over(plan):
            remaining = "the results and the report remain" if self.is_measured else "the evaluation remains"
            return "\n".join([*lines, f"All steps are finished; only {remaining} to be done."])
        planned = plan.steps[progress.resume_index(plan)]
        start = planned.step.describe()
        if planned.dwell:
            start = f"dwell {planned.dwell} ({planned.label}) from its start"
        remaining_h = hours_minutes(progress.remaining_plan(plan).duration_s)
        lines.append(
            f"It resumes with step {planned.number} of {len(plan.steps)}, {start}; about {remaining_h} h "
            "remain."
        )
        if progress.lost:
            reasons = self.repeats.get("", {})
            numbers = [
                f"{dwell} ({reason})" if (reason := reasons.get(dwell)) else str(dwell)
                for dwell in sorted(progress.lost)
            ]
            next_step = (
                f", before step {progress.next_index + 1}" if progress.next_index < len(plan.steps) else ""
            )
            until = " Until then the earlier measurements count." if progress.replaced else ""
            dwells = plural(len(numbers), "dwell", "dwells")
            lines.append(f"Measured again{next_step}: {dwells} {listed(numbers)}.{until}")
            if any(0 < len(plateau.intersection(reasons)) < len(plateau) for plateau in _plateaus(plan)):
                lines.append(
                    "They belong to another power cycle than the other dwells of their plateaus, and are not "
                    "compared with these. --repeat plateaus measures whole plateaus again."
                )
        if progress.next_index:
            is_always_on = self.job.station.file.unit.power == "always_on"
            power = "" if is_always_on else "the INS is switched off and on, and "
            lines.append(f"Before that {power}temperature and position are approached again.")
            if is_always_on:
                lines.append("The INS stays on, but may have restarted: a new power cycle is counted.")
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


def _chamber_now(outputs: Outputs) -> str:
    reading = outputs.chamber.read()
    set_c = "unknown" if reading.set_point_c is None else f"{reading.set_point_c:.1f} degC"
    state = "" if reading.is_on is None else ", on" if reading.is_on else ", off"
    profile = running_profile(outputs.chamber)
    runs = f", runs {profile}" if profile else ""
    return f"chamber: air {reading.temperature_c:.1f} degC, set point {set_c}{state}{runs}"


def prepare_resumption(path: Path, anyway: bool = False, repeat: Sequence[str] = ()) -> Resumption:
    """Read the folder of an interrupted run; ``anyway``: also after many resumes without progress.

    ``repeat``: dwells to measure again, as in :meth:`Resumption.with_repeats`, also in a finished run.

    Raises RunFinishedError if it is finished. Raises RunFolderError if there is no run, or it was resumed too
    often without progress. Raises DocumentError if its procedure, station or DBC file is wrong, or ``repeat``
    is.
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
    if repeat:
        resumption = resumption.with_repeats(repeat)
    progress = resumption.progress
    if all(unit.number in progress.dropped for unit in resumption.units):
        raise RunFolderError(f"{path}: every unit of this run was dropped: nothing to resume.")
    is_measured = progress.ended == "finished" and progress.is_over(job.plan)
    if is_measured and not resumption.damage and all(_is_evaluated(unit.folder) for unit in resumption.units):
        reasons = "flagged or skipped" if "plateaus" in repeat else " or ".join(repeat)
        nothing = f"no dwell is {reasons}" if repeat else "nothing to resume"
        raise RunFinishedError(f"{path}: this run is finished and has its report: {nothing}.")
    if progress.resumes_without_progress >= MAX_RESUMES_WITHOUT_PROGRESS and not anyway:
        raise RunFolderError(
            f"{path}: was resumed {progress.resumes_without_progress} times without finishing a step. "
            "Find the cause (see the end of journal.jsonl), then resume it with --anyway"
        )
    return replace(resumption, is_measured=is_measured)


def _read(
    folder: RunFolder,
    job: Job,
    damaged: Mapping[str, Damage] | None = None,
    repeats: Mapping[str, Mapping[int, str]] = MappingProxyType({}),
) -> Resumption:
    """Read the progress of a run and of its units.

    ``damaged``: damage by the number of the unit, if it is already known. ``repeats``: as in
    :class:`Resumption`.
    """
    stations = job.station.units
    read_one = partial(_read_one, damaged=damaged, repeats=repeats)
    run = read_one(folder, job.plan, "", has_dwells=len(stations) == 1)
    if len(stations) == 1:
        return Resumption(job, run, (run,), repeats=repeats)
    units = tuple(read_one(folder.unit(unit.number), job.plan_of(unit), unit.number) for unit in stations)
    _join(run, [unit.progress for unit in units if unit.number not in run.progress.dropped])
    return Resumption(job, run, units, repeats=repeats)


def _read_one(
    folder: RunFolder,
    plan: Plan,
    number: str,
    damaged: Mapping[str, Damage] | None,
    repeats: Mapping[str, Mapping[int, str]],
    has_dwells: bool = True,
) -> InterruptedRun:
    if number and not folder.journal.is_file():  # of a process that was killed before anything moved
        return InterruptedRun(folder, plan, ResumeState(), number)
    damage, entries = find_damage(folder, is_log_read=damaged is None)
    if repeat := repeats.get(number):
        entries.append({"time_s": 0.0, "event": REPEAT, "dwells": list(repeat)})
    try:
        progress = ResumeState.of_journal(entries, plan)
    except RunFolderError as error:
        raise RunFolderError(f"{folder.journal}: {error}") from error
    if not has_dwells:
        progress.lost.clear()
    if damaged is None:
        recorded = (entry["dwells"] for entry in entries if entry.get("event") in ("data_given_up", REPEAT))
        lost = progress.lost.difference(*recorded)
        damage = replace(damage, dwells=(*damage.dwells, *sorted(lost)))
    else:
        damage = damaged[number]
    progress.mark_lost(damage.dwells)
    return InterruptedRun(folder, plan, progress, number, damage)


def _join(run: InterruptedRun, units: Sequence[ResumeState]) -> None:
    """Complete the state of a run from the progress of its units."""
    progress = run.progress
    progress.finished = set.intersection(*(unit.finished for unit in units)) if units else set()
    for dwell in progress.finished:
        progress.finish_up_to(index_after_dwell(run.plan, dwell))
    passed_dwells = {planned.dwell for planned in run.plan.steps[: progress.next_index] if planned.dwell}
    progress.lost = passed_dwells - progress.finished - progress.skipped
    measured = set.intersection(*(unit.finished | unit.replaced for unit in units)) if units else set()
    progress.replaced = progress.lost & measured
    progress.power_ons = max([progress.power_ons, *(unit.power_ons for unit in units)])


def _plateaus(plan: Plan) -> list[set[int]]:
    """Numbers of the dwells of each plateau."""
    planned = [step for step in plan.steps if step.dwell]
    groups = itertools.groupby(planned, key=lambda step: step.plateau)
    return [{step.dwell or 0 for step in steps} for _, steps in groups]


def _selected_dwells(part: InterruptedRun, selection: Sequence[str]) -> dict[int, str]:
    """Dwells of a run or a unit to measure again, with the reason; without one if it has no flags."""
    entries = read_journal(part.folder.journal)
    finished = [entry for entry in entries if entry.get("event") == "dwell_finished"]
    flagged = {int(entry["marks"]["dwell"]): str(entry.get("flags", "")) for entry in finished}
    rows = read_dwells(part.folder.dwells) if part.folder.dwells.is_file() else []
    flagged |= {row.dwell: flag_text(row.flags) for row in rows}
    skipped = part.progress.skipped - part.progress.finished
    reasons = {dwell: f"flagged: {flags}" for dwell, flags in flagged.items() if flags}
    reasons |= dict.fromkeys(skipped, "skipped")
    known, selected = {*flagged, *skipped}, set()
    for each in selection:
        if each in ("flagged", "skipped"):
            selected |= {dwell for dwell, reason in reasons.items() if reason.startswith(each)}
        elif each == "plateaus":
            for plateau in _plateaus(part.plan):
                selected |= set() if plateau.isdisjoint(reasons) else plateau & known
        elif not each.isdecimal():
            raise DocumentError(f"--repeat {each}: give flagged, skipped, plateaus, or numbers of dwells")
        elif int(each) in known:
            selected.add(int(each))
        else:
            raise DocumentError(
                f"{part.folder.path}: dwell {each} was neither measured nor skipped. Choose from dwell "
                f"{listed([str(dwell) for dwell in sorted(known)])}"
            )
    return {dwell: reasons.get(dwell, "") for dwell in sorted(selected)}


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
