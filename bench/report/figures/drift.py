"""Drift of a unit's biases over its runs."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import timedelta

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure

from gyrobench.bench.foundations.text import bin_label
from gyrobench.bench.navigation.positions import AXES, gyro_label
from gyrobench.bench.report.figures.style import BARS_SHORT, fitted_figure, house_style, label_empty
from gyrobench.bench.report.number_format import BiasScale, p_text
from gyrobench.bench.runs.index.run_biases import Trend, months_since_first

_MARKERS = "os^Dv<>P*X"
_BIN_OFFSET_DAYS = 0.6
#: Heights: minimum of a panel, a line of a legend, and the head of a legend with the gap between panels.
_PANEL_INCHES, _LINE_INCHES, _HEAD_INCHES = 2.2, 0.19, 0.8


@house_style
def trend_figure(unit: str, trends: Sequence[Trend]) -> Figure:
    """Draw the biases of a unit over its runs, one panel for each gyro, one colour for each temperature bin.

    Significant slopes have a solid line, others a dotted one.
    """
    has_slopes = any(each.p_value == each.p_value for each in trends)
    bins = max(sum(each.quantity.gyro == gyro for each in trends) for gyro in AXES)
    legend_inches = _HEAD_INCHES + _LINE_INCHES * bins * (2 if has_slopes else 1)
    figure = fitted_figure(0.6 + len(AXES) * max(_PANEL_INCHES, legend_inches))
    panels = figure.subplots(len(AXES), 1, sharex=True)
    scale = BiasScale.of([each.bias_dph for each in trends], [each.sigma_dph for each in trends])
    lows_c = sorted({each.quantity.bin_low_c for each in trends})
    for gyro, panel in zip(AXES, panels, strict=True):
        gyro_trends = [each for each in trends if each.quantity.gyro == gyro]
        for each in gyro_trends:
            _draw_trend(panel, each, scale, lows_c.index(each.quantity.bin_low_c), len(lows_c))
        panel.set_title(gyro_label(gyro))
        panel.set_ylabel(f"bias / ({scale.unit})")
        if gyro_trends:
            panel.legend(
                loc="center left",
                bbox_to_anchor=(1.0, 0.5),
                title=f"bin{'; slope per month' if has_slopes else ''}\n{BARS_SHORT}",
                title_fontsize=8,
            )
        else:
            label_empty(panel, "no uncompensated bias")
    locator = AutoDateLocator(minticks=3, maxticks=9)
    panels[-1].xaxis.set_major_locator(locator)
    panels[-1].xaxis.set_major_formatter(ConciseDateFormatter(locator))
    panels[-1].set_xlabel("start of the run (UTC)")
    figure.suptitle(f"Unit {unit}: bias over time, mean of the positions measured each time", fontsize=10)
    return figure


def _draw_trend(panel: Axes, trend: Trend, scale: BiasScale, bin_index: int, bin_count: int) -> None:
    colour = mpl.colormaps["viridis"](bin_index / max(bin_count, 2))
    offset = timedelta(days=_BIN_OFFSET_DAYS * (bin_index - (bin_count - 1) / 2.0))
    times = [run.started_utc + offset for run in trend.runs]
    quantity = trend.quantity
    label = f"{bin_label(quantity.bin_low_c, quantity.bin_high_c)} °C"
    if trend.p_value == trend.p_value:
        slope = scale.with_sigma(trend.slope_dph_per_month, trend.slope_sigma_dph_per_month)
        label += f"\n{slope}, p {p_text(trend.p_adjusted)}"
        months = np.array(months_since_first(trend.runs))
        line = trend.bias_dph + trend.slope_dph_per_month * (months - months.mean())
        style = "-" if trend.is_proven else ":"
        panel.plot(np.asarray(times), scale.factor * line, style, color=colour)
    panel.errorbar(
        np.asarray(times),
        scale.factor * np.array([run.bias_dph for run in trend.runs]),
        scale.factor * np.array([run.sigma_dph for run in trend.runs]),
        fmt=_MARKERS[bin_index % len(_MARKERS)],
        color=colour,
        markersize=3.5,
        elinewidth=0.9,
        label=label,
    )
