"""The command line; each command imports what it needs when it runs."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from bench.engine.orders import Order
from bench.errors import (
    BenchInUseError,
    DocumentError,
    GyrobenchError,
    InstrumentError,
    MeasurementError,
    RunFolderError,
)

if TYPE_CHECKING:
    from rich.console import Console

    from bench.bias.bins import BiasBin
    from bench.bias.tables.verification_table import VerificationRow
    from bench.closure.closure import Closure
    from bench.engine.outcome import RunOutcome
    from bench.engine.session import Job
    from bench.run_store.folder import RunFolder

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
    compensation: Annotated[
        Path | None, typer.Option(help="Compensation file that is loaded into the INS after each power-on.")
    ] = None,
    faults: Annotated[
        str | None, typer.Option(help="Faults that emulated instruments have: file or shipped name.")
    ] = None,
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
    _print_end(console, folder, outcome)


@app.command()
def resume(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder.")],
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Also if it was resumed again and again without getting on.")
    ] = False,
    look: Annotated[
        bool, typer.Option("--look", help="Only say what was found and what would be done.")
    ] = False,
) -> None:
    """Go on with a run that was cut short: by a power cut, a kill, an order, or a fault.

    What was finished stays. The dwell that was under way is repeated, with the temperature and the soak that
    it needs.

    Example: gyrobench resume runs/six_position_fig7-001
    """
    from bench.engine.operator import ConsentingOperator
    from bench.engine.session import describe_resumption, prepare_resumption, resume_run
    from bench.progress_view import PatientConsole, ProgressView
    from bench.terminal_operator import TerminalOperator

    console = PatientConsole(markup=False, highlight=False)
    resumption = prepare_resumption(run_folder, anyway)
    console.print(describe_resumption(resumption), soft_wrap=True)
    if look:
        return
    job = resumption.job
    operator = ConsentingOperator() if job.is_virtual else TerminalOperator(console)
    with ProgressView(console, job.plan) as progress:
        folder, outcome = resume_run(resumption, progress, operator)
    _print_end(console, folder, outcome)


@app.command()
def tell(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder.")],
    order: Annotated[Order, typer.Argument(help="What it is to do.")],
) -> None:
    """Tell a run under way to pause, continue, hold at this temperature, skip the dwell, or abort.

    The same words can be typed where the run was started.

    Example: gyrobench tell runs/six_position_fig7-001 hold
    """
    import socket

    from bench.engine.orders import MEANINGS, SIGNALS
    from bench.station.bench_lock import holder_of

    holder = holder_of(run_folder)
    if holder is None:
        raise RunFolderError(f"{run_folder}: no run is under way there on this machine")
    if holder.host != socket.gethostname():
        raise RunFolderError(f"{run_folder}: the run is on {holder.host}, not on this machine. Tell it there")
    number = next(number for number, each in SIGNALS.items() if each is order)
    try:
        os.kill(holder.pid, number)
    except OSError as error:
        raise RunFolderError(f"{run_folder}: process {holder.pid} can't be told: {error.strerror}") from error
    typer.echo(f"Told process {holder.pid} to {order}: {MEANINGS[order]}.")


@app.command()
def plan(
    procedure: Annotated[str, typer.Argument(help="Procedure file, or the name of a shipped one.")],
    station: Annotated[str, typer.Option(help=_STATION_HELP)] = _STATION,
    figure: Annotated[
        Path | None, typer.Option(help="PNG file to draw; by default plan_PROCEDURE.png.")
    ] = None,
    separability: Annotated[
        bool, typer.Option("--separability", help="Tell which effects on the bias its dwells tell apart.")
    ] = False,
    target_dph: Annotated[
        float, typer.Option(min=1e-6, help="With --separability: size of effect that matters, deg/h rms.")
    ] = 0.002,
) -> None:
    """Show what a procedure would do and how long it takes, without touching an instrument.

    The profile is drawn with the positions on it, as a PNG file; with --separability also
    separability_PROCEDURE.png, how alike effects look.

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
    if separability:
        _print_separability(job, target_dph)


@app.command()
def check(
    station: Annotated[str, typer.Argument(help=_STATION_HELP)] = _STATION,
    procedure: Annotated[
        str | None, typer.Option(help="Procedure that is to be run: file or shipped name.")
    ] = None,
    world: Annotated[
        str, typer.Option(help="World behind emulated instruments: file or shipped name.")
    ] = "gyro_a",
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random in the emulated world.")] = 0,
    faults: Annotated[
        str | None, typer.Option(help="Faults that emulated instruments have: file or shipped name.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder in which the run folder is to be.")] = Path("runs"),
) -> None:
    """Look whether a bench is fit for a run, without moving anything; a unit that is off is on meanwhile.

    Exit codes: 0 nothing speaks against a run, 1 something does, 3 no instrument answers or a run
    holds the bench.

    Example: gyrobench check my_bench.yaml --procedure six_position_fig7
    """
    from rich.console import Console

    from bench.engine.preflight.answer import nobody_answers
    from bench.engine.preflight.session import check_bench
    from bench.report.preflight_terminal import preflight_report
    from bench.station.check import Verdict
    from bench.station.instruments import Emulation

    try:
        checks = check_bench(station, procedure, Emulation(world, seed, faults or ""), out)
    except BenchInUseError as error:
        _fail(error, EXIT_INSTRUMENT)
    Console(markup=False, highlight=False).print(preflight_report(checks))
    if nobody_answers(checks):
        raise typer.Exit(EXIT_INSTRUMENT)
    if any(each.verdict is Verdict.FAIL for each in checks):
        raise typer.Exit(EXIT_NOT_FINISHED)


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


@app.command()
def close(
    campaign: Annotated[Path, typer.Argument(metavar="DWELLS_OR_RUN", help="Dwell table or run folder.")],
    out: Annotated[
        Path | None, typer.Option(help="Folder to write; by default closure, beside the table or in the run.")
    ] = None,
    hold_out_cycle: Annotated[
        list[int] | None,
        typer.Option(help="Cycle that the search does not see, may be repeated; by default the last one."),
    ] = None,
) -> None:
    """Search for the effect behind what the bias model leaves, and test it on a cycle held out.

    Example: gyrobench close runs/six_position_fig7-001
    """
    from bench.progress_view import PatientConsole
    from bench.report.closure_terminal import closure_summary

    folder = out or (campaign if campaign.is_dir() else campaign.parent) / "closure"
    closure = _search(campaign, hold_out_cycle or ())
    page = _write_search(folder, closure, campaign)
    console = PatientConsole(markup=False)
    console.print(closure_summary(closure))
    tables = "closure.json, predictions.csv, model.yaml"
    console.print(f"Report   {page}\nFigures  {folder / 'figures'}\nTables   {tables}", soft_wrap=True)
    console.print(f"Folder   {folder}", soft_wrap=True)


class Compensated(StrEnum):
    """What `verify` measures with; the values are those of bench.measurement.comparison."""

    NONE = "none"
    DECLARED = "declared"
    EFFECT = "effect"


@app.command()
def verify(
    run_folder: Annotated[Path, typer.Argument(metavar="RUN", help="Run folder of a campaign.")],
    procedure: Annotated[
        str, typer.Option(help="Procedure file, or the name of a shipped one.")
    ] = "verify_compensation",
    station: Annotated[str | None, typer.Option(help=f"{_STATION_HELP} By default the run's.")] = None,
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
    closure = _search(run.path, read_held_out_cycles(run.closure))
    if not is_written(run.closure, closure):
        _write_search(run.closure, closure, run.path)
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


@app.command("import")
def import_log(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="Log of a real IMU, or several in order.")
    ],
    mapping: Annotated[str, typer.Option("--map", help="What stands where: file or shipped name.")],
    out: Annotated[Path, typer.Option(help="Dwell table to write.")] = Path("dwells.csv"),
) -> None:
    """Average logs of a real IMU or INS to a dwell table.

    Example: gyrobench import imu.csv --map my_imu.yaml --out dwells.csv
    """
    from bench.sensor_log.log_import import import_logs, write_import

    imported = import_logs(logs, mapping)
    record = write_import(out, imported)
    typer.echo(f"{imported.summary()}\nTable    {out}\nRecord   {record}")


def _print_end(console: Console, folder: RunFolder, outcome: RunOutcome) -> None:
    """Report how a run ended; exits with an error where it did not finish."""
    from bench.report.html import write_report
    from bench.report.terminal import durations_table

    safe_state = [
        f"{'FAILED: ' if each.problem else ''}{each.what}{_because(each.problem)}"
        for each in outcome.safe_state
    ]
    is_finished = outcome.ended == "finished"
    if not is_finished:
        console.print(f"The run {outcome.ended}: {outcome.reason}", soft_wrap=True, style="bold red")
        console.print("\n".join(safe_state), soft_wrap=True)
    report = write_report(folder)
    _print_biases(console, outcome.results.bins, outcome.results.verification)
    console.print(durations_table(outcome.took_s))
    if is_finished:
        console.print("\n".join(safe_state), soft_wrap=True)
    console.print(f"Report   {report}\nFigures  {folder.figures}\nFolder   {folder.path}", soft_wrap=True)
    if not is_finished:
        console.print(f"Go on    gyrobench resume {folder.path}", soft_wrap=True)
        raise typer.Exit(EXIT_NOT_FINISHED)


def _print_separability(job: Job, target_dph: float) -> None:
    from functools import partial

    from rich.console import Console

    from bench.closure.effects import all_effects
    from bench.closure.planned_campaign import planned_campaign
    from bench.closure.separability import searched_dwells, separability
    from bench.closure.separability_advice import advise
    from bench.measurement.planned_unit import plan_on, planned_unit
    from bench.report.figures import save_figure
    from bench.report.separability_figure import separability_figure
    from bench.report.separability_terminal import separability_summary

    unit, name = planned_unit(job.station), job.plan.procedure.procedure
    try:
        campaign = planned_campaign(job.plan, unit)
    except MeasurementError as error:
        typer.echo(str(error))
        return
    now = separability(searched_dwells(campaign), all_effects())
    advice = advise(job.document, job.plan, partial(plan_on, job.station), unit, now, target_dph)
    console = Console(markup=False, highlight=False)
    console.print(separability_summary(now, len(campaign), unit, target_dph, advice))
    path = Path(f"separability_{name}.png")
    save_figure(separability_figure(now, target_dph, name), path)
    typer.echo(f"Figure   {path}")


def _search(campaign: Path, hold_out_cycles: Sequence[int]) -> Closure:
    from bench.closure.closure import close_loop
    from bench.measurement.campaign import read_campaign

    try:
        return close_loop(read_campaign(campaign), hold_out_cycles)
    except (MeasurementError, RunFolderError) as error:
        _fail(error, EXIT_WRONG_INPUT)


def _write_search(folder: Path, closure: Closure, campaign: Path) -> Path:
    """Write what a search found; returns the page."""
    from bench.closure.files import write_closure
    from bench.report.closure_page import write_closure_page

    write_closure(folder, closure)
    return write_closure_page(folder, closure, str(campaign))


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


def _fail(error: GyrobenchError, code: int) -> NoReturn:
    typer.echo(f"gyrobench: {error}", err=True)
    sys.exit(code)
