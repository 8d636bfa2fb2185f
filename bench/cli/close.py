"""`gyrobench close`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.options import complete_quantity, complete_run
from gyrobench.bench.cli.output import JsonOption, console, print_damage, print_json, print_unfinished
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError, RunFolderError


def close(
    tables: Annotated[
        list[Path],
        typer.Argument(
            metavar="DWELLS_OR_RUN",
            help="Run folders of one unit, or tables with the columns of dwells.csv (docs/tables.md).",
            autocompletion=complete_run,
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Output folder; default: closure, beside the table or in the run (closure_NAME with "
            "--coefficient); of several, closure_A_B beside the first."
        ),
    ] = None,
    hold_out_cycle: Annotated[
        list[int] | None,
        typer.Option(
            help="Cycle excluded from the search, may be repeated; default: the last one, of several tables "
            "that of the first table with several cycles."
        ),
    ] = None,
    hold_out: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="DWELLS_OR_RUN",
            help="One of several tables or runs, all cycles of which are excluded; may be repeated.",
        ),
    ] = None,
    hold_out_each: Annotated[
        bool, typer.Option(help="Also hold out each cycle in turn and compare the outcomes.")
    ] = False,
    coefficient: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Coefficient to search in place of the gyro biases: gyro_scale_factor, gyro_misalignment_xy,"
            " accelerometer_bias, ...; those of all three sensors are searched together.",
            autocompletion=complete_quantity,
        ),
    ] = "gyro_bias",
    compose: Annotated[
        bool,
        typer.Option(
            help="If the residual is unexplained, propose laws of a driver, memory and shape: empirical "
            "hypotheses, the best also as composed_law.yaml for a folder effects."
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Search for effects that explain the residual of the bias model, and test them on a held-out cycle.

    In a campaign of one cycle all dwells are searched; an effect found is ambiguous without a second cycle.
    Several tables or runs are joined on one time axis. Their dwells and cycles get numbers that are
    unique in all of them; the output lists them.

    With --json: {"folder", "report", "closure"}, the last with what closure.json holds: "verdict", which
    is clean, explained, ambiguous or unexplained, "effects", "error_before_dph", "error_after_dph", ...
    With --coefficient names end in its unit, as "error_before_ppm".

    Example: gyrobench close runs/six_position_fig7-001
    """
    import json

    from gyrobench.bench.closure.inputs import read_campaign
    from gyrobench.bench.closure.loop import close_loop, composed
    from gyrobench.bench.closure.loop import hold_out_each as held_out_in_turn
    from gyrobench.bench.closure.quantity import quantity
    from gyrobench.bench.report.closure_page import closure_findings, write_search
    from gyrobench.bench.report.terminal.tables import section_view
    from gyrobench.bench.runs.folder import RunFolder

    try:
        campaign = read_campaign(*tables, quantity=quantity(coefficient))
        cycles = [cycle for path in hold_out or () for cycle in campaign.cycles_of(str(path))]
        closure = close_loop(campaign, [*(hold_out_cycle or ()), *cycles])
    except (MeasurementError, RunFolderError) as error:
        print_unfinished(tables, on_stderr=True)
        raise DocumentError(str(error)) from error
    if hold_out_each:
        closure = held_out_in_turn(closure)
    if compose:
        closure = composed(closure)
    page, report = write_search(closure, tables, out)
    folder = page.parent
    if as_json:
        outcome = json.loads((folder / "closure.json").read_text(encoding="utf-8"))
        print_json({"folder": folder, "report": page, "closure": outcome})
    else:
        console().print(section_view(closure_findings(closure).chapter))
    print_unfinished(tables, as_json)
    print_damage(map(RunFolder, tables), as_json)
    if as_json:
        return
    terminal = console()
    written = "closure.json, predictions.csv, model.yaml"
    if closure.composed and closure.composed.laws:
        written += ", composed_law.yaml"
    terminal.print(f"Report   {page}\nFigures  {folder / 'figures'}\nTables   {written}", soft_wrap=True)
    if report:
        terminal.print(f"Also in  {report}", soft_wrap=True)
    terminal.print(f"Folder   {folder}", soft_wrap=True)
