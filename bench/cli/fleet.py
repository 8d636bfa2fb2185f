"""`gyrobench fleet`: evaluate many runs at once, compare the units of a batch."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrobench.bench.cli.output import EXIT_NOT_FINISHED, JsonOption, console, print_result
from gyrobench.bench.cli.run_selection import IndexOption, RootArgument, open_index, with_selection
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.runs.index.selection import ANY_RUN, Selection

if TYPE_CHECKING:
    from gyrobench.bench.fleet.jobs import FleetRecord
    from gyrobench.bench.fleet.workers import Workers
    from gyrobench.bench.runs.index.run_index import RunIndex

fleet = typer.Typer(
    help="Evaluate many runs at once, and compare the units of a batch.\n\n"
    "Example: gyrobench fleet close runs",
    no_args_is_help=True,
    rich_markup_mode=None,
)

_RunsArgument = Annotated[
    list[str] | None,
    typer.Argument(metavar="RUNS", help="Run folders, folders that contain some, patterns in quotes."),
]
_FromIndexOption = Annotated[
    str | None, typer.Option(metavar="ROOT", help="Take the runs of ROOT's index that the options select.")
]
_WorkersOption = Annotated[
    int | None, typer.Option(min=1, help="Workers on this machine; default: one per core.")
]
_ThreadsOption = Annotated[
    bool, typer.Option(help="Threads of one process instead of processes: less memory, slower.")
]
_SchedulerOption = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="Dask scheduler (tcp://host:8786) whose workers see the same paths."
    ),
]
_AgainOption = Annotated[bool, typer.Option(help="Process all runs, including those that are done.")]
_OutOption = Annotated[
    Path | None, typer.Option(help="Folder of the record fleet.json; default: ./fleet-KIND.")
]

_HELP = {
    "bins": "Re-evaluate many runs from their raw CAN logs and write their tables.",
    "close": "Search many runs for effects that their bias models lack.\n\n"
    "    Runs whose dwells can't be searched, such as too few, are listed as not searched, not as failures.",
    "report": "Write the reports of many runs.",
}
_DETAILS = """

    The outcome of each run is in fleet.json; a second call processes only runs that failed, are new or
    have changed. A failed run or a killed worker does not affect the others. A run that another process
    holds is skipped with the reason. Exits with 1 if a run failed or was skipped.

    Example: gyrobench fleet {kind} runs --workers 4
"""


def _add_command(kind: str) -> None:
    def command(
        runs: _RunsArgument = None,
        from_index: _FromIndexOption = None,
        selection: Selection = ANY_RUN,
        index: IndexOption = None,
        workers: _WorkersOption = None,
        threads: _ThreadsOption = False,
        scheduler: _SchedulerOption = None,
        again: _AgainOption = False,
        out: _OutOption = None,
        as_json: JsonOption = False,
    ) -> None:
        from gyrobench.bench.fleet.jobs import FleetRecord, JobKind, read_record
        from gyrobench.bench.fleet.workers import Workers
        from gyrobench.bench.runs.index.run_index import runs_in_index
        from gyrobench.bench.runs.index.store import find_run_folders

        if scheduler and (workers or threads):
            raise DocumentError("--scheduler excludes --workers and --threads. Give one or the other")
        if bool(runs) == bool(from_index) or (runs and selection != ANY_RUN):
            message = (
                "give either RUNS or --from-index ROOT; only the latter can be selected by unit, date etc."
            )
            raise DocumentError(message)
        if from_index:
            paths = runs_in_index(from_index, open_index(from_index, index), selection)
        else:
            paths = find_run_folders(runs or [])
        folder, job = out or Path(f"fleet-{kind}"), JobKind(kind)
        record = FleetRecord(job, folder) if again else read_record(job, folder)
        _process(record, paths, Workers(workers, threads, scheduler), as_json=as_json)

    command.__doc__ = _HELP[kind] + _DETAILS.format(kind=kind)
    fleet.command(kind)(with_selection(command))


for _kind in _HELP:
    _add_command(_kind)


def _process(record: FleetRecord, paths: list[Path], workers: Workers, *, as_json: bool) -> None:
    from gyrobench.bench.fleet.jobs import RECORD, JobState
    from gyrobench.bench.fleet.workers import FleetProgress, connect_workers, work_through
    from gyrobench.bench.foundations.clock import WallClock

    pending = record.pending(paths)
    terminal = console(as_json, of_run=True)
    clock = WallClock()
    if pending:
        terminal.print(f"fleet {record.kind}: {len(pending)} of {len(paths)} runs, {workers.describe()}")
        with connect_workers(workers) as pool, FleetProgress(terminal, len(pending)) as progress:
            for result in work_through(pool, record, pending):
                progress.advance(result)
    entries = {path: record.runs[str(path)] for path in paths}
    counts = Counter((path not in pending, entry.state) for path, entry in entries.items())
    parts = [
        f"{counts[is_earlier, state]} {state}{' before' if is_earlier else ''}"
        for is_earlier in (False, True)
        for state in JobState
        if counts[is_earlier, state]
    ]
    is_incomplete = any(state in (JobState.FAILED, JobState.SKIPPED) for _, state in counts)
    again = " Repeat the command to retry only these." if is_incomplete else ""
    print_result(
        {"kind": record.kind.value, "took_s": clock.now(), "runs": entries},
        as_json,
        *(
            f"{entry.state}: {path}\n  {entry.text}"
            for path, entry in entries.items()
            if entry.state != JobState.DONE
        ),
        f"{', '.join(parts)}; {clock.now():.1f} s.{again}",
        f"Record   {record.folder / RECORD}",
    )
    if is_incomplete:
        raise typer.Exit(EXIT_NOT_FINISHED)


@fleet.command()
@with_selection
def batch(
    root: RootArgument = "runs",
    selection: Selection = ANY_RUN,
    index: IndexOption = None,
    out: Annotated[Path, typer.Option(help="Folder for page, figures and batch.json.")] = Path("fleet-batch"),
    as_json: JsonOption = False,
) -> None:
    """Compare the units of a batch: mean, spread between units, and outliers.

    Each unit is compared with the prediction from the other units: bias of each gyro and temperature bin,
    position differences, and sizes of the effects found by `gyrobench close`. The batch of each unit
    comes from ROOT/units.csv.

    Example: gyrobench fleet batch runs --batch B7
    """
    from gyrobench.bench.fleet.batch import fit_batch, read_batch
    from gyrobench.bench.fleet.batch_report import batch_document, batch_summary, write_batch
    from gyrobench.bench.report.terminal.tables import section_view
    from gyrobench.bench.runs.index.run_index import find_runs, watermark

    run_index = open_index(root, index)
    runs = find_runs(run_index, selection)
    batches = sorted({run["batch"] for run in runs})
    if len(batches) != 1:
        raise DocumentError(_batch_problem(run_index, root, selection.batch, batches))
    name = batches[0]
    statistics = fit_batch(read_batch(run_index, runs))
    word = watermark(runs)
    page = write_batch(out, name, statistics, f"{len(runs)} runs in {root}", word)
    print_result(
        batch_document(name, statistics, word),
        as_json,
        section_view(batch_summary(name, statistics)),
        f"Report   {page}\nFigures  {out / 'figures'}\nTables   {out / 'batch.json'}",
    )


def _batch_problem(run_index: RunIndex, root: str, batch: str | None, batches: list[str]) -> str:
    """Message on why there is no single batch to compare, and which batches can be selected."""
    if batches:
        return f"the selected runs are of several batches: {', '.join(map(repr, batches))}. Give --batch"
    known_batches = [
        str(row[0]) for row in run_index.query("SELECT DISTINCT batch FROM units ORDER BY batch").rows
    ]
    problem = f"no run of batch {batch}" if batch else "no run is selected"
    if known_batches:
        return f"{problem}; {root}/units.csv has the batches {', '.join(known_batches)}"
    return f"{problem}. List the batch of each unit in {root}/units.csv (columns unit,batch,hardware,note)"
