"""`gyrobench verify`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrobench.bench.cli.close import search
from gyrobench.bench.cli.options import (
    STATION_HELP,
    RunArgument,
    View,
    ViewOption,
    complete_procedure,
    complete_station,
    complete_world,
)
from gyrobench.bench.cli.output import EXIT_NOT_FINISHED, JsonOption, console, print_json

if TYPE_CHECKING:
    from gyrobench.bench.closure.loop import Closure
    from gyrobench.bench.engine.verification_runs import VerificationRuns
    from gyrobench.bench.monitor.terminal import RunConsole
    from gyrobench.bench.runs.folder import RunFolder


class Compensated(StrEnum):
    """What `verify` measures with; the values are those of gyrobench.bench.verification.comparison."""

    NONE = "none"
    DECLARED = "declared"
    EFFECT = "effect"


def verify(
    run_folder: RunArgument,
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
    from gyrobench.bench.engine.verification_runs import VerificationRuns, new_emulation
    from gyrobench.bench.report.verification.terminal import verify_plan
    from gyrobench.bench.runs.folder import open_run_folder

    terminal = console(as_json)
    run = open_run_folder(run_folder)
    closure = _search(run)
    verification = VerificationRuns(
        run,
        closure,
        procedure,
        station or str(run.station),
        new_emulation(run, world, seed),
        out or run.verify,
        [each.value for each in only or ()],
    )
    missing = [name for name in verification.selected if not verification.is_there(name)]
    job = verification.jobs[verification.selected[0]]
    terminal.print(verify_plan(closure, verification.models, missing, job.plan.duration_s))
    for name in missing:
        _measure(terminal, verification, name, view)
    _tell(terminal, verification, run, as_json)


def _search(run: RunFolder) -> Closure:
    """Search in a run as it was searched before; what is found is written unless it is there."""
    from gyrobench.bench.closure.files import is_written, read_held_out_cycles
    from gyrobench.bench.report.closure.search_files import write_search

    closure = search(run.path, read_held_out_cycles(run.closure))
    if not is_written(run.closure, closure):
        write_search(closure, run.path)
    return closure


def _measure(terminal: RunConsole, verification: VerificationRuns, name: str, view: View) -> None:
    """Run the procedure with one compensation; exits where the run does not finish."""
    from gyrobench.bench.monitor.terminal_view import observe_in_terminal
    from gyrobench.bench.report.run_report import write_report

    terminal.print(f"Compensation: {name}", style="bold")
    with observe_in_terminal(terminal, verification.jobs[name], view is View.LIVE) as (progress, operator):
        measured, outcome = verification.measure(name, progress, operator)
    write_report(measured)
    if outcome.ended != "finished":
        terminal.print(f"The run {outcome.ended}: {outcome.reason}", soft_wrap=True, style="bold red")
        terminal.print(f"Folder   {measured.path}", soft_wrap=True)
        raise typer.Exit(EXIT_NOT_FINISHED)


def _tell(terminal: RunConsole, verification: VerificationRuns, run: RunFolder, as_json: bool) -> None:
    """Compare what was measured, write it, and say what came out."""
    from gyrobench.bench.report.run_report import write_report
    from gyrobench.bench.report.verification.page import write_verify_page
    from gyrobench.bench.report.verification.terminal import verify_summary
    from gyrobench.bench.verification.comparison import write_comparison

    folder, comparison = verification.folder, verification.comparison()
    table = folder / "comparison.csv"
    write_comparison(table, comparison.leftovers)
    page = write_verify_page(folder, comparison, run.dwells)
    report = write_report(run) if folder == run.verify else None
    if as_json:
        rows = [row for each in comparison.leftovers for row in (*each.rows, each.total)]
        print_json({"folder": folder, "report": page, "comparison": rows})
        return
    terminal.print(verify_summary(comparison))
    terminal.print(
        f"Report   {page}\nFigures  {folder / 'figures'}\nTable    {table}\nFolder   {folder}",
        soft_wrap=True,
    )
    if report:
        terminal.print(f"Also in  {report}", soft_wrap=True)
