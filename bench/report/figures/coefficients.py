"""Coefficients of the sensors over temperature."""

from __future__ import annotations

import math
from collections.abc import Sequence

from matplotlib.figure import Figure

from gyrobench.bench.bias.budget import NORMAL_K
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
_UNITS = {"ug": "µg"}
#: Height of a row of a legend as a part of its panel's.
_LEGEND_ROW = 0.13
#: Least range of a temperature axis, K.
_MIN_SPAN_C = 2.0


@house_style
def coefficients_figure(rows: Sequence[PlateauCoefficientRow], budget: BudgetSummary | None = None) -> Figure:
    """Each coefficient over temperature with bars of 95 %, by the budget, or for a normal distribution."""
    covered = coverage(budget) if budget else {}
    figure = new_figure(5.6, left_in=0.62, right_in=0.1, wspace=0.3, hspace=0.34)
    panels = figure.subplots(2, 3)
    known_k = [k for (kind, *_), (k, _) in covered.items() if kind in COEFFICIENT_NAMES]
    factors = {f"{k:.2f}" for k in known_k or [NORMAL_K]}
    bars_text = f"bars: 95 %, k = {' to '.join(sorted({min(factors), max(factors)}))}"
    for (kind, title), axes in zip(COEFFICIENT_NAMES.items(), panels.ravel(), strict=True):
        own = [row for row in rows if row.coefficient == kind and not math.isnan(row.value)]
        axes.set_title(f"{title} / {unit_text(own[0].unit)}" if own else title, fontsize=8)
        for name, cycle in dict.fromkeys((row.axis, row.cycle) for row in own):
            chosen = [row for row in own if (row.axis, row.cycle) == (name, cycle)]
            colour, line, marker = GYRO_STYLES[name[0]]
            is_second = len(name) > 1 and name[1] == max(set("xyz") - {name[0]})
            bars = [
                covered.get((kind, name, row.plateau, 0.0), (NORMAL_K, NORMAL_K * row.sigma))
                for row in chosen
            ]
            axes.errorbar(
                [row.temperature_c for row in chosen],
                [row.value for row in chosen],
                [expanded for _, expanded in bars],
                label=name if cycle == own[0].cycle else None,
                color=colour,
                linestyle=line,
                marker=marker,
                markersize=4,
                markerfacecolor="white" if is_second else colour,
                capsize=2,
            )
        if not own:
            axes.text(0.5, 0.5, "not observable", transform=axes.transAxes, ha="center")
            axes.set(xticks=[], yticks=[])
        else:
            low, high = axes.get_ylim()
            of_bars = bars_text if axes is panels[0, 0] else None
            style = {"title": of_bars, "title_fontsize": 7, "columnspacing": 0.8, "handlelength": 1.8}
            legend = axes.legend(ncols=3, loc="upper center", **style)
            rows_in_it = math.ceil(len(legend.texts) / 3) + bool(of_bars)
            axes.set_ylim(low, high + _LEGEND_ROW * (high - low) * rows_in_it)
            first_c, last_c = axes.get_xlim()
            beside_c = max(0.0, 0.5 * (_MIN_SPAN_C - (last_c - first_c)))
            axes.set_xlim(first_c - beside_c, last_c + beside_c)
    for sensor, row in zip(("gyro", "case"), panels, strict=True):
        for axes in row:
            axes.set_xlabel(f"{sensor} temperature / °C")
    return figure


def unit_text(unit: str) -> str:
    """Unit of the table as it is printed."""
    return _UNITS.get(unit, unit)
