"""A whole run: from file names to a run folder with its results."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from bench.bias.tables.dwell_table import DwellRow, read_dwells, write_dwells
from bench.clock import Clock, VirtualClock, WallClock
from bench.documents import Document, find_document
from bench.engine.engine import Engine, Progress, RunOutcome
from bench.engine.live_bench import LiveBench
from bench.engine.operator import Operator
from bench.engine.stop import StopRequest
from bench.errors import DocumentError, GyrobenchError, RunFolderError
from bench.files import write_whole
from bench.measurement.calibration import read_calibration
from bench.measurement.replay import replay
from bench.measurement.results import evaluate, write_results
from bench.measurement.setup import measurement_setup
from bench.procedure.document import load_procedure
from bench.procedure.plan import Plan
from bench.run_store.can_log import CanLog
from bench.run_store.compensation_file import write_compensation
from bench.run_store.folder import RunFolder, create_run_folder, open_run_folder
from bench.run_store.journal import Journal
from bench.run_store.provenance import write_provenance
from bench.run_store.telemetry import Telemetry
from bench.station.instruments import Emulation, Instruments
from bench.station.station import Station
from drivers.ins.compensation import Compensation


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
        return {"world": self.emulation.world, "seed": self.emulation.seed}

    @property
    def is_virtual(self) -> bool:
        """Whether it runs on virtual time, where nobody can be asked."""
        return self.station.file.clock == "virtual"


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
    InstrumentError
        An instrument can't be reached; nothing has moved and there is no run folder.
    RunFolderError
        The run folder can't be written.
    """
    setup = measurement_setup(job.station)
    clock: Clock = VirtualClock() if job.is_virtual else WallClock()
    with Instruments(job.station, clock, job.emulation) as instruments, StopRequest() as stop:
        folder = create_run_folder(out, job.plan.procedure.procedure)
        _copy_inputs(folder, job)
        identities = {
            "rate table": instruments.table.identify(),
            "chamber": instruments.chamber.identify(),
        }
        options = {"clock": job.station.file.clock, **job.emulated_world()}
        write_provenance(folder, clock.utc(), identities, options)
        can_log, telemetry = CanLog(folder.can), Telemetry(folder.telemetry)
        with Journal(folder.journal, clock) as journal:
            journal.record(
                "run_started",
                procedure=job.plan.procedure.procedure,
                station=job.station.file.station,
                options=options,
            )
            journal.record("resolution", lines=[limit.text for limit in setup.resolution])
            for limit in setup.resolution:
                if not limit.sufficient:
                    progress.told(f"Warning: {limit.text}")
            bench = LiveBench(job.station, instruments, clock, can_log, telemetry, stop)
            engine = Engine(
                job.document, job.plan, bench, setup, folder, journal, operator, progress, job.compensation
            )
            try:
                outcome = engine.run()
            finally:
                problems = _put_away(can_log, telemetry)
            for problem in problems:
                outcome.fail(problem)
    try:
        outcome.results = evaluate(
            outcome.dwells, outcome.verifications, job.calibration, setup, job.plan.procedure.bin_width_c
        )
        write_results(folder, outcome.results)
    except GyrobenchError as error:
        outcome.fail(str(error))
    return folder, outcome


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
    _, procedure = load_procedure(folder.procedure)
    setup = measurement_setup(Station(folder.station))
    dwells, verifications = replay(folder, setup)
    write_dwells(folder.dwells, [dwell.row for dwell in dwells])
    calibration = read_dwells(folder.calibration) if folder.calibration.exists() else []
    write_results(folder, evaluate(dwells, verifications, calibration, setup, procedure.bin_width_c))
    return folder


def _put_away(can_log: CanLog, telemetry: Telemetry) -> list[str]:
    """Bring log and telemetry to the disk; returns what went wrong."""
    problems = []
    for put_away in (can_log.cut, telemetry.flush):
        try:
            put_away()
        except RunFolderError as error:
            problems.append(str(error))
    return problems


def _copy_inputs(folder: RunFolder, job: Job) -> None:
    write_whole(folder.procedure, job.document.path.read_bytes())
    write_whole(folder.station, job.station.path.read_bytes())
    if job.calibration:
        write_dwells(folder.calibration, job.calibration)
    if job.compensation is not None:
        write_compensation(folder.compensation, job.compensation)
    write_whole(folder.path / job.station.dbc_path.name, job.station.dbc_path.read_bytes())
