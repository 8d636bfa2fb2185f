"""`gyrobench fleet batch`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bench.cli.exit_codes import EXIT_WRONG_INPUT, fail
from bench.cli.json_output import JsonOption, print_json
from bench.cli.runs import (
    BatchOption,
    BenchOption,
    IndexOption,
    ProcedureOption,
    RootArgument,
    SinceOption,
    UntilOption,
    day_of,
    open_index,
)
from bench.errors import DocumentError


def batch(
    root: RootArgument = "runs",
    batch: BatchOption = None,
    bench: BenchOption = None,
    procedure: ProcedureOption = None,
    since: SinceOption = None,
    until: UntilOption = None,
    index: IndexOption = None,
    out: Annotated[Path, typer.Option(help="Folder for page, figures and batch.json.")] = Path("fleet-batch"),
    as_json: JsonOption = False,
) -> None:
    """Compare the units of a batch: what they share, how far they spread, which stands out and in what.

    A unit is compared with what the others lead to expect: in the bias of each gyro and temperature bin,
    in the differences between positions, and in the sizes of the effects that `gyrobench close` found. The
    batch of each unit stands in ROOT/units.csv.

    Example: gyrobench fleet batch runs --batch B7
    """
    from bench.fleet.batch_data import read_batch
    from bench.fleet.batch_model import fit_batch
    from bench.fleet.batch_report import batch_document, batch_summary, write_batch
    from bench.live.console import PatientConsole
    from bench.run_index.selection import Selection, find_runs

    opened = open_index(root, index)
    runs = find_runs(opened, Selection(None, batch, bench, procedure, day_of(since), day_of(until)))
    batches = sorted({run["batch"] for run in runs})
    if len(batches) != 1:
        what = f"these runs are of the batches {', '.join(map(repr, batches))}" if runs else "no run is meant"
        fail(DocumentError(f"units of one batch are compared; {what}. Give --batch"), EXIT_WRONG_INPUT)
    name = batches[0]
    fitted = fit_batch(read_batch(opened, runs))
    page = write_batch(out, name, fitted, f"{len(runs)} runs in {root}")
    if as_json:
        print_json(batch_document(name, fitted))
        return
    console = PatientConsole(markup=False, highlight=False)
    console.print(batch_summary(name, fitted))
    console.print(f"Report   {page}\nFigures  {out / 'figures'}\nTables   batch.json", soft_wrap=True)
