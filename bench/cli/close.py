"""`gyrobench close`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrobench.bench.cli.options import complete_run
from gyrobench.bench.cli.output import JsonOption, console, print_json
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError, RunFolderError

if TYPE_CHECKING:
    from gyrobench.bench.closure.loop import Closure


def search(campaign: Path, hold_out_cycles: Sequence[int]) -> Closure:
    """Search in a dwell table or run folder.

    Raises
    ------
    DocumentError
        It can't be used for a search.
    """
    from gyrobench.bench.closure.loop import close_loop
    from gyrobench.bench.dwells.closure_inputs import read_campaign

    try:
        return close_loop(read_campaign(campaign), hold_out_cycles)
    except (MeasurementError, RunFolderError) as error:
        raise DocumentError(str(error)) from error


def close(
    campaign: Annotated[
        Path,
        typer.Argument(
            metavar="DWELLS_OR_RUN", help="Dwell table or run folder.", autocompletion=complete_run
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="Output folder; default: closure, beside the table or in the run.")
    ] = None,
    hold_out_cycle: Annotated[
        list[int] | None,
        typer.Option(help="Cycle excluded from the search, may be repeated; default: the last one."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Search for effects that explain the residual of the bias model, and test them on a held-out cycle.

    With --json: {"folder", "report", "closure"}, the last with what closure.json holds: "verdict", which
    is clean, explained, ambiguous or unexplained, "effects", "error_before_dph", "error_after_dph", ...

    Example: gyrobench close runs/six_position_fig7-001
    """
    import json

    from gyrobench.bench.report.closure.closure_page import write_search
    from gyrobench.bench.report.closure.closure_summary import closure_summary

    closure = search(campaign, hold_out_cycle or ())
    page, report = write_search(closure, campaign, out)
    folder = page.parent
    if as_json:
        found = json.loads((folder / "closure.json").read_text(encoding="utf-8"))
        print_json({"folder": folder, "report": page, "closure": found})
        return
    terminal = console()
    terminal.print(closure_summary(closure))
    tables = "closure.json, predictions.csv, model.yaml"
    terminal.print(f"Report   {page}\nFigures  {folder / 'figures'}\nTables   {tables}", soft_wrap=True)
    if report:
        terminal.print(f"Also in  {report}", soft_wrap=True)
    terminal.print(f"Folder   {folder}", soft_wrap=True)
