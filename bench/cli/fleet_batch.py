"""`gyrobench fleet batch`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrobench.bench.cli.output import JsonOption, console, print_json
from gyrobench.bench.cli.run_selection import (
    BatchOption,
    BenchOption,
    IndexOption,
    ProcedureOption,
    RootArgument,
    SinceOption,
    UntilOption,
    open_index,
    selection_of,
)
from gyrobench.bench.foundations.errors import DocumentError

if TYPE_CHECKING:
    from gyrobench.bench.runs.index import RunIndex


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
    from gyrobench.bench.fleet.batch_data import read_batch
    from gyrobench.bench.fleet.batch_model import fit_batch
    from gyrobench.bench.fleet.batch_report import batch_document, batch_summary, write_batch
    from gyrobench.bench.runs.index_selection import find_runs

    opened = open_index(root, index)
    runs = find_runs(opened, selection_of(None, batch, bench, procedure, since, until))
    batches = sorted({run["batch"] for run in runs})
    if len(batches) != 1:
        raise DocumentError(_which_batch(opened, root, batch, batches))
    name = batches[0]
    fitted = fit_batch(read_batch(opened, runs))
    page = write_batch(out, name, fitted, f"{len(runs)} runs in {root}")
    if as_json:
        print_json(batch_document(name, fitted))
        return
    terminal = console()
    terminal.print(batch_summary(name, fitted))
    terminal.print(f"Report   {page}\nFigures  {out / 'figures'}\nTables   batch.json", soft_wrap=True)


def _which_batch(opened: RunIndex, root: str, batch: str | None, found: list[str]) -> str:
    """Say why there is not one batch to compare, and what can be given."""
    if found:
        return (
            f"units of one batch are compared; these runs are of {', '.join(map(repr, found))}. Give --batch"
        )
    known = [str(row[0]) for row in opened.query("SELECT DISTINCT batch FROM units ORDER BY batch").rows]
    what = f"no run here is of batch {batch}" if batch else "no run is meant"
    if known:
        return f"{what}; the batches of {root}/units.csv are {', '.join(known)}"
    where = f"{root}/units.csv, with the columns unit,batch,hardware,note"
    return f"{what}; which batch a unit is of stands in {where}"
