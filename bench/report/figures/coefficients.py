"""Sensor coefficients over temperature."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.figure import Figure

from gyrobench.bench.bias.budget import NORMAL_K
from gyrobench.bench.foundations.text import with_micro_sign
from gyrobench.bench.report.figures.style import GYRO_STYLES, house_style, new_figure
from gyrobench.bench.runs.tables.budget_table import BudgetSummary, coverage
from gyrobench.bench.runs.tables.coefficient_table import PlateauCoefficientRow

COEFFICIENT_NAMES = {
    "gyro_bias": "gyro bias",
    "gyro_scale_factor": "gyro scale factor",
    "gyro_misalignment": "gyro misalignment",
    "accelerometer_bias": "accel. bias",
    "accelerometer_scale_factor": "accel. scale factor",
    "accelerometer_misalignment": "accel. misalignment",
}
#: Height of a legend row relative to that of its panel.
_LEGEND_ROW = 0.13
#: Smallest range of a temperature axis, K.
_MIN_SPAN_C = 2.0


@house_style
def coefficients_figure(rows: Sequence[PlateauCoefficientRow], budget: BudgetSummary | None = None) -> Figure:
    """Draw each coefficient over temperature; 95 % bars by the budget, else for normal errors."""
    coverage_by_coefficient = coverage(budget) if budget else {}
    figure = new_figure(5.6, left_in=0.62, right_in=0.1, wspace=0.3, hspace=0.34)
    panels = figure.subplots(2, 3)
    coverage_factors = [
        k for (kind, *_), (k, _) in coverage_by_coefficient.items() if kind in COEFFICIENT_NAMES
    ]
    factor_texts = {f"{k:.2f}" for k in coverage_factors or [NORMAL_K]}
    bars_text = f"bars: 95 %, k = {' to '.join(sorted({min(factor_texts), max(factor_texts)}))}"
    for (kind, title), axes in zip(COEFFICIENT_NAMES.items(), panels.ravel(), strict=True):
        kind_rows = [row for row in rows if row.coefficient == kind and not math.isnan(row.value)]
        axes.set_title(f"{title} / {with_micro_sign(kind_rows[0].unit)}" if kind_rows else title, fontsize=8)
        for axis_name, cycle in dict.fromkeys((row.axis, row.cycle) for row in kind_rows):
            cycle_rows = [row for row in kind_rows if (row.axis, row.cycle) == (axis_name, cycle)]
            colour, line, marker = GYRO_STYLES[axis_name[0]]
            is_second = len(axis_name) > 1 and axis_name[1] == max(set("xyz") - {axis_name[0]})
            expanded_by_row = [
                coverage_by_coefficient.get(
                    (kind, axis_name, row.plateau, 0.0), (NORMAL_K, NORMAL_K * row.sigma)
                )
                for row in cycle_rows
            ]
            axes.errorbar(
                [row.temperature_c for row in cycle_rows],
                [row.value for row in cycle_rows],
                [expanded for _, expanded in expanded_by_row],
                label=axis_name if cycle == kind_rows[0].cycle else None,
                color=colour,
                linestyle=line,
                marker=marker,
                markersize=4,
                markerfacecolor="white" if is_second else colour,
                capsize=2,
            )
        if not kind_rows:
            axes.text(0.5, 0.5, "not observable", transform=axes.transAxes, ha="center")
            axes.set(xticks=[], yticks=[])
        else:
            low, high = axes.get_ylim()
            bars_title = bars_text if axes is panels[0, 0] else None
            style = {"title": bars_title, "title_fontsize": 7, "columnspacing": 0.8, "handlelength": 1.8}
            legend = axes.legend(ncols=3, loc="upper center", **style)
            legend_rows = math.ceil(len(legend.texts) / 3) + bool(bars_title)
            axes.set_ylim(low, high + _LEGEND_ROW * (high - low) * legend_rows)
            first_c, last_c = axes.get_xlim()
            margin_c = max(0.0, 0.5 * (_MIN_SPAN_C - (last_c - first_c)))
            axes.set_xlim(first_c - margin_c, last_c + margin_c)
    for sensor, row in zip(("gyro", "case"), panels, strict=True):
        for axes in row:
            axes.set_xlabel(f"{sensor} temperature / °C")
    return figure
