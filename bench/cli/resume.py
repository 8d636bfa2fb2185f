"""`gyrobench resume`."""

from __future__ import annotations

from typing import Annotated

import typer

from bench.cli.options import RunArgument
from bench.cli.run_end import print_end


def resume(
    run_folder: RunArgument,
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
    print_end(console, folder, outcome)
