"""`gyrobench verify`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from bench.cli.exit_codes import EXIT_NOT_FINISHED
from bench.cli.options import STATION_HELP
from bench.cli.search import search, write_search


class Compensated(StrEnum):
    """What `verify` measures with; the values are those of bench.measurement.comparison."""

    NONE = "none"
    DECLARED = "declared"
    EFFECT = "effect"


def verify(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder of a campaign.")],
    procedure: Annotated[
        str, typer.Option(help="Procedure file, or the name of a shipped one.")
    ] = "verify_compensation",
    station: Annotated[str | None, typer.Option(help=f"{STATION_HELP} By default the run's.")] = None,
    world: Annotated[
        str | None, typer.Option(help="World behind emulated instruments; by default the run's.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of the emulated world; by default the run's plus one.")
    ] = None,
    only: Annotated[
        list[Compensated] | None,
        typer.Option(help="Measure with this compensation alone, may be repeated; by default with each."),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder to write; by default verify in the run.")] = None,
) -> None:
    """Load the model of a run into the INS and measure anew what it leaves.

    The procedure runs without compensation, with the declared model, and with the effects found
    added. A run that is in the folder already is not made again, so a verification can be continued.

    Example: gyrobench verify runs/six_position_fig7-001
    """
    from bench.closure.files import is_written, read_held_out_cycles
    from bench.engine.operator import ConsentingOperator
    from bench.engine.verify import Verification, new_emulation
    from bench.measurement.comparison import write_comparison
    from bench.progress_view import PatientConsole, ProgressView
    from bench.report.html import write_report
    from bench.report.verify_page import write_verify_page
    from bench.report.verify_terminal import verify_plan, verify_summary
    from bench.run_store.folder import open_run_folder
    from bench.terminal_operator import TerminalOperator

    console = PatientConsole(markup=False, highlight=False)
    run = open_run_folder(run_folder)
    closure = search(run.path, read_held_out_cycles(run.closure))
    if not is_written(run.closure, closure):
        write_search(run.closure, closure, run.path)
    folder = out or run.verify
    verification = Verification(
        run,
        closure,
        procedure,
        station or str(run.station),
        new_emulation(run, world, seed),
        folder,
        [each.value for each in only or ()],
    )
    missing = [name for name in verification.wanted if not verification.is_there(name)]
    job = verification.jobs[verification.wanted[0]]
    console.print(verify_plan(closure, verification.models, missing, job.plan.duration_s))
    operator = ConsentingOperator() if job.is_virtual else TerminalOperator(console)
    for name in missing:
        console.print(f"Compensation: {name}", style="bold")
        with ProgressView(console, job.plan) as progress:
            measured, outcome = verification.measure(name, progress, operator)
        write_report(measured)
        if outcome.ended != "finished":
            console.print(f"The run {outcome.ended}: {outcome.reason}", soft_wrap=True, style="bold red")
            console.print(f"Folder   {measured.path}", soft_wrap=True)
            raise typer.Exit(EXIT_NOT_FINISHED)
    comparison = verification.comparison()
    write_comparison(folder / "comparison.csv", comparison.leftovers)
    page = write_verify_page(folder, comparison)
    console.print(verify_summary(comparison))
    console.print(
        f"Report   {page}\nFigures  {folder / 'figures'}\nTable    {folder / 'comparison.csv'}\n"
        f"Folder   {folder}",
        soft_wrap=True,
    )
