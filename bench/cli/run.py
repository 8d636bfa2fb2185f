"""`gyrobench run`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bench.cli.options import (
    EMULATED,
    FaultsOption,
    ProcedureArgument,
    SeedOption,
    StationOption,
    WorldOption,
)
from bench.cli.run_end import print_end


def run(
    procedure: ProcedureArgument,
    station: StationOption = EMULATED,
    world: WorldOption = "gyro_a",
    out: Annotated[Path | None, typer.Option(help="Run folder; by default a new one under runs/.")] = None,
    seed: SeedOption = 0,
    calibration: Annotated[
        Path | None,
        typer.Option(help="Run folder or dwell table that verifications are compared with."),
    ] = None,
    compensation: Annotated[
        Path | None, typer.Option(help="Compensation file that is loaded into the INS after each power-on.")
    ] = None,
    faults: FaultsOption = None,
) -> None:
    """Run a procedure and report each gyro's bias.

    Example: gyrobench run six_position_fig7 --world gyro_b
    """
    from bench.engine.operator import ConsentingOperator
    from bench.engine.session import prepare_job, run_job
    from bench.progress_view import PatientConsole, ProgressView
    from bench.run_store.compensation_file import read_compensation
    from bench.station.instruments import Emulation
    from bench.terminal_operator import TerminalOperator

    console = PatientConsole(markup=False)
    loaded = read_compensation(compensation) if compensation else None
    job = prepare_job(procedure, station, Emulation(world, seed, faults or ""), calibration, loaded)
    operator = ConsentingOperator() if job.is_virtual else TerminalOperator(console)
    with ProgressView(console, job.plan) as progress:
        folder, outcome = run_job(job, out, progress, operator)
    print_end(console, folder, outcome)
