"""`gyrobench runs`, and the options that choose runs from an index."""

from __future__ import annotations

from datetime import date, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from bench.cli.exit_codes import EXIT_WRONG_INPUT, fail
from bench.cli.json_output import JsonOption, print_json
from bench.errors import DocumentError

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

    from bench.run_index.index import RunIndex
    from bench.run_index.selection import Selection

_DAYS = ["%Y-%m-%d"]
_SHOWN = 40

RootArgument = Annotated[
    str,
    typer.Argument(metavar="[ROOT]", help="Folder or URL (s3://..., memory://...) that holds run folders."),
]
UnitOption = Annotated[str | None, typer.Option(help="Serial number of the INS.")]
BatchOption = Annotated[str | None, typer.Option(help="Batch of the unit's gyros, as in ROOT/units.csv.")]
BenchOption = Annotated[str | None, typer.Option(help="Name of the station.")]
ProcedureOption = Annotated[
    str | None, typer.Option(help="Procedure: its name, or the beginning of its file's SHA-256.")
]
SinceOption = Annotated[
    datetime | None, typer.Option(formats=_DAYS, metavar="DATE", help="First day (UTC) of the start.")
]
UntilOption = Annotated[
    datetime | None, typer.Option(formats=_DAYS, metavar="DATE", help="Last day (UTC) of the start.")
]
VerdictOption = Annotated[
    str | None,
    typer.Option(help="Verdict of the search for effects (clean ...) or the limits (accepted ...)."),
]
EndedOption = Annotated[
    str | None, typer.Option(help="How the run ended: finished, failed, stopped or 'not ended'.")
]
IndexOption = Annotated[
    Path | None,
    typer.Option(help="Index file; by default ROOT/index.duckdb, for a URL one in the user's cache."),
]


def runs(
    root: RootArgument = "runs",
    unit: UnitOption = None,
    batch: BatchOption = None,
    bench: BenchOption = None,
    procedure: ProcedureOption = None,
    since: SinceOption = None,
    until: UntilOption = None,
    verdict: VerdictOption = None,
    ended: EndedOption = None,
    by: Annotated[
        Literal["unit", "batch", "bench", "procedure", "month"] | None,
        typer.Option(help="Count verdicts and average biases by this."),
    ] = None,
    trend: Annotated[bool, typer.Option("--trend", help="Drift of one unit's biases over its runs.")] = False,
    figure: Annotated[Path | None, typer.Option(help="PNG file to draw the trend into.")] = None,
    sql: Annotated[
        str | None,
        typer.Option(
            help="Query of the tables runs, bins, dwells, effects, units and files; it can only read."
        ),
    ] = None,
    most: Annotated[int, typer.Option(min=1, help="Number of runs to show.")] = _SHOWN,
    rebuild: Annotated[bool, typer.Option("--rebuild", help="Read all runs anew.")] = False,
    index: IndexOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the runs of a folder or object store, find some, and look what they say over time.

    What is asked is answered from an index of the run folders. It is brought up to date each time, holds
    nothing else and may be removed. Which batch a unit is of no run tells: keep a table units.csv in ROOT
    with the columns unit,batch,hardware,note.

    Example: gyrobench runs --unit 1001 --since 2026-01-01 --trend --figure drift.png
    """
    from bench.run_index.selection import Selection

    if sum((sql is not None, trend, by is not None)) > 1:
        fail(
            DocumentError("--sql, --trend and --by each give an answer of their own; give one"),
            EXIT_WRONG_INPUT,
        )
    if figure is not None and not trend:
        fail(DocumentError("--figure draws the trend; give --trend too"), EXIT_WRONG_INPUT)
    selection = Selection(unit, batch, bench, procedure, day_of(since), day_of(until), verdict, ended)
    opened = open_index(root, index, rebuild=rebuild)
    if sql is not None:
        content, view = _queried(opened, sql)
    elif by is not None:
        content, view = _grouped(opened, by, selection)
    elif trend:
        content, view = _trends(opened, selection, figure)
    else:
        content, view = _listed(opened, selection, most)
    problems = opened.problems()
    if as_json:
        print_json({**content, "problems": problems})
    else:
        _print(_console(), view, problems)


def day_of(time: datetime | None) -> date | None:
    """Day of an option."""
    return None if time is None else time.date()


def open_index(root: str, path: Path | None = None, *, rebuild: bool = False) -> RunIndex:
    """Open the index of a store, up to date; on a terminal it says how far reading has come."""
    from bench.live.console import PatientConsole
    from bench.run_index.index import RunIndex
    from bench.run_index.run_files import open_store

    opened = RunIndex(open_store(root), path)
    console = PatientConsole(markup=False, stderr=True)
    if not console.is_terminal:
        opened.update(rebuild=rebuild)
        return opened
    with console.status("looking for runs") as status:
        opened.update(
            rebuild=rebuild, progress=lambda done, of: status.update(f"{done} of {of} changed runs read")
        )
    return opened


def _listed(index: RunIndex, selection: Selection, most: int) -> tuple[dict[str, Any], RenderableType]:
    from bench.run_index.selection import find_runs
    from bench.run_index.terminal import runs_table

    found = find_runs(index, selection)
    return {"runs": [_plain_times(run) for run in found]}, runs_table(found, most)


def _grouped(index: RunIndex, by: Any, selection: Selection) -> tuple[dict[str, Any], RenderableType]:
    from bench.run_index.groups import group_runs
    from bench.run_index.terminal import groups_table

    groups = group_runs(index, by, selection)
    return {"by": by, "groups": groups}, groups_table(by, groups)


def _trends(
    index: RunIndex, selection: Selection, figure: Path | None
) -> tuple[dict[str, Any], RenderableType]:
    from bench.run_index.run_biases import read_run_biases
    from bench.run_index.selection import find_runs
    from bench.run_index.terminal import trend_summary
    from bench.run_index.trend import mixed_origins, trends

    found = find_runs(index, selection)
    units = sorted({run["unit"] for run in found})
    if len(units) != 1:
        shown = f"{', '.join(units[:10])}{' ...' if len(units) > 10 else ''}"
        what = f"these runs are of {len(units)} units ({shown})" if units else "no run is meant"
        fail(DocumentError(f"a trend is of one unit; {what}. Give --unit"), EXIT_WRONG_INPUT)
    fitted = trends(read_run_biases(index, [run["path"] for run in found]))
    if figure is not None:
        from bench.report.style import save_figure
        from bench.run_index.trend_figure import trend_figure

        save_figure(trend_figure(units[0], fitted), figure)
    content = {"unit": units[0], "trends": [_plain_trend(each) for each in fitted]}
    return content, trend_summary(units[0], fitted, mixed_origins(found))


def _queried(index: RunIndex, sql: str) -> tuple[dict[str, Any], RenderableType]:
    from bench.run_index.terminal import answer_table

    answer = index.query(sql)
    return {"rows": [_plain_times(row) for row in answer.records()]}, answer_table(answer)


def _plain_trend(trend: Any) -> dict[str, Any]:
    values = vars(trend)
    return {
        **vars(values["quantity"]),
        **{name: value for name, value in values.items() if name not in ("quantity", "runs")},
        "runs": [_plain_times(vars(run)) for run in trend.runs],
    }


def _plain_times(row: dict[str, Any]) -> dict[str, Any]:
    plain = (str, int, float, type(None))
    return {
        name: value.isoformat()
        if isinstance(value, datetime)
        else value
        if isinstance(value, plain)
        else str(value)
        for name, value in row.items()
    }


def _console() -> Console:
    from bench.live.console import PatientConsole

    return PatientConsole(markup=False, highlight=False)


def _print(console: Console, view: RenderableType, problems: dict[str, str]) -> None:
    from bench.run_index.terminal import problems_text

    console.print(view)
    if problems:
        console.print(problems_text(problems), soft_wrap=True)
