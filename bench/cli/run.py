"""`gyrobench run`."""

from __future__ import annotations

import gc
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.options import (
    EMULATED,
    AcknowledgeOption,
    FailOnOption,
    FaultsOption,
    OperatorOption,
    ProcedureArgument,
    SeedOption,
    StationOption,
    ViewOption,
    WorldOption,
    complete_run,
)
from gyrobench.bench.cli.output import JsonOption, console, print_end


def run(
    procedure: ProcedureArgument,
    station: StationOption = EMULATED,
    world: WorldOption = None,
    out: Annotated[Path | None, typer.Option(help="Run folder; default: a new one under runs/.")] = None,
    seed: SeedOption = 0,
    calibration: Annotated[
        Path | None,
        typer.Option(help="Run folder or dwell table for calibration checks.", autocompletion=complete_run),
    ] = None,
    compensation: Annotated[
        Path | None, typer.Option(help="Compensation file to load into the INS after each power-on.")
    ] = None,
    faults: FaultsOption = None,
    customer: Annotated[str, typer.Option(help="Customer and address, for the certificate.")] = "",
    order: Annotated[str, typer.Option(help="Number of the order, for the certificate.")] = "",
    item: Annotated[str, typer.Option(help="Item of the order, for the certificate.")] = "",
    acknowledge: AcknowledgeOption = None,
    fail_on: FailOnOption = None,
    operator: OperatorOption = "",  # noqa: ARG001 - read from the environment
    view: ViewOption = "live",
    as_json: JsonOption = False,
) -> None:
    """Run a procedure and report the bias of each gyro.

    With --json, at the end: {"ended", "reason", "folder", "report", "dwells", "skipped", "verdict",
    "safe_state"}; ended is finished, stopped or failed; skipped has the numbers of the dwells that the
    operator skipped; verdict is that of the acceptance, as in acceptance.json.

    Example: gyrobench run six_position_fig7 --world gyro_b
    """
    from gyrobench.bench.engine.job import prepare_job
    from gyrobench.bench.engine.run import run_job
    from gyrobench.bench.foundations.errors import DocumentError
    from gyrobench.bench.foundations.text import listed
    from gyrobench.bench.monitor.terminal_view import observe_in_terminal
    from gyrobench.bench.runs.compensation_file import read_compensation_file
    from gyrobench.bench.station.instruments import Emulation

    terminal = console(as_json, of_run=True)
    compensation_file = read_compensation_file(compensation) if compensation else None
    job = prepare_job(
        procedure,
        station,
        Emulation.of(station, world, seed, faults),
        calibration,
        compensation_file.compensation() if compensation_file else None,
        {"customer": customer, "order": order, "item": item},
        acknowledge or (),
    )
    if compensation_file:
        job = replace(job, unit=compensation_file.serial_number)
    if missing := [key for key in job.station.not_filled_in if key != "description"]:
        raise DocumentError(f"{job.station.path}: not filled in yet: {listed(missing)}. Fill them in")
    gc.freeze()  # loaded objects are permanent: no collection needs to search them
    with observe_in_terminal(terminal, job, view == "live") as (progress, answers):
        folder, outcome = run_job(job, out, progress, answers)
    del job, progress, answers  # and with them the instruments: the report needs the memory
    print_end(terminal, folder, outcome, station, as_json, fail_on)
