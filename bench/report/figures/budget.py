"""Shares of the error sources in the variance of measured biases."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from gyrobench.bench.bias.error_sources import SOURCES
from gyrobench.bench.navigation.positions import gyro_label
from gyrobench.bench.report.figures.style import LEGEND_ROW_IN, common_legend, house_style, new_figure
from gyrobench.bench.runs.tables.budget_table import COMBINED, BudgetSummary

#: Colours of Okabe and Ito, and hatches, for the sources with the largest shares; the rest is grey.
_SOURCE_STYLES = (
    ("#0072B2", ""),
    ("#E69F00", "///"),
    ("#009E73", "..."),
    ("#CC79A7", "xxx"),
    ("#56B4E9", "\\\\\\"),
    ("#D55E00", "+++"),
)
_OTHER_STYLE = ("#bbbbbb", "")
#: Sources whose share is smaller in all bars are drawn together.
_MIN_SHARE = 0.01
_LEGEND_COLUMNS = 2  # columns of the legend


@dataclass(frozen=True)
class Shares:
    """Shares of the variance of the biases of one gyro."""

    label: str
    is_vertical: bool
    count: int  #: Number of dwells.
    sigma_dph: float  #: Root mean square of the standard uncertainties.
    parts: Mapping[
        str, float
    ]  #: Share of each source, key of :data:`gyrobench.bench.bias.error_sources.SOURCES`.


def variance_shares(budget: BudgetSummary) -> list[Shares]:
    """Shares of the variance of each gyro's biases, level and vertical, over the dwells."""
    result = []
    for (axis, is_vertical), contributions in sorted(budget.dwells.items(), key=lambda each: each[0]):
        total, count = contributions[COMBINED].variance, contributions[COMBINED].count
        parts = {
            name: each.variance / total
            for name, each in contributions.items()
            if each.share_count and name != COMBINED
        }
        label = f"{gyro_label(axis)} {level_or_vertical(is_vertical)}"
        result.append(Shares(label, is_vertical, count, math.sqrt(total / count), parts))
    return result


def level_or_vertical(is_vertical: bool) -> str:
    """Orientation of a gyro as a word."""
    return "vertical" if is_vertical else "level"


@house_style
def budget_figure(bars: Sequence[Shares]) -> Figure:
    """Draw the shares as one bar for each gyro, level and vertical."""
    largest = {name: max(each.parts.get(name, 0.0) for each in bars) for name in SOURCES}
    order = sorted(largest, key=lambda name: -largest[name])
    named = [name for name in order[: len(_SOURCE_STYLES)] if largest[name] >= _MIN_SHARE]
    legend_in = LEGEND_ROW_IN * math.ceil((len(named) + 1) / _LEGEND_COLUMNS)
    figure = new_figure(
        0.4 + legend_in + 0.2 * len(bars), left_in=1.2, right_in=1.35, top_in=0.05, bottom_in=0.4
    )
    axes = figure.add_subplot()
    rows = range(len(bars))
    starts = [0.0] * len(bars)
    for name, (colour, hatch) in [*zip(named, _SOURCE_STYLES, strict=False), ("", _OTHER_STYLE)]:
        widths = [
            100.0
            * (
                each.parts.get(name, 0.0)
                if name
                else 1.0 - sum(each.parts.get(source, 0.0) for source in named)
            )
            for each in bars
        ]
        label = SOURCES[name].title if name else f"other, each below {100.0 * _MIN_SHARE:g} %"
        axes.barh(
            rows,
            widths,
            0.72,
            starts,
            color=colour,
            hatch=hatch,
            edgecolor="white",
            linewidth=0.4,
            label=label,
        )
        starts = [start + width for start, width in zip(starts, widths, strict=True)]
    for row, each in zip(rows, bars, strict=True):
        axes.annotate(
            f"{each.sigma_dph:#.2g} deg/h ({each.count})",
            (100.0, row), (4, 0), textcoords="offset points", va="center", fontsize=8,
            annotation_clip=False,
        )  # fmt: skip
    axes.set(
        yticks=rows,
        yticklabels=[each.label for each in bars],
        xlim=(0.0, 100.0),
        xlabel="share of the variance / %",
    )
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    common_legend(figure, [axes], "lower center", ncols=_LEGEND_COLUMNS)
    return figure
