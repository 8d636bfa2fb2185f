"""The command line; each command imports what it needs when it runs."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.errors import DocumentError, GyrobenchError, InstrumentError

if TYPE_CHECKING:
    from rich.console import Console

    from bench.bias.bins import BiasBin
    from bench.bias.tables.verification_table import VerificationRow

# The matrices of this project are small: threads of the linear algebra only get into each other's way.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

app = typer.Typer(
    help="Bench controller for calibrating the gyros of inertial navigation systems.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=True,
    rich_markup_mode=None,
)

#: Exit codes: the run did not finish; a file or option is wrong; an instrument can't be reached.
EXIT_NOT_FINISHED, EXIT_WRONG_INPUT, EXIT_INSTRUMENT = 1, 2, 3

_STATION = "emulated"
_STATION_HELP = "Station file, or the name of a shipped one."


@app.command()
def run(
    procedure: Annotated[str, typer.Argument(help="Procedure file, or the name of a shipped one.")],
    station: Annotated[str, typer.Option(help=_STATION_HELP)] = _STATION,
    world: Annotated[
        str, typer.Option(help="World behind emulated instruments: file or shipped name.")
    ] = "gyro_a",
    out: Annotated[Path | None, typer.Option(help="Run folder; by default a new one under runs/.")] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random in the emulated world.")] = 0,
    calibration: Annotated[
        Path | None,
        typer.Option(help="Run folder or dwell table that verifications are compared with."),
    ] = None,
) -> None:
    """Run a procedure and report each gyro's bias.

    Example: gyrobench run six_position_fig7 --world gyro_b
    """
    from bench.engine.operator import ConsentingOperator
    from bench.engine.session import prepare_job, run_job
    from bench.progress_view import PatientConsole, ProgressView
    from bench.report.html import write_report
    from bench.report.terminal import durations_table
    from bench.station.instruments import Emulation
    from bench.terminal_operator import TerminalOperator

    console = PatientConsole(markup=False)
    job = prepare_job(procedure, station, Emulation(world, seed), calibration)
    operator = ConsentingOperator() if job.is_virtual else TerminalOperator(console)
    with ProgressView(console, job.plan) as progress:
        folder, outcome = run_job(job, out, progress, operator)
    safe_state = [
        f"{'FAILED: ' if each.problem else ''}{each.what}{_because(each.problem)}"
        for each in outcome.safe_state
    ]
    if outcome.ended != "finished":
        console.print(f"The run {outcome.ended}: {outcome.reason}", soft_wrap=True, style="bold red")
        console.print("\n".join(safe_state), soft_wrap=True)
    report = write_report(folder)
    _print_biases(console, outcome.results.bins, outcome.results.verification)
    console.print(durations_table(outcome.took_s))
    if outcome.ended == "finished":
        console.print("\n".join(safe_state), soft_wrap=True)
    console.print(f"Report   {report}\nFigures  {folder.figures}\nFolder   {folder.path}", soft_wrap=True)
    if outcome.ended != "finished":
        raise typer.Exit(EXIT_NOT_FINISHED)


@app.command()
def plan(
    procedure: Annotated[str, typer.Argument(help="Procedure file, or the name of a shipped one.")],
    station: Annotated[str, typer.Option(help=_STATION_HELP)] = _STATION,
    figure: Annotated[
        Path | None, typer.Option(help="PNG file to draw; by default plan_PROCEDURE.png.")
    ] = None,
) -> None:
    """Show what a procedure would do and how long it takes, without touching an instrument.

    The profile is drawn with the positions on it, as a PNG file.

    Example: gyrobench plan six_position_fig7 --figure plan.png
    """
    from rich.console import Console

    from bench.engine.session import prepare_job
    from bench.procedure.timeline import timeline_rows
    from bench.report.figures import plan_figure, save_figure
    from bench.report.terminal import timeline_table

    job = prepare_job(procedure, station)
    Console().print(timeline_table(timeline_rows(job.plan), job.plan.duration_s))
    path = figure or Path(f"plan_{job.plan.procedure.procedure}.png")
    save_figure(plan_figure(job.plan), path)
    typer.echo(f"Figure   {path}")


@app.command()
def bins(run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder.")]) -> None:
    """Measure a run anew from its raw CAN log and write its tables again.

    Example: gyrobench bins runs/six_position_fig7-001
    """
    from bench.bias.bins import read_bins
    from bench.bias.tables.verification_table import read_verification
    from bench.engine.session import measure_again
    from bench.progress_view import PatientConsole
    from bench.report.html import write_report

    folder = measure_again(run_folder)
    verification = read_verification(folder.verification) if folder.verification.exists() else []
    console = PatientConsole(markup=False)
    _print_biases(console, read_bins(folder.bias_bins), verification)
    results = (folder.bias_bins, folder.joint, folder.joint_biases, folder.noise, folder.verification)
    tables = [path.name for path in (folder.dwells, *results) if path.exists()]
    console.print(f"Tables   {', '.join(tables)}")
    console.print(f"Report   {write_report(folder)}\nFolder   {folder.path}", soft_wrap=True)


def _print_biases(console: Console, bins: list[BiasBin], verification: list[VerificationRow]) -> None:
    from bench.bias.equality import compare_positions
    from bench.report.terminal import bins_table
    from bench.report.verification_terminal import verification_table

    if bins or not verification:
        console.print(bins_table(bins, compare_positions(bins)))
    if verification:
        console.print(verification_table(verification))


def _because(problem: str) -> str:
    return f": {problem}" if problem else ""


def main() -> None:
    """Run the command line; known errors become a message and an exit code."""
    try:
        app()
    except DocumentError as error:
        _fail(error, EXIT_WRONG_INPUT)
    except InstrumentError as error:
        _fail(error, EXIT_INSTRUMENT)
    except GyrobenchError as error:
        _fail(error, EXIT_NOT_FINISHED)


def _fail(error: GyrobenchError, code: int) -> None:
    typer.echo(f"gyrobench: {error}", err=True)
    sys.exit(code)
