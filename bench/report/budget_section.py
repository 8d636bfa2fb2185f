"""Uncertainty budget in the report of a run: a box and a figure for its first page, and a section."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from matplotlib.figure import Figure

from gyrobench.bench.bias.error_sources import SOURCES
from gyrobench.bench.foundations.text import bin_label, counted, listed
from gyrobench.bench.navigation.positions import POSITIONS, gyro_label, position_label
from gyrobench.bench.report.figures.style import LEGEND_ROW_IN, common_legend, house_style, new_figure
from gyrobench.bench.report.number_format import BiasScale, range_text
from gyrobench.bench.report.page import Box, Mark, Section, SectionFigure, SectionTable
from gyrobench.bench.runs.tables.budget_table import (
    ANY_POWER_CYCLE,
    COMBINED,
    BudgetRow,
    BudgetSummary,
    ContributionSummary,
)

_SHARES_CAPTION = (
    "Shares of the variance of a dwell's bias; at the right its standard uncertainty (root mean square) and "
    "the number of dwells."
)
#: Smallest share of a variance that the box states.
_MIN_NAMED_SHARE = 0.05
_METHOD = (
    "A bias is linear in the outputs of the INS. With the gains of the estimator fixed, its variance splits "
    "exactly over the independent sources of error; budget.csv has every dwell and every bin. Type A: "
    "estimated from the output of the unit; type B: declared. In the mean of a bin, noise averages out, and "
    "what the dwells have in common does not. U: expanded uncertainty for a coverage probability of 95 %, "
    "with k from the effective degrees of freedom (Welch-Satterthwaite, JCGM 100:2008)."
)
_CONTRIBUTIONS_CAPTION = (
    "Contributions to the uncertainty of the bias of a {} gyro in a dwell: root mean square over {}, in {}. "
    "Sensitivity: deg/h per unit of the input."
)
_BINS_CAPTION = "Expanded uncertainty U (k) of the mean bias of a bin in {}, by temperature of the gyro"
_SUM_TITLES = {COMBINED: "combined", ANY_POWER_CYCLE: "combined, any power cycle"}


def budget_box(budget: BudgetSummary) -> Box | None:
    """Standard uncertainty of a bias with its largest sources; None without a budget."""
    shares_by_gyro, texts = variance_shares(budget), []
    for is_vertical in (False, True):
        group = [each for each in shares_by_gyro if each.is_vertical is is_vertical]
        if not group:
            continue
        total = math.fsum(each.count * each.sigma_dph**2 for each in group)
        parts: dict[str, float] = defaultdict(float)
        for each in group:
            for source, share in each.parts.items():
                parts[source] += share * each.count * each.sigma_dph**2 / total
        largest = sorted((-share, source) for source, share in parts.items() if share >= _MIN_NAMED_SHARE)
        contributions = budget.all_gyros[is_vertical]
        source_texts = listed(
            [f"{-100.0 * share:.0f} % by {_source_text(contributions[source])}" for share, source in largest]
        )
        source_texts = source_texts.replace(" % by", " % of the variance by", 1)
        sigma_dph = math.sqrt(total / sum(each.count for each in group))
        texts.append(f"{sigma_dph:#.2g} deg/h for a {level_or_vertical(is_vertical)} gyro, {source_texts}")
    if not texts:
        return None
    k = range_text([factor for group in budget.all_gyros.values() for factor in group[COMBINED].k], ".2f")
    return Box(
        "open",
        "Standard uncertainty of a bias in a dwell:",
        f"{'; '.join(texts)}. Expanded uncertainty: k = {k} (95 %).",
    )


def budget_figures(budget: BudgetSummary) -> list[SectionFigure]:
    """Figure of the shares of the variance; empty list without a budget."""
    shares_by_gyro = variance_shares(budget)
    return (
        [SectionFigure("uncertainty_budget", _SHARES_CAPTION, partial(budget_figure, shares_by_gyro))]
        if shares_by_gyro
        else []
    )


def budget_section(budget: BudgetSummary, *, is_drawn: bool = False) -> Section | None:
    """Tables of contributions and expanded uncertainties; None without a budget.

    ``is_drawn``: whether the section contains the figure of shares.
    """
    if not budget.dwells:
        return None
    tables = [
        _contributions_table(budget.all_gyros[is_vertical], level_or_vertical(is_vertical))
        for is_vertical in (False, True)
        if is_vertical in budget.all_gyros
    ]
    bins = [row for row in budget.stated if row.result == "bin"]
    figures = budget_figures(budget) if is_drawn else []
    return Section(
        "Uncertainty budget", [_METHOD], figures, tables=[*tables, *([_bins_table(bins)] if bins else [])]
    )


def _contributions_table(contributions: Mapping[str, ContributionSummary], orientation: str) -> SectionTable:
    scale = BiasScale(1000.0, "0.001 deg/h", 3)
    rows: list[list[str]] = []
    marks: list[Mark] = []
    for name in (*SOURCES, *_SUM_TITLES):
        contribution = contributions.get(name)
        if contribution is None:
            continue
        title = _SUM_TITLES.get(name) or SOURCES[name].title
        marks.append("sum" if name in _SUM_TITLES else "")
        if not contribution.known_count:
            rows.append([title, "B", f"{_input_text(contribution)} {contribution.example.note}".strip()])
            continue
        if name in _SUM_TITLES:
            expanded = math.sqrt(contribution.expanded_square / contribution.known_count)
            middle_cells = ["", "", f"U = {scale.text(expanded)}", f"k = {range_text(contribution.k, '.2f')}"]
        else:
            sensitivity = math.sqrt(contribution.sensitivity_square / max(contribution.sensitivity_count, 1))
            cell = f"{sensitivity:.3g}" if sensitivity else ""
            middle_cells = [
                contribution.example.type,
                contribution.example.distribution,
                _input_text(contribution),
                cell,
            ]
        rows.append(
            [
                title,
                *middle_cells,
                scale.text(math.sqrt(contribution.variance / contribution.known_count)),
                f"{100.0 * contribution.share / contribution.share_count:.1f}"
                if contribution.share_count
                else "outside",
                "∞" if math.isinf(contribution.dof) else f"{contribution.dof:.0f}",
            ]
        )
    count = counted(contributions[COMBINED].count, "value")
    header = ["contribution", "type", "distribution", "input", "sensitivity", "u", "% of variance", "dof"]
    return SectionTable(
        _CONTRIBUTIONS_CAPTION.format(orientation, count, scale.unit), header, rows, words=3, marks=marks
    )


def _bins_table(rows: Sequence[BudgetRow]) -> SectionTable:
    scale = BiasScale.of([], [row.expanded / row.k for row in rows])
    positions = [name for name in POSITIONS if any(row.position == name for row in rows)]
    by_bin: dict[tuple[str, float, float], dict[str, str]] = defaultdict(dict)
    for row in rows:
        text = f"{scale.text(row.expanded)} ({row.k:.2f})"
        by_bin[row.axis, row.bin_low_c, row.bin_high_c][row.position] = text
    table_rows = [
        [gyro_label(axis), bin_label(low, high), *(cells.get(name, "") for name in positions)]
        for (axis, low, high), cells in sorted(by_bin.items())
    ]
    return SectionTable(
        _BINS_CAPTION.format(scale.unit), ["gyro", "bin / °C", *map(position_label, positions)], table_rows
    )


def _source_text(contribution: ContributionSummary) -> str:
    evaluation = (
        "estimated"
        if contribution.is_estimated
        else "declared"
        if contribution.is_declared
        else "declared or estimated"
    )
    return SOURCES[contribution.example.contribution].title + (
        f" ({_input_text(contribution)}, {evaluation})" if _input_text(contribution) else ""
    )


def _input_text(contribution: ContributionSummary) -> str:
    """Standard uncertainty of the input, or its range, with unit."""
    low, high = contribution.input_sigma
    return f"{range_text((low, high), ',.4g')} {contribution.example.input_unit}" if low <= high else ""


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
        if name:
            label, shares = SOURCES[name].title, [each.parts.get(name, 0.0) for each in bars]
        else:
            label = f"other, each below {100.0 * _MIN_SHARE:g} %"
            shares = [1.0 - sum(each.parts.get(source, 0.0) for source in named) for each in bars]
        widths = [100.0 * share for share in shares]
        look: dict[str, Any] = {"color": colour, "hatch": hatch, "edgecolor": "white", "linewidth": 0.4}
        axes.barh(rows, widths, 0.72, starts, label=label, **look)
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
