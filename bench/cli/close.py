"""`gyrobench close`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bench.cli.search import search, write_search


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
    closure = search(campaign, hold_out_cycle or ())
    page = write_search(folder, closure, campaign)
    console = PatientConsole(markup=False)
    console.print(closure_summary(closure))
    tables = "closure.json, predictions.csv, model.yaml"
    console.print(f"Report   {page}\nFigures  {folder / 'figures'}\nTables   {tables}", soft_wrap=True)
    console.print(f"Folder   {folder}", soft_wrap=True)
