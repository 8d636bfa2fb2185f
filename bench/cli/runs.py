"""`gyrobench runs`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from gyrobench.bench.cli.output import JsonOption, print_result
from gyrobench.bench.cli.run_selection import IndexOption, RootArgument, open_index, with_selection
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.runs.index.selection import ANY_RUN, Selection

if TYPE_CHECKING:
    from rich.console import RenderableType

    from gyrobench.bench.runs.index.run_index import RunIndex

_SHOWN = 40
#: End of a run that a process of this machine holds, in place of that in the index.
_IN_PROGRESS = "in progress"


@with_selection
def runs(
    root: RootArgument = "runs",
    selection: Selection = ANY_RUN,
    by: Annotated[
        Literal["unit", "batch", "bench", "procedure", "month"] | None,
        typer.Option(help="Count verdicts and average biases by group."),
    ] = None,
    trend: Annotated[bool, typer.Option(help="Drift of one unit's biases over its runs.")] = False,
    limit_dph: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="With --trend: date until which each bias stays within this limit, deg/h (95 % confidence).",
        ),
    ] = None,
    figure: Annotated[Path | None, typer.Option(help="PNG file for the figure of the trend.")] = None,
    sql: Annotated[
        str | None,
        typer.Option(help="Read-only query of the tables runs, bins, dwells, effects, units and files."),
    ] = None,
    most: Annotated[int, typer.Option(min=1, help="Number of runs shown.")] = _SHOWN,
    rebuild: Annotated[bool, typer.Option(help="Rebuild the index.")] = False,
    index: IndexOption = None,
    as_json: JsonOption = False,
) -> None:
    """List, select and compare the runs of a folder or object store (extra `index`).

    Uses an index of the run folders, which is updated each time and may be removed. A run without an end is
    listed as 'in progress' if it is so on this machine. The batch of a unit
    comes from a table ROOT/units.csv with the columns unit,batch,hardware,note.

    Example: gyrobench runs --unit 1001 --since 2026-01-01 --trend --figure drift.png
    """
    if sum((sql is not None, trend, by is not None)) > 1:
        raise DocumentError("--sql, --trend and --by exclude each other. Give one")
    if (figure is not None or limit_dph is not None) and not trend:
        raise DocumentError("--figure and --limit-dph are of the trend. Give --trend too")
    from gyrobench.bench.report.terminal.runs import answer_table, groups_table, problems_text
    from gyrobench.bench.runs.index.run_index import group_runs

    run_index = open_index(root, index, rebuild=rebuild)
    content: dict[str, Any]
    view: RenderableType
    if sql is not None:
        answer = run_index.query(sql)
        content, view = {"rows": answer.records()}, answer_table(answer)
    elif by is not None:
        groups = group_runs(run_index, by, selection)
        content, view = {"by": by, "groups": groups}, groups_table(by, groups)
    elif trend:
        content, view = _trends(run_index, selection, figure, limit_dph)
    else:
        content, view = _list(run_index, root, selection, most)
    problems = run_index.problems()
    views = [view, problems_text(problems)] if problems else [view]
    if figure is not None:
        views.append(f"Figure   {figure}")
    print_result({**content, "problems": problems}, as_json, *views)


def _list(
    index: RunIndex, root: str, selection: Selection, most: int
) -> tuple[dict[str, Any], RenderableType]:
    from gyrobench.bench.report.terminal.runs import runs_table
    from gyrobench.bench.runs.folder import RunFolder
    from gyrobench.bench.runs.index.run_index import find_runs
    from gyrobench.bench.runs.index.tables import NOT_ENDED
    from gyrobench.bench.runs.locks import holder_of

    matches = find_runs(index, selection)
    for run in matches:
        # Not from the index: a run that is cut off changes none of its files.
        if run["ended"] == NOT_ENDED and holder_of(RunFolder(Path(root, run["path"])).run.path):
            run["ended"] = _IN_PROGRESS
    return {"runs": matches}, runs_table(matches, most)


def _trends(
    index: RunIndex, selection: Selection, figure: Path | None, limit_dph: float | None
) -> tuple[dict[str, Any], RenderableType]:
    from gyrobench.bench.report.terminal.runs import trend_summary
    from gyrobench.bench.runs.index.recalibration import recalibrations
    from gyrobench.bench.runs.index.run_biases import mixed_origins, read_run_biases, trends
    from gyrobench.bench.runs.index.run_index import find_runs

    matches = find_runs(index, selection)
    units = sorted({run["unit"] for run in matches})
    if len(units) != 1:
        names = f"{', '.join(units[:10])}{' ...' if len(units) > 10 else ''}"
        problem = f"the selected runs are of {len(units)} units ({names})" if units else "no run is selected"
        raise DocumentError(f"a trend is of one unit, but {problem}. Give --unit")
    fitted = trends(read_run_biases(index, [run["path"] for run in matches]))
    if figure is not None:
        from gyrobench.bench.report.figures.drift import trend_figure
        from gyrobench.bench.report.figures.style import draw_watermark, save_figure
        from gyrobench.bench.runs.index.run_index import watermark

        plot = trend_figure(units[0], fitted)
        draw_watermark(plot, watermark(matches))
        save_figure(plot, figure)
    due_dates = None if limit_dph is None else recalibrations(index, selection, fitted, limit_dph)
    content: dict[str, Any] = {"unit": units[0], "trends": [_plain_trend(each) for each in fitted]}
    if due_dates is not None:
        content["recalibration"] = [
            {**vars(each.quantity), **(vars(until) if until else {})}
            for each, until in zip(fitted, due_dates, strict=True)
        ]
    return content, trend_summary(units[0], fitted, mixed_origins(matches), due_dates or [])


def _plain_trend(trend: Any) -> dict[str, Any]:
    values = vars(trend)
    return {
        **vars(values["quantity"]),
        **{name: value for name, value in values.items() if name not in ("quantity", "runs")},
        "runs": [vars(run) for run in trend.runs],
    }
