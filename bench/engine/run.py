"""A run from its job to a run folder with results: new, or resumed; and its messages to people elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.dwells.live_estimate import compile_estimator
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup, measurement_setup
from gyrobench.bench.dwells.run_dwells import measure_recorded
from gyrobench.bench.dwells.run_results import evaluate_run
from gyrobench.bench.dwells.run_rotations import compile_calibration
from gyrobench.bench.engine.engine import Engine
from gyrobench.bench.engine.job import Job
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.observers import ObservedOperator, ObserverGroup, RunObserver
from gyrobench.bench.engine.operator import CommandQueue, Operator
from gyrobench.bench.engine.resume import ResumeState, Resumption, prepare_resumption
from gyrobench.bench.engine.run_context import RunContext, UnitRun
from gyrobench.bench.engine.run_notifier import RunNotifier
from gyrobench.bench.engine.run_outcome import RunOutcome
from gyrobench.bench.foundations.clock import Clock, WallClock
from gyrobench.bench.foundations.errors import GyrobenchError, InstrumentError, RunFolderError
from gyrobench.bench.foundations.files import make_folder, write_whole
from gyrobench.bench.foundations.kernels import Kernel
from gyrobench.bench.foundations.operator_name import operator_name
from gyrobench.bench.foundations.text import listed
from gyrobench.bench.guard.process import guard_for
from gyrobench.bench.messages.messenger import PATIENCE_S, Messenger
from gyrobench.bench.procedure.plan import DwellPurpose
from gyrobench.bench.runs.can_log import CanLog
from gyrobench.bench.runs.compensation_file import write_compensation
from gyrobench.bench.runs.folder import RUNS, RunFolder, create_run_folder
from gyrobench.bench.runs.journal import Journal, facts_of, read_journal
from gyrobench.bench.runs.provenance import add_identity, identities_in, note_inputs, write_provenance
from gyrobench.bench.runs.telemetry import Telemetry
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE, Instruments
from gyrobench.bench.station.locks import BenchLock, RunLock

#: A guard that has just made the bench safe releases its lock within this time.
_GUARD_TIME_S = 60.0


@dataclass(frozen=True)
class EarlierRuns:
    """What a run continues: earlier ones of the same unit, on one clock."""

    clock: Clock  #: After the last record of the earlier runs; an emulated bench lives as long as it.
    unit: str  #: Serial number of the INS.
    power_ons: int  #: How often the INS was switched on.


def run_job(
    job: Job, out: Path | None, observer: RunObserver, operator: Operator, after: EarlierRuns | None = None
) -> tuple[RunFolder, RunOutcome]:
    """Run a job.

    ``out`` is the run folder, by default a new one under ``runs/``; ``after`` are runs that this one
    continues. Raises BenchInUseError if another run holds the bench. Raises InstrumentError if an instrument
    can't be reached; nothing has moved and there is no run folder. Raises DocumentError if an instrument is
    past due and not acknowledged, and RunFolderError if the run folder can't be written.
    """
    job.check_calibrations()
    clock = after.clock if after else job.station.new_clock()
    state = ResumeState(unit=after.unit, power_ons=after.power_ons) if after else ResumeState()
    outcome = RunOutcome()

    def prepare(folder: RunFolder, identities: Mapping[str, str]) -> tuple[UnitRun, ...]:
        _write_inputs(job, clock, folder, identities)
        return tuple(
            UnitRun(
                unit.number,
                job.plan_of(unit),
                measurement_setup(unit),
                folder.unit(unit.number),
                ResumeState() if unit.number else state,
                RunOutcome() if unit.number else outcome,
            )
            for unit in job.station.units
        )

    return _execute(_Start(job, clock, state, outcome, out, prepare), observer, operator)


def resume_run(
    resumption: Resumption,
    observer: RunObserver,
    operator: Operator,
    clock: Clock | None = None,
    other_instruments: bool = False,
) -> tuple[RunFolder, RunOutcome]:
    """Resume an interrupted run; raises what :func:`run_job` does, and RunFolderError for damaged files.

    ``clock``: by default :meth:`Resumption.clock`. ``other_instruments``: whether rate table and chamber may
    identify as others than before.
    """
    job, folder = resumption.job, resumption.folder
    if resumption.damage:
        raise RunFolderError("\n".join(resumption.damage.describe()))
    if resumption.is_measured:
        return folder, _finish(resumption)
    clock = clock or resumption.clock()
    outcome, units = _remeasured(resumption)

    def prepare(folder: RunFolder, identities: Mapping[str, str]) -> tuple[UnitRun, ...]:  # noqa: ARG001
        resumption.check_unchanged()
        for unit in units:  # the journal may have more dwells
            unit.write_dwells()
        return units

    known = {} if other_instruments else identities_in(folder)
    return _execute(_Start(job, clock, resumption.state, outcome, folder, prepare, known), observer, operator)


def _remeasured(resumption: Resumption) -> tuple[RunOutcome, tuple[UnitRun, ...]]:
    """Measure the finished dwells of an interrupted run again; returns its outcome, and its units."""
    units = []
    for station, part in zip(resumption.job.station.units, resumption.units, strict=True):
        setup = measurement_setup(station)
        dwells, check_dwells = (
            measure_recorded(part.folder, setup) if part.folder.journal.is_file() else ([], [])
        )
        outcome = RunOutcome(dwells=dwells, check_dwells=check_dwells)
        if why := resumption.state.dropped.get(station.number):
            outcome.fail(why)
        units.append(UnitRun(station.number, part.plan, setup, part.folder, part.state, outcome))
    return RunOutcome() if units[0].number else units[0].outcome, tuple(units)


def is_whole(folder: RunFolder) -> bool:
    """Whether a folder holds a run that is finished and evaluated."""
    if not (folder.journal.exists() and folder.acceptance.exists()):
        return False
    return facts_of(read_journal(folder.journal)).ended == "finished"


def run_or_resume(
    job: Job, folder: RunFolder, observer: RunObserver, operator: Operator, after: EarlierRuns | None = None
) -> tuple[RunFolder, RunOutcome]:
    """Run a job into a folder, or resume the run of it that is there; raises what both do."""
    if folder.journal.exists() and not folder.journal.stat().st_size:
        folder.journal.unlink()  # of a process that was killed before anything moved
    if not folder.journal.exists():
        return run_job(job, folder.path, observer, operator, after)
    return resume_run(prepare_resumption(folder.path), observer, operator, after.clock if after else None)


def _finish(resumption: Resumption) -> RunOutcome:
    """Write the results of a run that ended before they were written; uses no instrument."""
    folder, job = resumption.folder, resumption.job
    with RunLock(folder.path, resumption.clock()):
        resumption.check_unchanged()
        outcome, units = _remeasured(resumption)
        for unit in units:
            unit.write_dwells()
            _evaluate(unit, job)
            outcome.units |= {unit.number: unit.outcome} if unit.number else {}
    return outcome


@dataclass(frozen=True)
class _Start:
    """How a run starts, new or resumed."""

    job: Job
    clock: Clock
    state: ResumeState
    outcome: RunOutcome
    #: Folder of the run that is resumed; of a new one its path, by default a new one under ``runs/``.
    folder: RunFolder | Path | None
    #: Writes into the locked folder before anything moves, and returns the units of the run.
    prepare: Callable[[RunFolder, Mapping[str, str]], tuple[UnitRun, ...]]
    known: Mapping[str, str] = field(default_factory=dict)  #: What table and chamber must identify as.

    def open_folder(self) -> RunFolder:
        """The run folder; a new one is made."""
        if isinstance(self.folder, RunFolder):
            return self.folder
        return create_run_folder(self.folder, self.job.plan.procedure.procedure)


def _write_inputs(job: Job, clock: Clock, folder: RunFolder, identities: Mapping[str, str]) -> None:
    units = [(unit, folder.unit(unit.number)) for unit in job.station.units if unit.number]
    for station, inside in (*units, (job.station, folder)):
        make_folder(inside.path)
        write_whole(inside.procedure, job.document.path.read_bytes())
        write_whole(inside.station, station.text.encode())
        if job.calibration:
            write_dwells(inside.calibration, job.calibration_of(station.number))
        if job.compensation is not None:
            write_compensation(inside.compensation, job.compensation, job.unit)
        write_whole(inside.path / station.dbc_path.name, station.dbc_path.read_bytes())
        write_provenance(inside, clock.epoch, identities, job.options)


def _execute(start: _Start, observer: RunObserver, operator: Operator) -> tuple[RunFolder, RunOutcome]:
    """Run what is left of a job, and evaluate all of it."""
    _compile_estimators(start.job, observer)
    with ExitStack() as opened:
        run, messenger = _open(start, observer, operator, opened)
        Engine(run).run()
        if run.outcome.is_safe:
            run.guard.release()
            messenger.patience_s = PATIENCE_S  # else the guard must not wait for the bench
    run.observers.noted("evaluating the measurements")
    for unit in run.units.values():
        try:
            _evaluate(unit, run.job)
        except GyrobenchError as error:
            run.outcome.fail(unit.named(str(error)))
            run.observers.ended(run.outcome)
    return run.folder, run.outcome


def _compile_estimators(job: Job, observer: RunObserver) -> None:
    """Compile now, not at the end of a dwell: nothing watches the bench meanwhile."""
    clock, compilations = WallClock(), Kernel.compilations()
    begin_s, setup = clock.now(), measurement_setup(job.station.units[0])
    compile_estimator(setup)
    if any(each.purpose is DwellPurpose.ROTATIONS for each in job.plan.steps):
        compile_calibration(setup)
    if Kernel.compilations() > compilations:
        observer.noted(f"Compiled the estimators, once after installation, in {clock.now() - begin_s:.1f} s.")


def _open(
    start: _Start, observer: RunObserver, operator: Operator, opened: ExitStack
) -> tuple[RunContext, Messenger]:
    """Bench, locks, files, guard and messages of a run; nothing has moved. ``opened`` closes them."""
    job, clock, state, outcome = start.job, start.clock, start.state, start.outcome
    commands = opened.enter_context(CommandQueue())
    patience_s = _GUARD_TIME_S if state.last_s else 0.0
    bench_lock = opened.enter_context(BenchLock(job.station, RUNS, clock, patience_s=patience_s))
    instruments = opened.enter_context(
        Instruments(job.station, clock, job.emulation, dropped=state.dropped, known=start.known)
    )
    identities = {each: instruments.identify(each) for each in (RATE_TABLE, CHAMBER)}
    instruments.require_no_profile()
    folder = start.open_folder()
    bench_lock.sign(folder.path)
    run_lock = opened.enter_context(RunLock(folder.path, clock))
    units = start.prepare(folder, identities)
    journal = opened.enter_context(Journal(folder.journal, clock))
    running = [unit for unit in units if unit.number not in state.dropped]
    journals = {
        unit.number: opened.enter_context(Journal(unit.folder.journal, clock)) if unit.number else journal
        for unit in running
    }
    journal.followers += [each for each in journals.values() if each is not journal]
    outcome.units = {unit.number: unit.outcome for unit in units if unit.number}
    _record_start(journal, folder, start, units[0].setup, observer)
    replaced = _replaced([folder, *(unit.folder for unit in units)], identities)
    for text in (*bench_lock.taken_over, *run_lock.taken_over, *replaced):
        journal.record("note", text=text)
        observer.noted(text)
    messenger = opened.enter_context(Messenger(job.station.file.messages, journal.record))
    observers = ObserverGroup(observer, RunNotifier(messenger, job.plan, state))
    guard = opened.enter_context(guard_for(job.station, folder.path, clock))
    logs = [(CanLog(unit.folder.can), Telemetry(unit.folder.telemetry)) for unit in running]
    telemetry = None if running[0].folder == folder else Telemetry(folder.telemetry)
    opened.callback(_flush, logs, telemetry, outcome)
    bench = LiveBench(job.station, instruments, clock, logs, partial(_record_failure, journal), telemetry)
    observers.begun(folder, bench, outcome)
    run = RunContext(
        job=job,
        bench=bench,
        folder=folder,
        journal=journal,
        observers=observers,
        operator=ObservedOperator(operator, observers),
        commands=commands,
        guard=guard,
        state=state,
        outcome=outcome,
        units={unit.number: unit for unit in units},
        unit_journals=journals,
    )
    return run, messenger


def _replaced(folders: Sequence[RunFolder], identities: Mapping[str, str]) -> Iterator[str]:
    """Keep what table and chamber are now; texts about those that are others than before."""
    for name, now in identities.items():
        before = {add_identity(folder, name, now) for folder in folders} - {"", now}
        if before:
            yield f"Another {name} than before: {now} in place of {listed(sorted(before))}."


def _record_start(
    journal: Journal, folder: RunFolder, start: _Start, setup: MeasurementSetup, observer: RunObserver
) -> None:
    job, state = start.job, start.state
    left = job.plan.steps[state.resume_index(job.plan) :]
    journal.record(
        "run_resumed" if state.last_s else "run_started",
        procedure=job.plan.procedure.procedure,
        station=job.station.file.station,
        next_step=left[0].number if left else None,
        options=job.options,
        operator=operator_name(),
        **({"unit": state.unit, "power_ons": state.power_ons} if state.power_ons else {}),
    )
    for name, found in job.past_due().items():
        journal.record("past_due", instrument=name, found=found, operator=operator_name())
        observer.noted(f"Warning: {found}")
    if changed := note_inputs(folder) if state.last_s else []:
        text = f"Changed since the run began: {listed(changed)}. All dwells are evaluated with it."
        journal.record("note", text=text)
        observer.noted(text)
    journal.record("resolution", lines=[limit.text for limit in setup.resolution])
    for limit in setup.resolution:
        if not limit.sufficient:
            observer.noted(f"Warning: {limit.text}")


def _record_failure(journal: Journal, instrument: str, error: InstrumentError | None) -> None:
    if error is None:
        journal.record("answers_again", instrument=instrument)
    else:
        journal.record("retry", instrument=instrument, error=str(error))


def _flush(
    logs: Sequence[tuple[CanLog, Telemetry]], telemetry: Telemetry | None, outcome: RunOutcome
) -> None:
    """Write logs and telemetry to the disk."""
    flushes = [flush for log, readings in logs for flush in (log.cut, readings.flush)]
    for flush in (*flushes, *([telemetry.flush] if telemetry else [])):
        try:
            flush()
        except RunFolderError as error:
            outcome.fail(str(error))


def _evaluate(unit: UnitRun, job: Job) -> None:
    """Compute and write the results of all dwells of a unit; raises what :func:`evaluate_run` does."""
    outcome = unit.outcome
    outcome.results = evaluate_run(
        unit.folder,
        unit.plan,
        unit.setup,
        outcome.dwells,
        outcome.check_dwells,
        job.calibration_of(unit.number),
        outcome.rotations,
    )
    outcome.dwells = outcome.results.dwells
