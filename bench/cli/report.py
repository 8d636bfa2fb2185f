"""`gyrobench report`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.options import RunArgument, complete_run
from gyrobench.bench.cli.output import EXIT_NOT_FINISHED, console, print_damage, print_unfinished
from gyrobench.bench.foundations.errors import DocumentError


class VectorFormat(StrEnum):
    """Formats of figures as vectors."""

    SVG = "svg"
    PDF = "pdf"


def report(
    run_folder: RunArgument,
    by: Annotated[
        str,
        typer.Option(metavar="NAME", help="Name for 'prepared by' in the sign-off; default: a blank line."),
    ] = "",
    pdf: Annotated[
        bool, typer.Option(help="Also write report.pdf: A4 with page numbers, for signing.")
    ] = False,
    before: Annotated[
        Path | None,
        typer.Option(
            metavar="RUN",
            help="Run before a change of the unit, to compare with this one.",
            autocompletion=complete_run,
        ),
    ] = None,
    mark_temperature: Annotated[
        list[float] | None,
        typer.Option(metavar="C", help="Mark a temperature (°C) in the figures; may be repeated."),
    ] = None,
    vectors: Annotated[
        list[VectorFormat] | None,
        typer.Option("--figures", help="Also write every figure in this format; may be repeated."),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Output folder; default: the run folder.")] = None,
) -> None:
    """Write the report of a run from its folder.

    Includes the results of `close` and `verify`. Figures mark the temperatures that the procedure lists
    (marked_temperatures_c) and those given with --mark-temperature. A run whose journal or dwell table is
    damaged is reported, but not judged. --before, --mark-temperature and --out take the folder of one unit.

    Exit codes: 0 the report is written; 1 it is written, but journal or dwell table are damaged.

    Example: gyrobench report runs/six_position_fig7-001 --by "A. Smith" --pdf
    """
    from gyrobench.bench.bias.verdicts import read_acceptance
    from gyrobench.bench.report.bias_sections import acceptance_summary
    from gyrobench.bench.report.run_report import write_report
    from gyrobench.bench.report.terminal.tables import section_view
    from gyrobench.bench.report.units_report import write_units_report
    from gyrobench.bench.runs.folder import open_run_folder
    from gyrobench.bench.runs.provenance import watermark_of

    is_single_unit = before is not None or out is not None or bool(mark_temperature)
    folder = open_run_folder(run_folder, may_have_units=not is_single_unit)
    earlier = open_run_folder(before) if before else None
    if earlier and earlier.journal.read_bytes() == folder.journal.read_bytes():
        raise DocumentError(f"{before}: is the same run, or a copy of it. Give the run before the change")
    formats = [each.value for each in vectors or ()]
    terminal = console()
    is_damaged = print_damage([folder, *folder.unit_folders])
    is_earlier_damaged = print_damage([earlier] if earlier else [])
    print_unfinished([folder.path])
    if folder.unit_folders:
        terminal.print(section_view(write_units_report(folder, by, formats).comparison))
        page = folder.report
    else:
        page, _, comparison = write_report(folder, by, out, earlier, mark_temperature or (), formats)
        if is_damaged:
            terminal.print("Unit not judged.", style="bold")
        elif folder.acceptance.exists():
            terminal.print(section_view(acceptance_summary(read_acceptance(folder.acceptance))))
        if comparison:
            terminal.print(section_view(comparison))
    terminal.print(f"Report   {page}", soft_wrap=True)
    if by and watermark_of(folder.path):
        terminal.print("--by has no effect: reports of emulated runs have no table to sign.", soft_wrap=True)
    if pdf:
        from gyrobench.bench.report.page import write_pdf
        from gyrobench.bench.runs.seal import update_seal

        terminal.print(f"PDF      {write_pdf(page, page.with_suffix('.pdf'))}", soft_wrap=True)
        update_seal(folder)
    if is_damaged or is_earlier_damaged:
        raise typer.Exit(EXIT_NOT_FINISHED)
