"""Tables for a terminal of 80 columns, readable without colour."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from bench.bias.bins import BiasBin
from bench.bias.equality import PositionComparison
from bench.navigation.positions import AXES, POSITIONS
from bench.procedure.timeline import TimelineRow, hours_minutes
from bench.report.durations import Took, clock_time, durations_by_kind
from bench.report.wording import (
    bin_label,
    bins_by_temperature,
    differing,
    equality_sentence,
    gyro_label,
    p_text,
    position_label,
    scale_of_bins,
    scatter_sentence,
)

_COLUMNS = 80
_P_VALUE = (
    "p equal: probability of such differences if the bias were the same in all positions; * it differs."
)


def bins_table(bins: Sequence[BiasBin], comparisons: Sequence[PositionComparison]) -> RenderableType:
    """Each gyro's bias by temperature bin and position, and whether the positions agree.

    Parameters
    ----------
    bins : sequence of BiasBin
        Of one unit.
    comparisons : sequence of PositionComparison
        What :func:`bench.bias.equality.compare_positions` makes of them.
    """
    parts: list[RenderableType] = []
    for gyro in AXES:
        own = [each for each in bins if each.gyro == gyro]
        if own:
            compared = [each for each in comparisons if each.gyro == gyro]
            sentences = [equality_sentence(compared), scatter_sentence(own)]
            parts += [_heading(gyro, own), _gyro_table(own, compared)]
            parts += [*(Text(one) for one in sentences if one), Text()]
    if not parts:
        return Text("No dwell gave a bias, so there is nothing to put into temperature bins.")
    return Group(*parts, Text(_P_VALUE))


def timeline_table(rows: Sequence[TimelineRow], total_s: float) -> Table:
    """Show what a plan does, when, and for how long."""
    dwells = sum(row.dwells for row in rows)
    table = _table("Plan, times in h:mm", show_footer=True)
    table.add_column("start", footer="all", justify="right", no_wrap=True)
    table.add_column("takes", footer=hours_minutes(total_s), justify="right", no_wrap=True)
    table.add_column("dwells", footer=str(dwells), justify="right", no_wrap=True)
    table.add_column("where", ratio=2)
    table.add_column("what", ratio=3)
    for row in rows:
        table.add_row(row.start, row.duration, str(row.dwells or ""), Text(row.where), Text(row.what))
    return table


def durations_table(took: Took) -> RenderableType:
    """Planned against real duration, by kind of step.

    Parameters
    ----------
    took : mapping of str to sequence of tuple
        Planned and real duration, s, of every step done, by kind.
    """
    kinds = durations_by_kind(took)
    if not kinds:
        return Text("No step was finished.")
    table = _table("Planned and real duration, h:mm:ss")
    table.add_column("kind of step")
    for header in ("steps", "planned", "took", "difference"):
        table.add_column(header, justify="right", no_wrap=True)
    for each in kinds:
        table.add_row(
            each.kind, str(each.count), clock_time(each.planned_s), clock_time(each.took_s), each.difference
        )
    return table


def _heading(gyro: str, bins: Sequence[BiasBin]) -> Text:
    # Not the table's title: rich would fold that to the width of the table.
    unit = scale_of_bins(bins).unit
    return Text(f"{gyro_label(gyro)}: bias ± 1 sigma in {unit} by gyro temperature, °C", style="bold")


def _gyro_table(bins: Sequence[BiasBin], comparisons: Sequence[PositionComparison]) -> Table:
    scale = scale_of_bins(bins)
    measured = {each.position for each in bins}
    positions = [name for name in POSITIONS if name in measured]
    p_values = _p_values(comparisons)
    rows = []
    for low, high, members in bins_by_temperature(bins):
        cells = {
            each.position: scale.with_sigma(each.bias_dph, each.sigma_dph, "±")
            for each in members
            if not each.is_empty
        }
        texts = [cells.get(position, "empty") for position in positions]
        rows.append([bin_label(low, high, ".."), *texts, p_values.get(low, "")])
    table = _table()
    headers = ["bin", *map(position_label, positions), "p equal"]
    for header in headers:
        table.add_column(header, justify="right", no_wrap=header in ("bin", "p equal"))
    between = "±" if _width(headers, rows) <= _COLUMNS else "\n±"
    for row in rows:
        table.add_row(*(Text(cell.replace("±", between)) for cell in row))
    return table


def _p_values(comparisons: Sequence[PositionComparison]) -> dict[float, str]:
    """P-values by the lower end of their bin; a star marks a difference of positions."""
    different = differing(comparisons)
    return {
        each.bin_low_c: f"{p_text(each.p_value)}{'*' if each in different else ' '}" for each in comparisons
    }


def _width(headers: Sequence[str], rows: Sequence[Sequence[str]]) -> int:
    """Columns that a table takes with one space between its cells."""
    widths = [max(map(len, column)) for column in zip(headers, *rows, strict=True)]
    return sum(widths) + len(widths) - 1


def _table(title: str | None = None, *, show_footer: bool = False) -> Table:
    return Table(
        title=title,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        show_edge=False,
        pad_edge=False,
        padding=0,
        show_footer=show_footer,
    )
