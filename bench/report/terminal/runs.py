"""Tables of the runs in an index for a terminal of 80 columns: lists, groups, drift of a unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from gyrobench.bench.foundations.text import bin_label, counted, listed
from gyrobench.bench.report.number_format import BiasScale, p_text
from gyrobench.bench.report.terminal.tables import plain_table
from gyrobench.bench.runs.folder import UNITS_FOLDER
from gyrobench.bench.runs.index.recalibration import MAX_MONTHS, Recalibration
from gyrobench.bench.runs.index.run_biases import FALSE_ALARM, Trend
from gyrobench.bench.runs.index.run_index import QueryResult
from gyrobench.bench.runs.index.tables import STALE

_FINISHED = "finished"
_MAX_CELL_CHARACTERS = 40


def runs_table(runs: Sequence[Mapping[str, Any]], max_runs: int) -> RenderableType:
    """Table of runs; for a run that did not finish, its end replaces the verdict."""
    rows = []
    for run in runs[:max_runs]:
        verdict = run["verdict"] if run["ended"] == _FINISHED else run["ended"]
        start_date = run["started_utc"].date().isoformat()
        path = run["path"].removesuffix(f"/{UNITS_FOLDER}/{run['unit']}")
        cells = (path, start_date, run["unit"], run["batch"], run["station"], verdict, run["acceptance"])
        rows.append([str(cell or "") for cell in cells])
    table = plain_table(("run", "start", "unit", "batch", "bench", "verdict", "acceptance"), 7, rows)
    units = {run["unit"] for run in runs if run["unit"]}
    of_units = f" of {counted(len(units), 'unit')}" if units else ""
    lines = [f"{counted(len(runs), 'run')}{of_units}."]
    if len(runs) > max_runs:
        lines.append(f"The newest {max_runs} are shown; show more with --most.")
    if any(run["verdict"] == STALE for run in runs[:max_runs]):
        lines.append("stale: dwells were measured or re-evaluated after the search; search again.")
    return Group(table, Text(), Text(" ".join(lines)))


def groups_table(by: str, groups: Sequence[Mapping[str, Any]]) -> RenderableType:
    """Table of groups of runs: numbers, verdicts of searches and acceptance, biases."""
    values = [[row[f"{name}_{gyro}_dph"] for row in groups for gyro in "xyz"] for name in ("bias", "spread")]
    scale = BiasScale.of(*([each for each in column if each is not None] for column in values))
    rows = []
    for row in groups:
        search_counts = "/".join(str(row[name]) for name in ("clean", "explained", "other"))
        acceptance_counts = "/".join(str(row[name]) for name in ("accepted", "marginal", "rejected"))
        counts = str(row["runs"]), str(row["units"]), search_counts, acceptance_counts
        biases = [_with_spread(scale, row, gyro) for gyro in "xyz"]
        rows.append((str(row["name"] or "unknown"), *counts, *biases))
    table = plain_table((by, "runs", "units", "c/e/o", "a/m/r", "bias x", "bias y", "bias z"), 1, rows)
    note = (
        f"Biases: mean ± standard deviation of the runs, {scale.unit}. c/e/o: runs clean, explained, other "
        "by the search for effects; a/m/r: accepted, marginal, rejected."
    )
    return Group(table, Text(), Text(note))


def trend_summary(
    unit: str, trends: Sequence[Trend], notes: Sequence[str], due_dates: Sequence[Recalibration | None]
) -> RenderableType:
    """Drift of a unit: a sentence, and one row for each gyro and bin.

    ``notes``: notes about the origin of the runs. ``due_dates``: dates of recalibration, one for each
    trend, or empty.
    """
    scale = BiasScale.of([each.bias_dph for each in trends], [each.sigma_dph for each in trends])
    columns = ("gyro", "bin °C", "runs", "bias", "scatter", "per month", "p", "p corr.")
    due_cells = [[_due_text(each)] for each in due_dates] or [[]] * len(trends)
    rows = [
        [
            each.quantity.gyro,
            bin_label(each.quantity.bin_low_c, each.quantity.bin_high_c, ".."),
            str(len(each.runs)),
            scale.with_sigma(each.bias_dph, each.sigma_dph, "±"),
            scale.text(each.between_runs_dph) if len(each.runs) > 1 else "",
            _slope_text(scale, each),
            p_text(each.p_value),
            p_text(each.p_adjusted),
            *due_cell,
        ]
        for each, due_cell in zip(trends, due_cells, strict=True)
    ]
    table = plain_table((*columns, *(["until"] if due_dates else [])), 2, rows)
    note = (
        f"In {scale.unit}. Scatter: standard deviation between runs beyond their uncertainties, included in "
        "the uncertainty of the slope. p corr.: p-value corrected for all comparisons of the table."
    )
    if due_dates:
        note += " until: last day on which the bias of a run is within the limit."
    parts: list[RenderableType] = [Text(_trend_sentence(unit, trends), style="bold")]
    if due_dates:
        parts.append(Text(recalibration_sentence(unit, due_dates), style="bold"))
    parts += [Text(f"Note: {text}") for text in notes]
    return Group(*parts, Text(), table, Text(), Text(note))


def recalibration_sentence(unit: str, due_dates: Sequence[Recalibration | None]) -> str:
    """Date by which a unit must be calibrated again."""
    determined = [each for each in due_dates if each is not None]
    if not determined:
        return f"Unit {unit}: date of the next calibration unknown. Too few runs show how its biases change."
    earliest = min(determined, key=lambda each: each.months)
    limit = f"{earliest.limit_dph:g} deg/h with {100.0 * earliest.confidence:g} %"
    siblings = f"from its drift and that of {counted(earliest.siblings, 'other unit')}"
    if earliest.months == 0.0:
        return f"Unit {unit}: a bias was not within {limit} at the last run. Calibrate it now."
    if earliest.due is None:
        return f"Unit {unit}: all biases stay within {limit} for {MAX_MONTHS / 12.0:g} years, {siblings}."
    return (
        f"Unit {unit}: calibrate by {earliest.due:%Y-%m-%d}; until then all stay within {limit}, {siblings}."
    )


def _due_text(due: Recalibration | None) -> str:
    if due is None:
        return "unknown"
    return "over" if due.months == 0.0 else "beyond" if due.due is None else f"{due.due:%Y-%m-%d}"


def _trend_sentence(unit: str, trends: Sequence[Trend]) -> str:
    """Gyros that drift significantly, with their slopes."""
    tested = [each for each in trends if each.p_value == each.p_value]
    if not tested:
        return (
            f"Unit {unit}: drift unknown. No gyro was measured in the same bin and positions at three times "
            "or more."
        )
    significant = [each for each in tested if each.is_proven]
    corrected = f"p < {FALSE_ALARM:g}, corrected for {counted(len(tested), 'comparison')}"
    if not significant:
        return f"Unit {unit}: no significant drift ({corrected})."
    scale = BiasScale.of(
        [each.slope_dph_per_month for each in significant],
        [each.slope_sigma_dph_per_month for each in significant],
    )
    texts = [f"{each.quantity.label} by {_slope_text(scale, each, ' ± ')}" for each in significant]
    return f"Unit {unit} drifts: {listed(texts)}, in {scale.unit} per month ({corrected})."


def problems_text(problems: Mapping[str, str]) -> RenderableType:
    """List of folders that can't be read, with reasons."""
    header = f"{counted(len(problems), 'run folder')} can't be read and left out:"
    return Text("\n".join([header, *(f"  {path}: {reason}" for path, reason in problems.items())]))


def answer_table(answer: QueryResult) -> RenderableType:
    """Result of a query."""
    rows = [["" if value is None else _shorten(value) for value in row] for row in answer.rows]
    table = plain_table(answer.columns, len(answer.columns), rows)
    return Group(table, Text(counted(len(answer.rows), "row")))


def _shorten(value: object) -> str:
    text = f"{value:.6g}" if isinstance(value, float) else str(value)
    return text if len(text) <= _MAX_CELL_CHARACTERS else f"{text[: _MAX_CELL_CHARACTERS - 1]}…"


def _slope_text(scale: BiasScale, trend: Trend, separator: str = "±") -> str:
    if trend.p_value != trend.p_value:
        return ""
    text = scale.with_sigma(trend.slope_dph_per_month, trend.slope_sigma_dph_per_month, separator)
    return text if text.startswith("-") else f"+{text}"


def _with_spread(scale: BiasScale, row: Mapping[str, Any], gyro: str) -> str:
    mean, spread = row[f"bias_{gyro}_dph"], row[f"spread_{gyro}_dph"]
    if mean is None:
        return ""
    return scale.text(mean) if spread is None else scale.with_sigma(mean, spread, "±")
