"""`gyrobench verify`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrobench.bench.cli.options import (
    STATION_HELP,
    AcknowledgeOption,
    RunArgument,
    View,
    ViewOption,
    complete_procedure,
    complete_station,
    complete_world,
)
from gyrobench.bench.cli.output import EXIT_NOT_FINISHED, JsonOption, console, print_json
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError

if TYPE_CHECKING:
    from gyrobench.bench.closure.outcome import Closure
    from gyrobench.bench.engine.verification_runs import VerificationRuns
    from gyrobench.bench.monitor.terminal import RunConsole
    from gyrobench.bench.runs.folder import RunFolder


class Compensated(StrEnum):
    """Compensations of `verify`, with the values of the module compensation_verification."""

    NONE = "none"
    DECLARED = "declared"
    EFFECT = "effect"


def verify(
    run_folder: RunArgument,
    procedure: Annotated[
        str | None,
        typer.Option(
            help="Procedure file, or the name of a shipped one; default: verify_compensation, with "
            "--coefficients the run's.",
            autocompletion=complete_procedure,
        ),
    ] = None,
    station: Annotated[
        str | None, typer.Option(help=f"{STATION_HELP} Default: the run's.", autocompletion=complete_station)
    ] = None,
    world: Annotated[
        str | None,
        typer.Option(
            help="World behind emulated instruments; default: the run's, which has its unit.",
            autocompletion=complete_world,
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of the emulated world; default: the run's plus one.")
    ] = None,
    only: Annotated[
        list[Compensated] | None,
        typer.Option(help="Measure only with this compensation, may be repeated; default: each."),
    ] = None,
    coefficients: Annotated[
        bool,
        typer.Option(
            help="Compensate and prove all coefficients that the run measured (coefficients.csv), and the "
            "position error of a mission."
        ),
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Output folder; default: verify in the run.")] = None,
    acknowledge: AcknowledgeOption = None,
    view: ViewOption = "live",
    as_json: JsonOption = False,
) -> None:
    """Prove the compensation: load the model of a run into the INS and measure the remaining error.

    The procedure runs without compensation, with the declared model, and with the effects that were
    found. With --coefficients both include polynomials of all other coefficients, and effects of
    those that were searched (gyrobench close RUN --coefficient ...). In a run of one cycle no effect
    can be confirmed, and the polynomials alone are compensated. Existing runs in the folder are not
    repeated, so a verification can be continued.

    With --json: {"folder", "report", "comparison"}, the last a list with the columns of comparison.csv
    as keys.

    Example: gyrobench verify runs/six_position_fig7-001
    """
    from gyrobench.bench.engine.verification_runs import VerificationRuns, new_emulation
    from gyrobench.bench.report.terminal.tables import section_view
    from gyrobench.bench.report.verification_page import verification_plan
    from gyrobench.bench.runs.folder import open_run_folder

    terminal = console(as_json, of_run=True)
    run = open_run_folder(run_folder)
    closure = _search(run)
    verification = VerificationRuns(
        run,
        closure,
        procedure or (str(run.procedure) if coefficients else "verify_compensation"),
        station or str(run.station),
        new_emulation(run, world, seed),
        out or run.verify,
        [each.value for each in only or ()],
        coefficients=coefficients,
        acknowledged=acknowledge or (),
    )
    missing = [name for name in verification.selected if not verification.is_finished(name)]
    job = verification.jobs[verification.selected[0]]
    plan = verification_plan(
        closure, verification.models, missing, job.plan.duration_s, verification.searches
    )
    terminal.print(section_view(plan))
    for name in missing:
        _measure(terminal, verification, name, view)
    _report_result(terminal, verification, run, as_json)


def _search(run: RunFolder) -> Closure:
    """Repeat the search of a run; its files are written if they are missing or belong to another search.

    A run of one cycle is not searched.
    """
    from gyrobench.bench.closure.files import has_composed_laws, is_written, read_held_out_cycles
    from gyrobench.bench.closure.inputs import read_campaign
    from gyrobench.bench.closure.loop import close_loop, composed, without_search
    from gyrobench.bench.report.closure_page import write_search

    try:
        campaign = read_campaign(run.path)
        if len(campaign.cycles) == 1:
            return without_search(campaign)
        closure = close_loop(campaign, read_held_out_cycles(run.closure))
    except MeasurementError as error:
        raise DocumentError(str(error)) from error
    if not is_written(run.closure, closure):
        write_search(composed(closure) if has_composed_laws(run.closure) else closure, [run.path])
    return closure


def _measure(terminal: RunConsole, verification: VerificationRuns, name: str, view: View) -> None:
    """Run the procedure with one compensation; exits if the run does not finish."""
    from gyrobench.bench.monitor.terminal_view import observe_in_terminal
    from gyrobench.bench.report.run_report import write_report
    from gyrobench.bench.verification.compensation_verification import IN_WORDS

    terminal.print(f"Run {IN_WORDS[name]}", style="bold")
    with observe_in_terminal(terminal, verification.jobs[name], view == "live") as (progress, operator):
        measured, outcome = verification.measure(name, progress, operator)
    write_report(measured)
    if outcome.ended != "finished":
        terminal.print(f"The run {outcome.ending}", soft_wrap=True, style="bold red")
        terminal.print(f"Folder   {measured.path}", soft_wrap=True)
        raise typer.Exit(EXIT_NOT_FINISHED)


def _report_result(
    terminal: RunConsole, verification: VerificationRuns, run: RunFolder, as_json: bool
) -> None:
    """Evaluate the runs, write the files, print the result."""
    from gyrobench.bench.report.run_report import write_report
    from gyrobench.bench.report.terminal.tables import section_view
    from gyrobench.bench.report.verification_page import verification_findings, write_verification_page
    from gyrobench.bench.verification.coefficient_verification import write_coefficient_tables
    from gyrobench.bench.verification.compensation_verification import COMPARISON_TABLE, table_rows

    folder, result = verification.folder, verification.result()
    table = folder / "comparison.csv"
    rows = table_rows(result.results)
    COMPARISON_TABLE.write(table, rows)
    if result.coefficients:
        write_coefficient_tables(folder, result.coefficients)
    page = write_verification_page(folder, result, run.dwells)
    report = write_report(run).path if folder == run.verify else None
    if as_json:
        print_json({"folder": folder, "report": page, "comparison": COMPARISON_TABLE.records(rows)})
        return
    terminal.print(section_view(verification_findings(result).chapter))
    terminal.print(
        f"Report   {page}\nFigures  {folder / 'figures'}\nTable    {table}\nFolder   {folder}", soft_wrap=True
    )
    if report:
        terminal.print(f"Also in  {report}", soft_wrap=True)
