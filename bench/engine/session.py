"""A whole run: from file names to a run folder with results."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from gyrobench.bench.bias.dwell_table import DwellRow, read_dwells, write_dwells
from gyrobench.bench.dwells.dwell import MeasurementSetup, measurement_setup
from gyrobench.bench.dwells.live import warm_up
from gyrobench.bench.dwells.results import evaluate, planned_dwells, write_results
from gyrobench.bench.dwells.run_dwells import replay
from gyrobench.bench.engine.audience import Audience
from gyrobench.bench.engine.engine import Engine
from gyrobench.bench.engine.live_bench import LiveBench
from gyrobench.bench.engine.operator import Operator
from gyrobench.bench.engine.orders import Orders
from gyrobench.bench.engine.outcome import RunOutcome
from gyrobench.bench.engine.people import AnnouncedOperator, People, Progress
from gyrobench.bench.engine.progress import RunProgress
from gyrobench.bench.engine.run_news import RunNews
from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.documents import Document
from gyrobench.bench.foundations.errors import DocumentError, GyrobenchError, InstrumentError, RunFolderError
from gyrobench.bench.foundations.files import write_whole
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.guard.link import guard_for
from gyrobench.bench.messages.messenger import PATIENCE_S, Messenger
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.runs.can_log import CanLog
from gyrobench.bench.runs.compensation_file import write_compensation
from gyrobench.bench.runs.folder import RUNS, RunFolder, create_run_folder, open_run_folder
from gyrobench.bench.runs.journal import Journal
from gyrobench.bench.runs.provenance import read_provenance, write_provenance
from gyrobench.bench.runs.telemetry import Telemetry
from gyrobench.bench.station.instruments import Emulation, Instruments
from gyrobench.bench.station.locks import BenchLock, RunLock
from gyrobench.bench.station.station import Station
from gyrobench.bench.verification.calibration import read_calibration
from gyrobench.bench.verification.calibration_check import calibration_check_rows
from gyrobench.drivers.ins.command_map import Compensation

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
        return self.station.is_virtual

    @property
    def options(self) -> dict[str, str | int]:
        """How it is run, as provenance and journal keep it; :func:`emulation_of` reads it."""
        return {"clock": self.station.file.clock, **self.emulated_world()}


def emulation_of(folder: RunFolder) -> Emulation:
    """What stood behind the emulated instruments of a run; the usual where none was emulated."""
    options = read_provenance(folder).get("options", {})
    return Emulation(
        str(options.get("world", Emulation.world)),
        int(options.get("seed", Emulation.seed)),
        str(options.get("faults", "")),
    )


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
    refused = load.unsupported(compensation)
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
    clock = job.station.new_clock()

    def write_inputs(folder: RunFolder, instruments: Instruments) -> None:
        _copy_inputs(folder, job)
        identities = {
            "rate table": instruments.table.identify(),
            "chamber": instruments.chamber.identify(),
        }
        write_provenance(folder, clock.epoch, identities, job.options)

    def make_folder() -> RunFolder:
        return create_run_folder(out, job.plan.procedure.procedure)

    return carry_out(job, clock, make_folder, write_inputs, RunProgress(), RunOutcome(), progress, operator)


def carry_out(
    job: Job,
    clock: Clock,
    folder_for: Callable[[], RunFolder],
    begin: Callable[[RunFolder, Instruments], None],
    done: RunProgress,
    outcome: RunOutcome,
    progress: Progress,
    operator: Operator,
) -> tuple[RunFolder, RunOutcome]:
    """Carry out what is left of a job, and evaluate all of it.

    Parameters
    ----------
    folder_for : callable
        Makes or gives the run folder; called when the bench is held and all instruments answer.
    begin : callable
        Called then with folder and instruments, before anything is done.
    done : RunProgress
        What was done before.
    outcome : RunOutcome
        With what was measured before; it is added to.

    Raises
    ------
    BenchInUseError, InstrumentError, RunFolderError
        As :func:`run_job`.
    """
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
        procedure, planned = job.plan.procedure, planned_dwells(job.plan)
        outcome.results = evaluate(
            outcome.dwells,
            setup,
            procedure.bin_width_c,
            procedure.acceptance,
            planned,
            calibration_check_rows(
                outcome.verifications, job.calibration or [dwell.row for dwell in outcome.dwells], setup
            ),
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
        options=job.options,
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
    rows = [dwell.row for dwell in dwells]
    write_dwells(folder.dwells, rows)
    calibration = read_dwells(folder.calibration) if folder.calibration.exists() else rows
    planned = planned_dwells(station.plan(document, procedure))
    check = calibration_check_rows(verifications, calibration, setup)
    results = evaluate(dwells, setup, procedure.bin_width_c, procedure.acceptance, planned, check)
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
