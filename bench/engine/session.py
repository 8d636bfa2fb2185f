"""A whole run: from file names to a run folder with its results."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from bench.bias.bins import bin_biases, write_bins
from bench.bias.dwell_table import DwellRow, write_dwells
from bench.clock import Clock, VirtualClock, WallClock
from bench.documents import Document, find_document
from bench.engine.engine import Engine, Progress, RunOutcome
from bench.engine.live_bench import LiveBench
from bench.engine.operator import Operator
from bench.engine.stop import StopRequest
from bench.measurement.replay import replay
from bench.measurement.setup import measurement_setup
from bench.procedure.checks import check
from bench.procedure.document import load_procedure
from bench.procedure.plan import Plan, expand
from bench.run_store.can_log import CanLog
from bench.run_store.folder import RunFolder, create_run_folder, open_run_folder
from bench.run_store.journal import Journal
from bench.run_store.provenance import write_provenance
from bench.run_store.telemetry import Telemetry
from bench.station.instruments import Emulation, Instruments
from bench.station.station import Station

DEFAULT_STATION = "emulated"


@dataclass(frozen=True)
class Job:
    """What is to be run, checked: nothing has moved yet."""

    document: Document
    plan: Plan
    station: Station
    emulation: Emulation

    @property
    def is_virtual(self) -> bool:
        """Whether it runs on virtual time, where nobody can be asked."""
        return self.station.file.clock == "virtual"


def prepare_job(procedure: str, station: str = DEFAULT_STATION, emulation: Emulation | None = None) -> Job:
    """Read procedure and station and check the one against the other.

    Raises
    ------
    DocumentError
        Lists everything wrong with them, with places.
    """
    bench = Station(find_document("stations", station))
    document, model = load_procedure(find_document("procedures", procedure))
    plan = expand(document, model, bench.bench_at_rest())
    check(document, plan, bench.limits())
    return Job(document, plan, bench, emulation or Emulation())


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
    with StopRequest() as stop, Instruments(job.station, clock, job.emulation) as instruments:
        folder = create_run_folder(out, job.plan.procedure.procedure)
        _copy_inputs(folder, job)
        identities = {
            "rate table": instruments.table.identify(),
            "chamber": instruments.chamber.identify(),
        }
        options = {"world": job.emulation.world, "seed": job.emulation.seed, "clock": job.station.file.clock}
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
            engine = Engine(job.document, job.plan, bench, setup, folder, journal, operator, progress)
            try:
                outcome = engine.run()
            finally:
                can_log.cut()
                telemetry.flush()
    write_results(folder, outcome.rows, job.plan.procedure.bin_width_c)
    return folder, outcome


def write_results(folder: RunFolder, rows: list[DwellRow], bin_width_c: float) -> None:
    """Write the temperature bins; flagged dwells are kept out of them."""
    write_bins(folder.bias_bins, bin_biases([row for row in rows if not row.flags], bin_width_c))


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
    rows = list(replay(folder, measurement_setup(Station(folder.station))))
    write_dwells(folder.dwells, rows)
    write_results(folder, rows, procedure.bin_width_c)
    return folder


def _copy_inputs(folder: RunFolder, job: Job) -> None:
    shutil.copyfile(job.document.path, folder.procedure)
    shutil.copyfile(job.station.path, folder.station)
    shutil.copyfile(job.station.dbc_path, folder.path / job.station.dbc_path.name)
