"""`gyrobench resume`."""

from __future__ import annotations

from typing import Annotated

import typer

from gyrobench.bench.cli.options import RunArgument, View, ViewOption
from gyrobench.bench.cli.output import JsonOption, console, print_end


def resume(
    run_folder: RunArgument,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Also after repeated resumptions without progress.")
    ] = False,
    look: Annotated[
        bool, typer.Option("--look", help="Only show the state of the run and the next steps.")
    ] = False,
    view: ViewOption = View.LIVE,
    as_json: JsonOption = False,
) -> None:
    """Resume an interrupted run.

    Completed dwells are kept. The interrupted dwell is repeated, after its temperature and soak are
    re-established.

    With --json, at the end: {"ended", "reason", "folder", "report", "dwells", "verdict", "safe_state"}; ended
    is finished, stopped or failed; verdict is that of the acceptance, as in acceptance.json.

    Example: gyrobench resume runs/six_position_fig7-001
    """
    from gyrobench.bench.engine.resume import prepare_resumption
    from gyrobench.bench.engine.run import resume_run
    from gyrobench.bench.monitor.terminal_view import observe_in_terminal

    terminal = console(as_json)
    resumption = prepare_resumption(run_folder, anyway)
    terminal.print(resumption.describe(), soft_wrap=True)
    if look:
        return
    job = resumption.job
    with observe_in_terminal(terminal, job, view is View.LIVE) as (progress, operator):
        folder, outcome = resume_run(resumption, progress, operator)
    print_end(terminal, folder, outcome, as_json)
