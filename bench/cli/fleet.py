"""`gyrobench fleet`: the same for many runs at once."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrobench.bench.cli import fleet_batch
from gyrobench.bench.cli.output import EXIT_NOT_FINISHED, JsonOption, console, print_json
from gyrobench.bench.cli.run_selection import (
    BatchOption,
    BenchOption,
    EndedOption,
    IndexOption,
    ProcedureOption,
    SinceOption,
    UnitOption,
    UntilOption,
    VerdictOption,
    open_index,
    selection_of,
)
from gyrobench.bench.foundations.errors import DocumentError

if TYPE_CHECKING:
    from gyrobench.bench.fleet.cluster import Workers
    from gyrobench.bench.fleet.jobs import JobKind, JobResult
    from gyrobench.bench.fleet.record import FleetRecord

fleet = typer.Typer(
    help="Evaluate many runs at once, and compare the units of a batch.\n\n"
    "Example: gyrobench fleet close runs",
    no_args_is_help=True,
    rich_markup_mode=None,
)

_RunsArgument = Annotated[
    list[str] | None,
    typer.Argument(metavar="RUNS...", help="Run folders, folders that hold some, patterns in quotes."),
]
_FromIndexOption = Annotated[
    str | None,
    typer.Option(metavar="ROOT", help="Take runs of ROOT's index, those that the options below choose."),
]
_WorkersOption = Annotated[
    int | None, typer.Option(min=1, help="Workers on this machine; by default one for each core.")
]
_ThreadsOption = Annotated[
    bool, typer.Option("--threads", help="Threads of one process in place of processes: less memory, slower.")
]
_SchedulerOption = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="Dask scheduler (tcp://host:8786) whose workers see the same paths."
    ),
]
_AgainOption = Annotated[bool, typer.Option("--again", help="Do all runs, also those that are done.")]
_OutOption = Annotated[
    Path | None, typer.Option(help="Folder of the record fleet.json; by default ./fleet-KIND.")
]

_HELP = {
    "bins": "Measure many runs anew from their raw CAN logs and write their tables.",
    "close": "Search many runs for the effects behind what their bias models leave.",
    "report": "Write the reports of many runs.",
}
_DETAILS = """

    What became of each run is in fleet.json; a second call does only runs that failed, are new or have
    changed. A run that fails, or kills its worker, harms no other. One that another process holds is
    left out with the reason. Ends with 1 if a run failed or was left out.

    Example: gyrobench fleet {kind} runs --workers 4
"""


def _add_command(kind: str) -> None:
    def command(
        runs: _RunsArgument = None,
        from_index: _FromIndexOption = None,
        unit: UnitOption = None,
        batch: BatchOption = None,
        bench: BenchOption = None,
        procedure: ProcedureOption = None,
        since: SinceOption = None,
        until: UntilOption = None,
        verdict: VerdictOption = None,
        ended: EndedOption = None,
        index: IndexOption = None,
        workers: _WorkersOption = None,
        threads: _ThreadsOption = False,
        scheduler: _SchedulerOption = None,
        again: _AgainOption = False,
        out: _OutOption = None,
        as_json: JsonOption = False,
    ) -> None:
        from gyrobench.bench.fleet.choice import runs_in_index, runs_named
        from gyrobench.bench.fleet.cluster import Workers
        from gyrobench.bench.fleet.jobs import JobKind

        if scheduler and (workers or threads):
            wrong = "--workers and --threads are of this machine, --scheduler has workers of its own"
            raise DocumentError(f"{wrong}; give one or the other")
        selection = selection_of(unit, batch, bench, procedure, since, until, verdict, ended)
        if bool(runs) == bool(from_index) or (runs and selection != selection_of()):
            wrong = "give either RUNS or --from-index ROOT, which alone can be asked by unit, date and so on"
            raise DocumentError(wrong)
        if from_index:
            paths = runs_in_index(from_index, open_index(from_index, index), selection)
        else:
            paths = runs_named(runs or [])
        record = _record(JobKind(kind), out or Path(f"fleet-{kind}"), again=again)
        _work(record, paths, Workers(workers, threads, scheduler), as_json=as_json)

    command.__doc__ = _HELP[kind] + _DETAILS.format(kind=kind)
    fleet.command(kind)(command)


for _kind in _HELP:
    _add_command(_kind)
fleet.command()(fleet_batch.batch)


def _record(kind: JobKind, folder: Path, *, again: bool) -> FleetRecord:
    from gyrobench.bench.fleet.record import FleetRecord, read_record

    return FleetRecord(kind, folder) if again else read_record(kind, folder)


def _work(record: FleetRecord, paths: list[Path], workers: Workers, *, as_json: bool) -> None:
    from gyrobench.bench.fleet.cluster import connected
    from gyrobench.bench.fleet.progress import FleetProgress
    from gyrobench.bench.fleet.record import RECORD
    from gyrobench.bench.fleet.work import work_through
    from gyrobench.bench.foundations.clock import WallClock

    left = record.left_of(paths)
    terminal = console(as_json)
    clock = WallClock()
    results: list[JobResult] = []
    if left:
        terminal.print(f"fleet {record.kind}: {len(left)} of {len(paths)} runs to do, {workers.describe()}")
        with connected(workers) as client, FleetProgress(terminal, len(left)) as progress:
            for result in work_through(client, record, left):
                results.append(result)
                progress.advance(result)
    counts = Counter(result.state.value for result in results)
    not_done = [result for result in results if result.state != "done"]
    if as_json:
        states = {str(path): record.runs[str(path)].model_dump() for path in paths}
        print_json({"kind": record.kind.value, "took_s": clock.now(), "runs": states})
    else:
        for result in not_done:
            terminal.print(f"{result.state}: {result.path}\n  {result.text}", soft_wrap=True)
        terminal.print(_summary(counts, len(paths) - len(left), clock.now()))
        terminal.print(f"Record   {record.folder / RECORD}", soft_wrap=True)
    if not_done:
        raise typer.Exit(EXIT_NOT_FINISHED)


def _summary(counts: Counter[str], before: int, took_s: float) -> str:
    parts = [f"{counts[state]} {state}" for state in ("done", "failed", "skipped") if counts[state]]
    parts += [f"{before} done before"] if before else []
    again = " The same command does only these again." if counts["failed"] or counts["skipped"] else ""
    return f"{', '.join(parts)}; {took_s:.1f} s.{again}"
