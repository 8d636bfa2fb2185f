"""Uncertainty budget in the report of a run: a statement and a figure for its first page, and a section."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from functools import partial

from gyrobench.bench.bias.error_sources import SOURCES
from gyrobench.bench.foundations.text import bin_label, counted, listed
from gyrobench.bench.navigation.positions import POSITIONS, gyro_label, position_label
from gyrobench.bench.report.figures.budget import budget_figure, level_or_vertical, shares
from gyrobench.bench.report.number_format import BiasScale
from gyrobench.bench.report.page import Box, Mark, Section, SectionFigure, SectionTable
from gyrobench.bench.runs.tables.budget_table import (
    ANY_POWER_CYCLE,
    COMBINED,
    BudgetRow,
    BudgetSummary,
    ContributionSummary,
)

_CAPTION = (
    "Shares of the variance of a dwell's bias; at the right its standard uncertainty (root mean square) and "
    "the number of dwells."
)
#: Share of a variance that a statement names at least.
_NAMED = 0.05
_HOW = (
    "A bias is linear in the outputs of the INS. With the gains of the estimator fixed, its variance splits "
    "exactly over the independent sources of error; budget.csv has every dwell and every bin. Type A: "
    "estimated from the output of the unit; type B: declared. In the mean of a bin, noise averages out, and "
    "what the dwells have in common does not. U: expanded uncertainty for a coverage probability of 95 %, "
    "with k from the effective degrees of freedom (Welch-Satterthwaite, JCGM 100:2008)."
)
_CONTRIBUTIONS = (
    "Contributions to the uncertainty of the bias of a {} gyro in a dwell: root mean square over {}, in {}. "
    "Sensitivity: deg/h per unit of the input."
)
_BINS = "Expanded uncertainty U (k) of the mean bias of a bin in {}, by temperature of the gyro"
_SUMS = {COMBINED: "combined", ANY_POWER_CYCLE: "combined, any power cycle"}


def budget_box(budget: BudgetSummary) -> Box | None:
    """State why the uncertainty is what it is; None without a budget."""
    found, texts = shares(budget), []
    for is_vertical in (False, True):
        own = [each for each in found if each.is_vertical is is_vertical]
        if not own:
            continue
        total = math.fsum(each.count * each.sigma_dph**2 for each in own)
        parts: dict[str, float] = defaultdict(float)
        for each in own:
            for source, share in each.parts.items():
                parts[source] += share * each.count * each.sigma_dph**2 / total
        largest = sorted((-share, source) for source, share in parts.items() if share >= _NAMED)
        of_kind = budget.all_gyros[is_vertical]
        causes = listed([f"{-100.0 * share:.0f} % by {_cause(of_kind[source])}" for share, source in largest])
        causes = causes.replace(" % by", " % of the variance by", 1)
        sigma_dph = math.sqrt(total / sum(each.count for each in own))
        texts.append(f"{sigma_dph:#.2g} deg/h for a {level_or_vertical(is_vertical)} gyro, {causes}")
    if not texts:
        return None
    k = _range([end for own in budget.all_gyros.values() for end in own[COMBINED].k], ".2f")
    return Box(
        "open", "Standard uncertainty of a bias in a dwell:", f"{'; '.join(texts)}. U = {k} sigma (95 %)."
    )


def budget_figures(budget: BudgetSummary) -> list[SectionFigure]:
    """The figure of shares; none without a budget."""
    found = shares(budget)
    return [SectionFigure("uncertainty_budget", _CAPTION, partial(budget_figure, found))] if found else []


def budget_section(budget: BudgetSummary, *, is_drawn: bool = False) -> Section | None:
    """The contributions and the expanded uncertainties in tables, ``is_drawn``: and in the figure of shares.

    None without a budget.
    """
    if not budget.dwells:
        return None
    tables = [
        _contributions(budget.all_gyros[is_vertical], level_or_vertical(is_vertical))
        for is_vertical in (False, True)
        if is_vertical in budget.all_gyros
    ]
    bins = [row for row in budget.stated if row.result == "bin"]
    figures = budget_figures(budget) if is_drawn else []
    return Section("Uncertainty budget", [_HOW], figures, tables=[*tables, *([_bins(bins)] if bins else [])])


def _contributions(own: Mapping[str, ContributionSummary], kind: str) -> SectionTable:
    scale = BiasScale(1000.0, "0.001 deg/h", 3)
    lines: list[list[str]] = []
    marks: list[Mark] = []
    for name in (*SOURCES, *_SUMS):
        each = own.get(name)
        if each is None:
            continue
        title = _SUMS.get(name) or SOURCES[name].title
        marks.append("sum" if name in _SUMS else "")
        if not each.known:
            lines.append([title, "B", f"{_input(each)} {each.example.note}".strip()])
            continue
        if name in _SUMS:
            expanded = math.sqrt(each.expanded_square / each.known)
            middle = ["", "", f"U = {scale.text(expanded)}", f"k = {_range(each.k, '.2f')}"]
        else:
            sensitivity = math.sqrt(each.sensitivity_square / max(each.sensitivities, 1))
            cell = f"{sensitivity:.3g}" if sensitivity else ""
            middle = [each.example.type, each.example.distribution, _input(each), cell]
        lines.append(
            [
                title,
                *middle,
                scale.text(math.sqrt(each.variance / each.known)),
                f"{100.0 * each.share / each.shares:.1f}" if each.shares else "outside",
                "∞" if math.isinf(each.dof) else f"{each.dof:.0f}",
            ]
        )
    count = counted(own[COMBINED].count, "value")
    header = ["contribution", "type", "distribution", "input", "sensitivity", "u", "% of variance", "dof"]
    return SectionTable(_CONTRIBUTIONS.format(kind, count, scale.unit), header, lines, words=3, marks=marks)


def _bins(rows: Sequence[BudgetRow]) -> SectionTable:
    scale = BiasScale.of([], [row.expanded / row.k for row in rows])
    positions = [name for name in POSITIONS if any(row.position == name for row in rows)]
    by_bin: dict[tuple[str, float, float], dict[str, str]] = defaultdict(dict)
    for row in rows:
        cell = f"{scale.text(row.expanded)} ({row.k:.2f})"
        by_bin[row.axis, row.bin_low_c, row.bin_high_c][row.position] = cell
    lines = [
        [gyro_label(axis), bin_label(low, high), *(cells.get(name, "") for name in positions)]
        for (axis, low, high), cells in sorted(by_bin.items())
    ]
    return SectionTable(
        _BINS.format(scale.unit), ["gyro", "bin / °C", *map(position_label, positions)], lines
    )


def _cause(every: ContributionSummary) -> str:
    how = "estimated" if every.is_estimated else "declared" if every.is_declared else "declared or estimated"
    return SOURCES[every.example.contribution].title + (f" ({_input(every)}, {how})" if _input(every) else "")


def _input(every: ContributionSummary) -> str:
    """Standard uncertainty of the input, or its range, with the unit."""
    low, high = every.input_sigma
    return f"{_range((low, high), ',.4g')} {every.example.input_unit}" if low <= high else ""


def _range(values: Iterable[float], form: str) -> str:
    """Smallest and largest of some values, or the one that all are."""
    ordered = sorted(values)
    return " to ".join(dict.fromkeys(format(each, form) for each in (ordered[0], ordered[-1])))
