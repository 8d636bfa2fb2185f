"""`gyrobench runs`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from gyrobench.bench.cli.output import JsonOption, console, print_json
from gyrobench.bench.cli.run_selection import (
    BatchOption,
    BenchOption,
    EndedOption,
    IndexOption,
    ProcedureOption,
    RootArgument,
    SinceOption,
    UnitOption,
    UntilOption,
    VerdictOption,
    open_index,
    selection_of,
)
from gyrobench.bench.foundations.errors import DocumentError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from gyrobench.bench.runs.index import RunIndex
    from gyrobench.bench.runs.index_selection import Selection

_SHOWN = 40


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
    if sum((sql is not None, trend, by is not None)) > 1:
        raise DocumentError("--sql, --trend and --by each give an answer of their own; give one")
    if figure is not None and not trend:
        raise DocumentError("--figure draws the trend; give --trend too")
    selection = selection_of(unit, batch, bench, procedure, since, until, verdict, ended)
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
        _print(view, problems)


def _listed(index: RunIndex, selection: Selection, most: int) -> tuple[dict[str, Any], RenderableType]:
    from gyrobench.bench.report.terminal.runs import runs_table
    from gyrobench.bench.runs.index_selection import find_runs

    found = find_runs(index, selection)
    return {"runs": found}, runs_table(found, most)


def _grouped(index: RunIndex, by: Any, selection: Selection) -> tuple[dict[str, Any], RenderableType]:
    from gyrobench.bench.report.terminal.runs import groups_table
    from gyrobench.bench.runs.index_groups import group_runs

    groups = group_runs(index, by, selection)
    return {"by": by, "groups": groups}, groups_table(by, groups)


def _trends(
    index: RunIndex, selection: Selection, figure: Path | None
) -> tuple[dict[str, Any], RenderableType]:
    from gyrobench.bench.report.terminal.runs import trend_summary
    from gyrobench.bench.runs.index_run_biases import read_run_biases
    from gyrobench.bench.runs.index_selection import find_runs
    from gyrobench.bench.runs.index_trend import mixed_origins, trends

    found = find_runs(index, selection)
    units = sorted({run["unit"] for run in found})
    if len(units) != 1:
        shown = f"{', '.join(units[:10])}{' ...' if len(units) > 10 else ''}"
        what = f"these runs are of {len(units)} units ({shown})" if units else "no run is meant"
        raise DocumentError(f"a trend is of one unit; {what}. Give --unit")
    fitted = trends(read_run_biases(index, [run["path"] for run in found]))
    if figure is not None:
        from gyrobench.bench.report.figures.trend import trend_figure
        from gyrobench.bench.report.style import save_figure

        save_figure(trend_figure(units[0], fitted), figure)
    content = {"unit": units[0], "trends": [_plain_trend(each) for each in fitted]}
    return content, trend_summary(units[0], fitted, mixed_origins(found))


def _queried(index: RunIndex, sql: str) -> tuple[dict[str, Any], RenderableType]:
    from gyrobench.bench.report.terminal.runs import answer_table

    answer = index.query(sql)
    return {"rows": answer.records()}, answer_table(answer)


def _plain_trend(trend: Any) -> dict[str, Any]:
    values = vars(trend)
    return {
        **vars(values["quantity"]),
        **{name: value for name, value in values.items() if name not in ("quantity", "runs")},
        "runs": [vars(run) for run in trend.runs],
    }


def _print(view: RenderableType, problems: dict[str, str]) -> None:
    from gyrobench.bench.report.terminal.runs import problems_text

    terminal = console()
    terminal.print(view)
    if problems:
        terminal.print(problems_text(problems), soft_wrap=True)
