"""`gyrobench verify`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from bench.cli.completion import complete_procedure, complete_run, complete_station, complete_world
from bench.cli.exit_codes import EXIT_NOT_FINISHED
from bench.cli.json_output import JsonOption, print_json
from bench.cli.options import STATION_HELP, View, ViewOption
from bench.cli.search import search, write_search


class Compensated(StrEnum):
    """What `verify` measures with; the values are those of bench.measurement.comparison."""

    NONE = "none"
    DECLARED = "declared"
    EFFECT = "effect"


def verify(
    run_folder: Annotated[
        Path, typer.Argument(metavar="RUN", help="Run folder of a campaign.", autocompletion=complete_run)
    ],
    procedure: Annotated[
        str,
        typer.Option(help="Procedure file, or the name of a shipped one.", autocompletion=complete_procedure),
    ] = "verify_compensation",
    station: Annotated[
        str | None,
        typer.Option(help=f"{STATION_HELP} By default the run's.", autocompletion=complete_station),
    ] = None,
    world: Annotated[
        str | None,
        typer.Option(
            help="World behind emulated instruments; by default the run's.", autocompletion=complete_world
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of the emulated world; by default the run's plus one.")
    ] = None,
    only: Annotated[
        list[Compensated] | None,
        typer.Option(help="Measure with this compensation alone, may be repeated; by default with each."),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder to write; by default verify in the run.")] = None,
    view: ViewOption = View.LIVE,
    as_json: JsonOption = False,
) -> None:
    """Load the model of a run into the INS and measure anew what it leaves.

    The procedure runs without compensation, with the declared model, and with the effects found
    added. A run that is in the folder already is not made again, so a verification can be continued.

    With --json: {"folder", "report", "comparison"}, the last a list with the columns of comparison.csv
    as keys.

    Example: gyrobench verify runs/six_position_fig7-001
    """
    from bench.closure.files import is_written, read_held_out_cycles
    from bench.engine.verify import Verification, new_emulation
    from bench.live.console import PatientConsole
    from bench.live.watched import watched
    from bench.measurement.comparison import write_comparison
    from bench.report.comparison.page import write_verify_page
    from bench.report.comparison.terminal import verify_plan, verify_summary
    from bench.report.html import write_report
    from bench.run_store.folder import open_run_folder

    console = PatientConsole(markup=False, highlight=False, stderr=as_json)
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
    for name in missing:
        console.print(f"Compensation: {name}", style="bold")
        with watched(console, job, view is View.LIVE) as (progress, operator):
            measured, outcome = verification.measure(name, progress, operator)
        write_report(measured)
        if outcome.ended != "finished":
            console.print(f"The run {outcome.ended}: {outcome.reason}", soft_wrap=True, style="bold red")
            console.print(f"Folder   {measured.path}", soft_wrap=True)
            raise typer.Exit(EXIT_NOT_FINISHED)
    comparison = verification.comparison()
    write_comparison(folder / "comparison.csv", comparison.leftovers)
    page = write_verify_page(folder, comparison, run.dwells)
    if as_json:
        if folder == run.verify:
            write_report(run)
        rows = [row for each in comparison.leftovers for row in (*each.rows, each.total)]
        print_json({"folder": folder, "report": page, "comparison": rows})
        return
    console.print(verify_summary(comparison))
    console.print(
        f"Report   {page}\nFigures  {folder / 'figures'}\nTable    {folder / 'comparison.csv'}\n"
        f"Folder   {folder}",
        soft_wrap=True,
    )
    if folder == run.verify:
        console.print(f"Also in  {write_report(run)}", soft_wrap=True)
