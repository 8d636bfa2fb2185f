"""`gyrobench close`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bench.cli.completion import complete_run
from bench.cli.json_output import JsonOption, print_json
from bench.cli.search import search, write_search


def close(
    campaign: Annotated[
        Path,
        typer.Argument(
            metavar="DWELLS_OR_RUN", help="Dwell table or run folder.", autocompletion=complete_run
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(help="Folder to write; by default closure, beside the table or in the run.")
    ] = None,
    hold_out_cycle: Annotated[
        list[int] | None,
        typer.Option(help="Cycle that the search does not see, may be repeated; by default the last one."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Search for the effect behind what the bias model leaves, and test it on a cycle held out.

    With --json: {"folder", "report", "closure"}, the last with what closure.json holds: "verdict", which
    is clean, explained, ambiguous or unexplained, "effects", "error_before_dph", "error_after_dph", ...

    Example: gyrobench close runs/six_position_fig7-001
    """
    import json

    from bench.live.console import PatientConsole
    from bench.report.closure.terminal import closure_summary
    from bench.report.html import write_report
    from bench.run_store.folder import RunFolder

    folder = out or (campaign if campaign.is_dir() else campaign.parent) / "closure"
    closure = search(campaign, hold_out_cycle or ())
    page = write_search(folder, closure, campaign)
    if as_json:
        if folder == RunFolder(campaign).closure:
            write_report(RunFolder(campaign))
        found = json.loads((folder / "closure.json").read_text(encoding="utf-8"))
        print_json({"folder": folder, "report": page, "closure": found})
        return
    console = PatientConsole(markup=False)
    console.print(closure_summary(closure))
    tables = "closure.json, predictions.csv, model.yaml"
    console.print(f"Report   {page}\nFigures  {folder / 'figures'}\nTables   {tables}", soft_wrap=True)
    if folder == RunFolder(campaign).closure:
        console.print(f"Also in  {write_report(RunFolder(campaign))}", soft_wrap=True)
    console.print(f"Folder   {folder}", soft_wrap=True)
