"""`gyrobench resume`."""

from __future__ import annotations

import gc
from typing import Annotated

import typer

from gyrobench.bench.cli.options import FailOnOption, OperatorOption, RunArgument, ViewOption
from gyrobench.bench.cli.output import EXIT_NOT_FINISHED, JsonOption, console, print_end, print_json


def resume(
    run_folder: RunArgument,
    anyway: Annotated[
        bool, typer.Option(help="Resume even after repeated attempts without progress.")
    ] = False,
    look: Annotated[bool, typer.Option(help="Only show the state of the run and the next steps.")] = False,
    give_up_damaged: Annotated[
        bool, typer.Option(help="Set damaged files aside and repeat the dwells that they held.")
    ] = False,
    repeat: Annotated[
        str,
        typer.Option(
            metavar="DWELLS",
            help="Measure dwells again: flagged, skipped, plateaus (all dwells of plateaus with a flagged or "
            "skipped one), numbers, or several with commas, as flagged,3,7.",
        ),
    ] = "",
    other_instruments: Annotated[
        bool, typer.Option(help="Resume with another rate table or chamber than the run began with.")
    ] = False,
    fail_on: FailOnOption = None,
    operator: OperatorOption = "",  # noqa: ARG001 - read from the environment
    view: ViewOption = "live",
    as_json: JsonOption = False,
) -> None:
    """Resume an interrupted run.

    Completed dwells are kept. The interrupted dwell is repeated, after its temperature and soak are
    re-established. If the run ended before its report was written, results and report are written.

    With --repeat, also in a finished run, the dwells are measured again at their temperatures and positions,
    in the order of the procedure, before the steps that remain and those after the last dwell. Until its
    repeat has finished, the earlier measurement counts. With --look: the plan of the repeat, and how long it
    takes.

    Procedure, station and DBC file are the copies in the run folder. If a copy is corrected, all dwells,
    including the completed ones, are evaluated with it; a sealed run first needs gyrobench seal RUN
    --accept-changes.

    Exit codes: 0 the run finished, now or before, or with --look can be resumed; 1 not finished, or files are
    damaged.

    With --json, at the end: {"ended", "reason", "folder", "report", "dwells", "skipped", "verdict",
    "safe_state"}; ended is finished, stopped or failed; skipped has the numbers of the dwells that the
    operator skipped; verdict is that of the acceptance, as in acceptance.json.

    Example: gyrobench resume runs/six_position_fig7-001
    """
    from gyrobench.bench.engine.resume import give_up_damage, prepare_resumption
    from gyrobench.bench.engine.run import resume_run
    from gyrobench.bench.foundations.errors import RunFinishedError
    from gyrobench.bench.monitor.terminal_view import observe_in_terminal
    from gyrobench.bench.procedure.timeline import timeline_rows
    from gyrobench.bench.report.terminal.tables import timeline_table
    from gyrobench.bench.runs.locks import require_no_holder

    terminal = console(as_json, of_run=True)
    require_no_holder(run_folder)
    dwells = repeat.replace(",", " ").split()
    try:
        resumption = prepare_resumption(run_folder, anyway, dwells)
    except RunFinishedError as error:
        terminal.print(str(error), soft_wrap=True)
        if as_json:
            print_json({"ended": "finished", "reason": None, "folder": run_folder})
        return
    if look or not resumption.damage:
        terminal.print(resumption.describe(), soft_wrap=True)
    if look:
        if bench := resumption.describe_bench():
            terminal.print(bench, soft_wrap=True)
        remaining = resumption.progress.remaining_plan(resumption.job.plan)
        if remaining.steps:
            terminal.print(timeline_table(timeline_rows(remaining), remaining.duration_s))
        raise typer.Exit(EXIT_NOT_FINISHED if resumption.damage else 0)
    if resumption.damage and give_up_damaged:
        give_up_damage(resumption)
        resumption = prepare_resumption(run_folder, anyway, dwells)
        terminal.print(resumption.describe(), soft_wrap=True)
    job = resumption.job
    gc.freeze()  # loaded objects are permanent: no collection needs to search them
    with observe_in_terminal(terminal, job, view == "live") as (progress, answers):
        folder, outcome = resume_run(resumption, progress, answers, other_instruments=other_instruments)
    del resumption, job, progress, answers  # and with them the instruments: the report needs the memory
    print_end(terminal, folder, outcome, folder.station, as_json, fail_on)
