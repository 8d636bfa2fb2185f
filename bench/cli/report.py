"""`gyrobench report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.options import RunArgument, complete_run
from gyrobench.bench.cli.output import console


def report(
    run_folder: RunArgument,
    by: Annotated[
        str, typer.Option(metavar="NAME", help="Who prepares it, for the sign-off; by default a blank line.")
    ] = "",
    pdf: Annotated[
        bool, typer.Option("--pdf", help="Write report.pdf too, for signing: A4, pages numbered.")
    ] = False,
    before: Annotated[
        Path | None,
        typer.Option(
            metavar="RUN",
            help="Run before a change of the unit, to be set beside this one.",
            autocompletion=complete_run,
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder to write; by default the run's.")] = None,
) -> None:
    """Write the report of a run anew, from what its folder holds.

    What `close` and `verify` found in the run is taken in.

    Example: gyrobench report runs/six_position_fig7-001 --by "A. Smith" --pdf
    """
    from gyrobench.bench.bias.verdicts import read_acceptance
    from gyrobench.bench.report.run_report import write_report
    from gyrobench.bench.report.terminal.tables import acceptance_summary
    from gyrobench.bench.runs.folder import open_run_folder

    folder = open_run_folder(run_folder)
    page = write_report(folder, by, out, open_run_folder(before) if before else None)
    terminal = console()
    if folder.acceptance.exists():
        terminal.print(acceptance_summary(read_acceptance(folder.acceptance)))
    terminal.print(f"Report   {page}", soft_wrap=True)
    if pdf:
        from gyrobench.bench.report.run_report import write_pdf

        terminal.print(f"PDF      {write_pdf(page, page.with_suffix('.pdf'))}", soft_wrap=True)
