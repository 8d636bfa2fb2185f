"""A whole run: from file names, or the folder of a run that was cut short, to a run folder with results."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from bench.bias.tables.dwell_table import DwellRow, read_dwells, write_dwells
from bench.clock import RESUME_STEP_S, Clock, VirtualClock, WallClock
from bench.documents import Document, find_document
from bench.engine.audience import Audience
from bench.engine.engine import Engine
from bench.engine.live_bench import LiveBench
from bench.engine.operator import Operator
from bench.engine.orders import Orders
from bench.engine.outcome import RunOutcome
from bench.engine.people import AnnouncedOperator, People, Progress
from bench.engine.progress import RunProgress, progress_of
from bench.engine.run_news import RunNews
from bench.errors import DocumentError, GyrobenchError, InstrumentError, RunFolderError
from bench.files import write_whole
from bench.guard.link import guard_for
from bench.measurement.calibration import read_calibration
from bench.measurement.dwell import MeasurementSetup
from bench.measurement.live import warm_up
from bench.measurement.replay import replay
from bench.measurement.results import evaluate, planned_places, write_results
from bench.measurement.setup import measurement_setup
from bench.messages.messenger import PATIENCE_S, Messenger
from bench.procedure.document import load_procedure
from bench.procedure.plan import Plan
from bench.run_store.can_log import CanLog
from bench.run_store.compensation_file import read_compensation, write_compensation
from bench.run_store.folder import RUNS, RunFolder, create_run_folder, open_run_folder
from bench.run_store.journal import Journal, read_journal
from bench.run_store.provenance import read_provenance, started_utc, write_provenance
from bench.run_store.telemetry import Telemetry, last_reading_s
from bench.station.bench_lock import BenchLock, RunLock
from bench.station.instruments import Emulation, Instruments
from bench.station.station import Station
from drivers.ins.compensation import Compensation

#: So many times in a row a run is resumed without finishing anything before somebody has to look at it.
MOST_RESUMED_IN_VAIN = 5

#: A guard that has just made the bench safe lets go of it within this time.
_GUARD_TIME_S = 60.0


@dataclass(frozen=True)
class Job:
    """What is to be run, checked: nothing has moved yet."""

    document: Document
    plan: Plan
    station: Station
    emulation: Emulation
    calibration: tuple[DwellRow, ...] = ()
    compensation: Compensation | None = None

    def emulated_world(self) -> dict[str, str | int]:
        """What stands behind emulated instruments; empty where none is emulated."""
        if not self.station.file.is_emulated():
            return {}
        faults = {"faults": self.emulation.faults} if self.emulation.faults else {}
        return {"world": self.emulation.world, "seed": self.emulation.seed, **faults}

    @property
    def is_virtual(self) -> bool:
        """Whether it runs on virtual time, where nobody can be asked."""
        return self.station.file.clock == "virtual"


@dataclass(frozen=True)
class Resumption:
    """A run that was cut short, and what is left of it."""

    job: Job
    folder: RunFolder
    done: RunProgress


def prepare_job(
    procedure: str,
    station: str,
    emulation: Emulation | None = None,
    calibration: Path | None = None,
    compensation: Compensation | None = None,
) -> Job:
    """Read procedure and station and check the one against the other.

    Parameters
    ----------
    calibration : Path, optional
        Run folder or dwell table that verifications are compared with.
    compensation : Compensation, optional
        Loaded into the INS after each power-on.

    Raises
    ------
    DocumentError
        Lists everything wrong with them, with places; or the INS can't be given the compensation.
    """
    bench = Station(find_document("stations", station))
    bench.check_dbc()
    document, model = load_procedure(find_document("procedures", procedure))
    plan = bench.plan(document, model)
    if calibration and not any(planned.is_verification for planned in plan.steps):
        raise DocumentError(
            f"{document.path}: verifies nothing, so there is nothing to compare with {calibration}. "
            "Leave --calibration out, or take a procedure with `purpose: verification`"
        )
    rows = tuple(read_calibration(calibration)) if calibration else ()
    if compensation is not None:
        _check_compensation(bench, compensation)
    return Job(document, plan, bench, emulation or Emulation(), rows, compensation)


def _check_compensation(station: Station, compensation: Compensation) -> None:
    """Refuse what the INS does not take, before anything moves."""
    commands = station.file.ins.commands
    load = commands.load_compensation
    if load is None or commands.apply_compensation is None:
        raise DocumentError(
            f"{station.path}: ins.commands lacks load_compensation or apply_compensation, so the INS can't "
            "be given a compensation. Map them, or run without"
        )
    refused = load.refuses(compensation)
    if refused:
        raise DocumentError(
            f"{station.path}: ins.commands.load_compensation does not take "
            f"{', '.join(refused)}. Map the indices "
            "that the INS has for it, or leave it out of the compensation"
        )


def run_job(
    job: Job, out: Path | None, progress: Progress, operator: Operator
) -> tuple[RunFolder, RunOutcome]:
    """Run a job.

    Parameters
    ----------
    out : Path or None
        Run folder; None for a new one under ``runs/``.
    progress, operator
        The one who watches, and the one who answers.

    Raises
    ------
    BenchInUseError
        Another run holds the bench.
    InstrumentError
        An instrument can't be reached; nothing has moved and there is no run folder.
    RunFolderError
        The run folder can't be written.
    """
    clock: Clock = VirtualClock() if job.is_virtual else WallClock(speed=job.station.file.speed)

    def write_inputs(folder: RunFolder, instruments: Instruments) -> None:
        _copy_inputs(folder, job)
        identities = {
            "rate table": instruments.table.identify(),
            "chamber": instruments.chamber.identify(),
        }
        options = {"clock": job.station.file.clock, **job.emulated_world()}
        write_provenance(folder, clock.epoch, identities, options)

    def make_folder() -> RunFolder:
        return create_run_folder(out, job.plan.procedure.procedure)

    return _run(job, clock, make_folder, write_inputs, RunProgress(), RunOutcome(), progress, operator)


def prepare_resumption(path: Path, anyway: bool = False) -> Resumption:
    """Look at the folder of a run that was cut short: what is done, and what is left.

    Parameters
    ----------
    anyway : bool
        Whether to go on with a run that was resumed again and again without finishing anything.

    Raises
    ------
    RunFolderError
        There is no run, it is finished, or it was resumed too often in vain.
    DocumentError
        Its procedure, station or DBC file is wrong.
    """
    folder = open_run_folder(path)
    job = _job_of(folder)
    entries = list(read_journal(folder.journal))
    try:
        done = progress_of(entries, job.plan)
    except RunFolderError as error:
        raise RunFolderError(f"{folder.journal}: {error}") from error
    if done.is_over(job.plan) and done.ended == "finished":
        raise RunFolderError(
            f"{path}: this run is finished, so there is nothing to resume. If tables or report are missing, "
            f"write them with: gyrobench bins {path}"
        )
    if done.resumed_in_vain >= MOST_RESUMED_IN_VAIN and not anyway:
        raise RunFolderError(
            f"{path}: was resumed {done.resumed_in_vain} times without finishing a single step. "
            "Find out why (the end of journal.jsonl tells), then resume it with --anyway"
        )
    return Resumption(job, folder, done)


def _job_of(folder: RunFolder) -> Job:
    """Make the job of a run again from what its folder holds."""
    options = read_provenance(folder).get("options", {})
    emulation = Emulation(
        str(options.get("world", Emulation.world)),
        int(options.get("seed", Emulation.seed)),
        str(options.get("faults", "")),
    )
    compensation = read_compensation(folder.compensation) if folder.compensation.exists() else None
    calibration = folder.calibration if folder.calibration.exists() else None
    return prepare_job(str(folder.procedure), str(folder.station), emulation, calibration, compensation)


def resume_run(
    resumption: Resumption, progress: Progress, operator: Operator
) -> tuple[RunFolder, RunOutcome]:
    """Go on with a run that was cut short; raises what :func:`run_job` raises."""
    job, folder, done = resumption.job, resumption.folder, resumption.done
    last_s = max(done.last_s, last_reading_s(folder.telemetry))
    clock: Clock
    if job.is_virtual:
        clock = VirtualClock(last_s + RESUME_STEP_S)
    else:
        clock = WallClock.resumed(started_utc(folder), last_s, job.station.file.speed)
    dwells, verifications = replay(folder, measurement_setup(job.station))
    outcome = RunOutcome(dwells=dwells, verifications=verifications)

    def begin(folder: RunFolder, instruments: Instruments) -> None:  # noqa: ARG001
        _check_unchanged(resumption)
        write_dwells(folder.dwells, [dwell.row for dwell in dwells])  # the journal may be ahead of it

    return _run(job, clock, lambda: folder, begin, done, outcome, progress, operator)


def _check_unchanged(resumption: Resumption) -> None:
    """Refuse to go on with what another process has gone on with before this one held the run."""
    done = resumption.done
    now = progress_of(read_journal(resumption.folder.journal), resumption.job.plan)
    if replace(now, last_s=done.last_s) != done:
        raise RunFolderError(
            f"{resumption.folder.path}: another process went on with this run meanwhile. Resume it again"
        )


def _run(
    job: Job,
    clock: Clock,
    folder_for: Callable[[], RunFolder],
    begin: Callable[[RunFolder, Instruments], None],
    done: RunProgress,
    outcome: RunOutcome,
    progress: Progress,
    operator: Operator,
) -> tuple[RunFolder, RunOutcome]:
    setup = measurement_setup(job.station)
    if not job.is_virtual:
        warm_up(setup)  # on wall time no tick may wait for a compiler
    with ExitStack() as held:
        orders = held.enter_context(Orders())
        patience_s = _GUARD_TIME_S if done.last_s else 0.0
        bench_lock = held.enter_context(BenchLock(job.station, RUNS, clock, patience_s=patience_s))
        instruments = held.enter_context(Instruments(job.station, clock, job.emulation))
        folder = folder_for()
        bench_lock.sign(folder.path)
        run_lock = held.enter_context(RunLock(folder.path, clock))
        begin(folder, instruments)
        journal = held.enter_context(Journal(folder.journal, clock))
        _record_start(journal, job, done, setup, progress)
        for text in (*bench_lock.taken_over, *run_lock.taken_over):
            journal.record("note", text=text)
            progress.told(text)
        messenger = held.enter_context(Messenger(job.station.file.messages, journal.record))
        progress = Audience(progress, RunNews(messenger, job.plan, done))
        guard = held.enter_context(guard_for(job.station, folder.path, clock))
        can_log, telemetry = CanLog(folder.can), Telemetry(folder.telemetry)
        held.callback(_put_away, can_log, telemetry, outcome)
        bench = LiveBench(
            job.station, instruments, clock, can_log, telemetry, partial(_record_failure, journal)
        )
        progress.begun(folder, bench, outcome)
        Engine(
            job.document,
            job.plan,
            bench,
            setup,
            folder,
            journal,
            People(AnnouncedOperator(operator, progress), progress, orders),
            guard,
            done,
            outcome,
            job.compensation,
        ).run()
        if not any(action.problem for action in outcome.safe_state):
            guard.release()
            messenger.patience_s = PATIENCE_S  # else the guard must not wait for the bench
    try:
        procedure, planned = job.plan.procedure, planned_places(job.plan)
        outcome.results = evaluate(
            outcome.dwells,
            outcome.verifications,
            job.calibration,
            setup,
            procedure.bin_width_c,
            procedure.acceptance,
            planned,
        )
        write_results(folder, outcome.results)
    except GyrobenchError as error:
        outcome.fail(str(error))
        progress.ended(outcome)
    return folder, outcome


def _record_start(
    journal: Journal, job: Job, done: RunProgress, setup: MeasurementSetup, progress: Progress
) -> None:
    journal.record(
        "run_resumed" if done.last_s else "run_started",
        procedure=job.plan.procedure.procedure,
        station=job.station.file.station,
        next_step=job.plan.steps[done.next_index].number if not done.is_over(job.plan) else None,
        options={"clock": job.station.file.clock, **job.emulated_world()},
    )
    journal.record("resolution", lines=[limit.text for limit in setup.resolution])
    for limit in setup.resolution:
        if not limit.sufficient:
            progress.told(f"Warning: {limit.text}")


def _record_failure(journal: Journal, instrument: str, error: InstrumentError | None) -> None:
    if error is None:
        journal.record("answers_again", instrument=instrument)
    else:
        journal.record("retry", instrument=instrument, error=str(error))


def describe_resumption(resumption: Resumption) -> str:
    """Say what a run folder holds and what resuming it will do."""
    done, plan = resumption.done, resumption.job.plan
    how = (
        f"{done.ended}: {done.reason}"
        if done.ended
        else "stopped without a word, as after a power cut or a kill"
    )
    lines = [
        f"{resumption.folder.path}: {plan.procedure.procedure}"
        f"{f', unit {done.unit}' if done.unit else ''}; the run {how}.",
        f"{len(done.finished)} of {plan.dwell_count} dwells are finished and stay"
        f"{f', {len(done.skipped)} were left out' if done.skipped else ''}.",
    ]
    if done.under_way:
        lines.append(f"Under way was: {done.under_way}.")
    if done.is_over(plan):
        return "\n".join([*lines, "All steps are done; what is left is to evaluate them."])
    planned = plan.steps[done.next_index]
    what = f"dwell {planned.dwell} ({planned.label}), whole" if planned.dwell else planned.step.describe()
    left_h = (plan.duration_s - planned.start_s) / 3600.0
    lines.append(
        f"It goes on with step {planned.number} of {len(plan.steps)}, {what}; some {left_h:.1f} h are left."
    )
    if done.next_index:
        lines.append(
            "Before that the INS is switched off and on, and temperature and position are approached again."
        )
    return "\n".join(lines)


def measure_again(path: Path) -> RunFolder:
    """Measure a run anew from its raw log, and write its tables.

    Raises
    ------
    RunFolderError
        The folder is no run folder, or its log can't be read.
    DocumentError
        The procedure, station or DBC file in it is wrong.
    """
    folder = open_run_folder(path)
    document, procedure = load_procedure(folder.procedure)
    station = Station(folder.station)
    setup = measurement_setup(station)
    dwells, verifications = replay(folder, setup)
    write_dwells(folder.dwells, [dwell.row for dwell in dwells])
    calibration = read_dwells(folder.calibration) if folder.calibration.exists() else []
    planned = planned_places(station.plan(document, procedure))
    results = evaluate(
        dwells, verifications, calibration, setup, procedure.bin_width_c, procedure.acceptance, planned
    )
    write_results(folder, results)
    return folder


def _put_away(can_log: CanLog, telemetry: Telemetry, outcome: RunOutcome) -> None:
    """Bring log and telemetry to the disk."""
    for put_away in (can_log.cut, telemetry.flush):
        try:
            put_away()
        except RunFolderError as error:
            outcome.fail(str(error))


def _copy_inputs(folder: RunFolder, job: Job) -> None:
    write_whole(folder.procedure, job.document.path.read_bytes())
    write_whole(folder.station, job.station.path.read_bytes())
    if job.calibration:
        write_dwells(folder.calibration, job.calibration)
    if job.compensation is not None:
        write_compensation(folder.compensation, job.compensation)
    write_whole(folder.path / job.station.dbc_path.name, job.station.dbc_path.read_bytes())
