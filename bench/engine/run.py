"""Runs a job, new or resumed, to a run folder with results, and sends the run's messages."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from gyrobench.bench.bias.dwell import DwellPurpose
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
from gyrobench.bench.engine.resume import Resumption, prepare_resumption
from gyrobench.bench.engine.resume_state import ResumeState
from gyrobench.bench.engine.run_context import RunContext, UnitRun
from gyrobench.bench.engine.run_notifier import RunNotifier
from gyrobench.bench.engine.run_outcome import RunOutcome
from gyrobench.bench.foundations.clock import Clock, WallClock
from gyrobench.bench.foundations.errors import DocumentError, GyrobenchError, InstrumentError, RunFolderError
from gyrobench.bench.foundations.files import make_folder, write_whole
from gyrobench.bench.foundations.kernels import Kernel
from gyrobench.bench.foundations.operator_name import operator_name
from gyrobench.bench.foundations.text import listed
from gyrobench.bench.guard.process import guard_for
from gyrobench.bench.messages.delivery import missing_secrets
from gyrobench.bench.messages.messenger import PATIENCE_S, Messenger
from gyrobench.bench.runs.can_log import CanLog
from gyrobench.bench.runs.compensation_file import write_compensation
from gyrobench.bench.runs.folder import RUNS, RunFolder, create_run_folder
from gyrobench.bench.runs.journal import Journal, facts_of, read_journal
from gyrobench.bench.runs.locks import RunLock
from gyrobench.bench.runs.provenance import add_identity, identities_in, update_input_hashes, write_provenance
from gyrobench.bench.runs.seal_keys import KEY_VARIABLE, require_usable_key
from gyrobench.bench.runs.telemetry import Telemetry
from gyrobench.bench.station.bench_lock import BenchLock
from gyrobench.bench.station.instruments import CHAMBER, RATE_TABLE, Instruments

#: A guard that has just made the bench safe releases its lock within this time.
_GUARD_TIME_S = 60.0


@dataclass(frozen=True)
class EarlierRuns:
    """Earlier runs of the same unit that a run continues, on one clock."""

    clock: Clock  #: Continues after their last record; an emulated bench exists as long as its clock.
    unit: str  #: Serial number of the INS.
    power_ons: int  #: How often the INS was switched on.


def run_job(
    job: Job, out: Path | None, observer: RunObserver, operator: Operator, earlier: EarlierRuns | None = None
) -> tuple[RunFolder, RunOutcome]:
    """Run a job.

    ``out`` is the run folder, by default a new one under ``runs/``; ``earlier`` are the runs that this one
    continues. Raises BenchInUseError if another run holds the bench. Raises InstrumentError if an instrument
    can't be reached; nothing has moved and there is no run folder. Raises DocumentError if an instrument is
    past due and not acknowledged, or the key for seals can't be used, and RunFolderError if the run folder
    can't be written.
    """
    job.check_calibrations()
    clock = earlier.clock if earlier else job.station.new_clock()
    progress = ResumeState(unit=earlier.unit, power_ons=earlier.power_ons) if earlier else ResumeState()
    outcome = RunOutcome()

    def prepare(folder: RunFolder, identities: Mapping[str, str]) -> tuple[UnitRun, ...]:
        _write_inputs(job, clock, folder, identities)
        return tuple(
            UnitRun(
                unit.number,
                job.plan_of(unit),
                measurement_setup(unit),
                folder.unit(unit.number),
                ResumeState() if unit.number else progress,
                RunOutcome() if unit.number else outcome,
            )
            for unit in job.station.units
        )

    return _execute(_Start(job, clock, progress, outcome, out, prepare), observer, operator)


def resume_run(
    resumption: Resumption,
    observer: RunObserver,
    operator: Operator,
    clock: Clock | None = None,
    other_instruments: bool = False,
) -> tuple[RunFolder, RunOutcome]:
    """Resume an interrupted run; raises what :func:`run_job` does, and RunFolderError for damaged files.

    ``clock``: by default :meth:`Resumption.clock`. ``other_instruments``: whether the rate table and chamber
    may differ from those of the run so far.
    """
    job, folder = resumption.job, resumption.folder
    if resumption.damage:
        raise RunFolderError("\n".join(resumption.damage.describe()))
    if resumption.is_measured:
        return folder, _finish(resumption)
    clock = clock or resumption.clock()
    outcome, units = _remeasure(resumption)

    def prepare(folder: RunFolder, identities: Mapping[str, str]) -> tuple[UnitRun, ...]:  # noqa: ARG001
        resumption.check_unchanged()
        resumption.record_repeats(clock)
        for unit in units:  # the journal may have more dwells
            unit.write_dwells()
        return units

    expected_identities = {} if other_instruments else identities_in(folder)
    return _execute(
        _Start(job, clock, resumption.progress, outcome, folder, prepare, expected_identities),
        observer,
        operator,
    )


def _remeasure(resumption: Resumption) -> tuple[RunOutcome, tuple[UnitRun, ...]]:
    """Evaluate the recorded dwells of an interrupted run again; returns its outcome and its units."""
    units = []
    for station, interrupted in zip(resumption.job.station.units, resumption.units, strict=True):
        setup = measurement_setup(station)
        dwells, check_dwells = (
            measure_recorded(interrupted.folder, setup) if interrupted.folder.journal.is_file() else ([], [])
        )
        outcome = RunOutcome(dwells=dwells, check_dwells=check_dwells)
        if reason := resumption.progress.dropped.get(station.number):
            outcome.fail(reason)
        units.append(
            UnitRun(
                station.number, interrupted.plan, setup, interrupted.folder, interrupted.progress, outcome
            )
        )
    return RunOutcome() if units[0].number else units[0].outcome, tuple(units)


def is_complete(folder: RunFolder) -> bool:
    """Whether a folder holds a run that is finished and evaluated."""
    if not (folder.journal.exists() and folder.acceptance.exists()):
        return False
    return facts_of(read_journal(folder.journal)).ended == "finished"


def run_or_resume(
    job: Job, folder: RunFolder, observer: RunObserver, operator: Operator, earlier: EarlierRuns | None = None
) -> tuple[RunFolder, RunOutcome]:
    """Run a job in a folder, or resume its run there; raises what these two functions raise."""
    if folder.journal.exists() and not folder.journal.stat().st_size:
        folder.journal.unlink()  # of a process that was killed before anything moved
    if not folder.journal.exists():
        return run_job(job, folder.path, observer, operator, earlier)
    return resume_run(prepare_resumption(folder.path), observer, operator, earlier.clock if earlier else None)


def _finish(resumption: Resumption) -> RunOutcome:
    """Write the results of a measured run that ended before they were written; uses no instrument."""
    folder, job = resumption.folder, resumption.job
    with RunLock(folder.path, resumption.clock()):
        resumption.check_unchanged()
        outcome, units = _remeasure(resumption)
        for unit in units:
            unit.write_dwells()
            _evaluate(unit, job)
            outcome.units |= {unit.number: unit.outcome} if unit.number else {}
    return outcome


@dataclass(frozen=True)
class _Start:
    """Start conditions of a run, new or resumed."""

    job: Job
    clock: Clock
    progress: ResumeState
    outcome: RunOutcome
    #: Folder of a resumed run, or path for a new one; None for a new path under ``runs/``.
    folder: RunFolder | Path | None
    #: Writes to the locked folder before anything moves, and returns the units of the run.
    prepare: Callable[[RunFolder, Mapping[str, str]], tuple[UnitRun, ...]]
    #: Identities that table and chamber must have.
    expected_identities: Mapping[str, str] = field(default_factory=dict)


def _write_inputs(job: Job, clock: Clock, folder: RunFolder, identities: Mapping[str, str]) -> None:
    units = [(unit, folder.unit(unit.number)) for unit in job.station.units if unit.number]
    for station, unit_folder in (*units, (job.station, folder)):
        make_folder(unit_folder.path)
        write_whole(unit_folder.procedure, job.document.path.read_bytes())
        write_whole(unit_folder.station, station.text.encode())
        if job.calibration:
            write_dwells(unit_folder.calibration, job.calibration_of(station.number))
        if job.compensation is not None:
            write_compensation(unit_folder.compensation, job.compensation, job.unit)
        write_whole(unit_folder.path / station.dbc_path.name, station.dbc_path.read_bytes())
        write_provenance(unit_folder, clock.epoch, identities, job.options)


def _execute(start: _Start, observer: RunObserver, operator: Operator) -> tuple[RunFolder, RunOutcome]:
    """Run the remaining steps of a job, and evaluate all dwells."""
    try:
        require_usable_key()
    except DocumentError as error:
        advice = f"Correct {KEY_VARIABLE}, or unset it: a run sealed without it never passes --key"
        raise DocumentError(f"{error}. {advice}") from error
    _compile_estimators(start.job, observer)
    with ExitStack() as resources:
        run, messenger = _open(start, observer, operator, resources)
        Engine(run).run()
        if run.outcome.is_safe:
            run.guard.release()
            messenger.patience_s = PATIENCE_S  # shorter if not safe: the guard waits for the bench
    run.observers.noted("evaluating the measurements")
    for unit in run.units.values():
        try:
            _evaluate(unit, run.job)
        except GyrobenchError as error:
            run.outcome.fail(unit.with_number(str(error)))
            run.observers.ended(run.outcome)
    return run.folder, run.outcome


def _compile_estimators(job: Job, observer: RunObserver) -> None:
    """Compile the estimators before anything moves: nothing watches the bench during a compilation."""
    clock, compilations = WallClock(), Kernel.compilations()
    begin_s, setup = clock.now(), measurement_setup(job.station.units[0])
    compile_estimator(setup)
    if any(each.purpose is DwellPurpose.ROTATIONS for each in job.plan.steps):
        compile_calibration(setup)
    if Kernel.compilations() > compilations:
        observer.noted(f"Compiled the estimators, once after installation, in {clock.now() - begin_s:.1f} s.")


def _open(
    start: _Start, observer: RunObserver, operator: Operator, resources: ExitStack
) -> tuple[RunContext, Messenger]:
    """Open bench, locks, files, guard and messages of a run, closed by ``resources``; nothing moves."""
    job, clock, progress, outcome = start.job, start.clock, start.progress, start.outcome
    commands = resources.enter_context(CommandQueue())
    patience_s = _GUARD_TIME_S if progress.last_s else 0.0
    bench_lock = resources.enter_context(BenchLock(job.station, RUNS, clock, patience_s=patience_s))
    instruments = resources.enter_context(
        Instruments(
            job.station, clock, job.emulation, dropped=progress.dropped, identities=start.expected_identities
        )
    )
    identities = {each: instruments.identify(each) for each in (RATE_TABLE, CHAMBER)}
    instruments.require_no_profile()
    folder = start.folder
    if not isinstance(folder, RunFolder):
        folder = create_run_folder(folder, job.plan.procedure.procedure)
    bench_lock.sign(folder.path)
    run_lock = resources.enter_context(RunLock(folder.path, clock))
    units = start.prepare(folder, identities)
    journal = resources.enter_context(Journal(folder.journal, clock))
    measured_units = [unit for unit in units if unit.number not in progress.dropped]
    journals = {
        unit.number: resources.enter_context(Journal(unit.folder.journal, clock)) if unit.number else journal
        for unit in measured_units
    }
    journal.followers += [each for each in journals.values() if each is not journal]
    outcome.units = {unit.number: unit.outcome for unit in units if unit.number}
    _record_start(journal, folder, start, units[0].setup, observer)
    changes = _record_identities([folder, *(unit.folder for unit in units)], identities)
    missing = missing_secrets(job.station.file.messages)
    for text in (*bench_lock.taken_over, *run_lock.taken_over, *changes, *missing):
        journal.record("note", text=text)
        observer.noted(text)
    messenger = resources.enter_context(Messenger(job.station.file.messages, journal.record))
    observers = ObserverGroup(observer, RunNotifier(messenger, job.plan, progress))
    guard = resources.enter_context(guard_for(job.station, folder.path, clock))
    logs = [
        (CanLog(unit.folder.can, job.is_virtual), Telemetry(unit.folder.telemetry, job.is_virtual))
        for unit in measured_units
    ]
    telemetry = None if measured_units[0].folder == folder else Telemetry(folder.telemetry, job.is_virtual)
    resources.callback(_flush, logs, telemetry, outcome)
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
        progress=progress,
        outcome=outcome,
        units={unit.number: unit for unit in units},
        unit_journals=journals,
    )
    return run, messenger


def _record_identities(folders: Sequence[RunFolder], identities: Mapping[str, str]) -> Iterator[str]:
    """Store the identities of table and chamber; yields a text for each that differs from before."""
    for name, identity in identities.items():
        earlier = {add_identity(folder, name, identity) for folder in folders} - {"", identity}
        if earlier:
            yield f"The {name} was replaced: {identity} instead of {listed(sorted(earlier))}."


def _record_start(
    journal: Journal, folder: RunFolder, start: _Start, setup: MeasurementSetup, observer: RunObserver
) -> None:
    job, progress = start.job, start.progress
    remaining = job.plan.steps[progress.resume_index(job.plan) :]
    journal.record(
        "run_resumed" if progress.last_s else "run_started",
        procedure=job.plan.procedure.procedure,
        station=job.station.file.station,
        next_step=remaining[0].number if remaining else None,
        options=job.options,
        operator=operator_name(),
        **({"unit": progress.unit, "power_ons": progress.power_ons} if progress.power_ons else {}),
    )
    for name, description in job.past_due().items():
        journal.record("past_due", instrument=name, found=description, operator=operator_name())
        observer.noted(f"Warning: {description}")
    if changed := update_input_hashes(folder) if progress.last_s else []:
        description = (
            f"Changed since the run began: {listed(changed)}. All dwells are evaluated with the changes."
        )
        journal.record("note", text=description)
        observer.noted(description)
    journal.record("resolution", lines=[limit.text for limit in setup.resolution])
    cautions = [limit.text for limit in setup.resolution if not limit.sufficient]
    if caution := job.station.gravity_caution:
        journal.record("note", text=caution)
        cautions.append(caution)
    for text in cautions:
        observer.noted(f"Warning: {text}")


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
