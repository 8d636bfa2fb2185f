"""Bias against temperature by position, of one run or two, and the largest differences between positions.

References
----------
Yu et al., "The Six-Position Calibration Technique of Gyro Bias for Rotational Inertial
Navigation System Based on Ring Laser Gyroscope", section 5: Figs. 8, 9, 12 and 13.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gyrobench.bench.bias.bins import BiasBin, PositionComparison, paper_bins
from gyrobench.bench.bias.dwell_table import DwellRow, paper_rows
from gyrobench.bench.bias.verdicts import AcceptanceLimits
from gyrobench.bench.foundations.arrays import Triple
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.report.figures.style import (
    BARS,
    GYRO_STYLES,
    POSITION_STYLES,
    common_legend,
    draw_points,
    house_style,
    label_empty,
    mark_temperatures,
    new_figure,
)
from gyrobench.bench.report.number_format import PAPER, STATE_SPACE, BiasScale, scale_of_bins
from gyrobench.bench.report.run_text import POSITION_SIGNIFICANCE, significant_differences

#: Legend title: meaning of bars and numbers.
_LEGEND_TITLE = f"{BARS}; numbers: dwells, if several"
#: Offset of the number of dwells from the end of a bar, points. Each position or gyro has a slot, so that the
#: numbers of coinciding lines do not overlap: three columns above the bar, three below.
_NUMBER_COLUMN_PT, _NUMBER_ROW_PT = 7.5, (2.0, -6.5)
_NUMBER_SLOTS = ("x_up", "z_up", "y_up", "x_down", "z_down", "y_down")
#: Axis range relative to the range of the biases, as in matplotlib.
_MARGIN = 1.1


@dataclass(frozen=True)
class _Panel:
    """Results of one estimator for one gyro."""

    estimator: str
    #: Temperature in degC, bias and its uncertainty in deg/h of each dwell, by position.
    dwells: dict[str, list[Triple]]
    bins: list[BiasBin]

    @property
    def is_empty(self) -> bool:
        return not (any(self.dwells.values()) or self.bins)

    @property
    def bin_biases(self) -> list[tuple[float, float]]:
        """Biases of the bins with their uncertainties, deg/h."""
        return [(each.bias_dph, each.sigma_dph) for each in self.bins]

    @property
    def dwell_biases(self) -> list[tuple[float, float]]:
        """Biases of the dwells with their uncertainties, deg/h."""
        return [(bias, sigma) for values in self.dwells.values() for _, bias, sigma in values]


@house_style
def bias_figure(
    gyro: str,
    dwells: Iterable[DwellRow],
    bins: Iterable[BiasBin],
    span_dph: float = 0.0,
    marked_c: Sequence[float] = (),
) -> Figure:
    """Draw one gyro's bias against its own temperature, a line for each position.

    Counterpart of the paper's Figs. 8 and 9, or 12 and 13. Single dwells without flags are faint; the lines
    join the weighted means of the bins. Bars are standard uncertainties. Results of the paper's method, if
    any, are in a second panel on the same scale. ``span_dph`` is the minimum span of the bias axis, see
    :func:`bias_span_dph`: figures with the same span have the same scale. Lines mark the temperatures
    ``marked_c`` in degC.
    """
    estimator_panels = _panels_of_estimators(gyro, dwells, bins)
    panels = estimator_panels[:1] if estimator_panels[1].is_empty else estimator_panels
    scale = _scale(panels)
    figure = new_figure(4.2, wspace=0.1)  # room between the last and first labels of two panels
    all_axes = figure.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0]
    for axes, panel in zip(all_axes, panels, strict=True):
        axes.set(title=panel.estimator, xlabel="temperature of the gyro / °C")
        for position in POSITIONS:
            if rows := panel.dwells.get(position):
                temperature_c, bias_dph, sigma_dph = np.transpose(rows)
                draw_points(
                    axes,
                    temperature_c,
                    bias_dph * scale.factor,
                    sigma_dph * scale.factor,
                    alpha=0.35,
                    bar_alpha=0.35,
                    markersize=3.0,
                    **POSITION_STYLES[position].points,
                )
            _draw_bins(axes, position, panel.bins, scale)
        if not panel.is_empty:
            mark_temperatures(axes, "x", marked_c)
    all_axes[0].set(ylabel=f"bias / ({scale.unit})")
    (low, high), height = all_axes[0].get_ylim(), _MARGIN * (span_dph * scale.factor)
    if high - low < height:
        middle = 0.5 * (low + high)
        all_axes[0].set_ylim(middle - 0.5 * height, middle + 0.5 * height)
    all_axes[0].set_title(gyro_label(gyro) if len(panels) == 1 else f"{gyro_label(gyro)}, {STATE_SPACE}")
    if estimator_panels[0].is_empty:
        label_empty(all_axes[0], "no dwell gave a bias")
    common_legend(figure, all_axes[:1], ncols=len(POSITIONS), title=_LEGEND_TITLE)
    return figure


def bias_span_dph(dwells: Sequence[DwellRow], bins: Sequence[BiasBin]) -> float:
    """Largest range of the biases of one gyro including their uncertainties, over the gyros."""
    spans = []
    for gyro in AXES:
        panels = _panels_of_estimators(gyro, dwells, bins)
        pairs = [pair for panel in panels for pair in (*panel.bin_biases, *panel.dwell_biases)]
        finite = [pair for pair in pairs if not math.isnan(sum(pair))]
        ends = [bias + sign * sigma for bias, sigma in finite for sign in (-1.0, 1.0)]
        spans.append(max(ends) - min(ends) if ends else 0.0)
    return max(spans)


def _panels_of_estimators(gyro: str, dwells: Iterable[DwellRow], bins: Iterable[BiasBin]) -> list[_Panel]:
    axis = AXES.index(gyro)
    gyro_bins = [each for each in bins if each.gyro == gyro]
    panels = [
        _Panel(STATE_SPACE, {}, _not_empty(gyro_bins)),
        _Panel(PAPER, {}, _not_empty(paper_bins(gyro_bins))),
    ]
    for row in dwells:
        for panel, rows in zip(panels, ([row], paper_rows([row])), strict=True):
            panel.dwells.setdefault(row.position, []).extend(
                (each.gyro_c[axis], each.bias_dph[axis], each.sigma_dph[axis])
                for each in rows
                if not each.flags
            )
    return panels


def _not_empty(bins: Iterable[BiasBin]) -> list[BiasBin]:
    return [each for each in bins if not each.is_empty]


def _scale(panels: Iterable[_Panel]) -> BiasScale:
    panels = list(panels)
    pairs = [pair for panel in panels for pair in panel.bin_biases] or [
        pair for panel in panels for pair in panel.dwell_biases
    ]
    return BiasScale.of(*(zip(*pairs, strict=True) if pairs else ((), ())))


def _draw_bins(axes: Axes, position: str, bins: Iterable[BiasBin], scale: BiasScale) -> None:
    """Draw the biases of one position with their uncertainties, joined by a line."""
    style, chosen = POSITION_STYLES[position], [each for each in bins if each.position == position]
    if chosen:
        options = {"label": position_label(position), "linestyle": style.line, **style.points}
        _draw_line(axes, chosen, scale, _NUMBER_SLOTS.index(position), **options)


def _draw_line(
    axes: Axes, bins: Sequence[BiasBin], scale: BiasScale, slot: int, **style_options: Any
) -> None:
    """Join bins by a line, each with its bar; a number of several dwells is in one of six slots around it."""
    row, column = divmod(slot, 3)
    axes.errorbar(
        [each.temperature_c for each in bins],
        [each.bias_dph * scale.factor for each in bins],
        [each.sigma_dph * scale.factor for each in bins],
        markersize=5.5,
        capsize=2.0,
        **style_options,
    )
    for each in (each for each in bins if each.count > 1):
        axes.annotate(
            str(each.count),
            (each.temperature_c, (each.bias_dph + (1 - 2 * row) * each.sigma_dph) * scale.factor),
            (_NUMBER_COLUMN_PT * (column - 1), _NUMBER_ROW_PT[row]),
            textcoords="offset points",
            ha="center",
            fontsize=5.5,
            color=style_options["color"],
        )


@house_style
def before_after_figure(
    gyro: str, before: Sequence[BiasBin], after: Sequence[BiasBin], marked_c: Sequence[float] = ()
) -> Figure:
    """Draw one gyro's bias against its temperature, a line for each position, a panel for each run.

    Lines mark the temperatures ``marked_c`` in degC.
    """
    runs = [[each for each in bins if each.gyro == gyro and not each.is_empty] for bins in (before, after)]
    scale = scale_of_bins([each for bins in runs for each in bins])
    figure = new_figure(3.6)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, name, bins in zip(panels, ("before", "after"), runs, strict=True):
        axes.set(title=f"{gyro_label(gyro)}, {name}", xlabel="temperature of the gyro / °C")
        for position in POSITIONS:
            _draw_bins(axes, position, bins, scale)
        if not bins:
            label_empty(axes, "no dwell gave a bias")
    panels[0].set(ylabel=f"bias / ({scale.unit})")
    for axes in panels if any(runs) else ():
        mark_temperatures(axes, "x", marked_c)
    common_legend(figure, panels, ncols=len(POSITIONS), title=_LEGEND_TITLE)
    return figure


@house_style
def position_pair_figure(bins: Sequence[BiasBin], marked_c: Sequence[float] = ()) -> Figure:
    """Draw the biases of the three gyros in Z-Up and in Y-Up, the paper's pair of positions, side by side.

    Lines mark the temperatures ``marked_c`` in degC.
    """
    filled_bins = _not_empty(bins)
    pairs = [[each for each in filled_bins if each.position == position] for position in ("z_up", "y_up")]
    scale = scale_of_bins([each for bins_of_position in pairs for each in bins_of_position])
    figure = new_figure(3.4)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, bins_of_position in zip(panels, pairs, strict=True):
        axes.set(title=position_label(bins_of_position[0].position), xlabel="temperature of the gyro / °C")
        for slot, gyro in enumerate(AXES):
            options = dict(zip(("color", "linestyle", "marker"), GYRO_STYLES[gyro], strict=True))
            gyro_bins = [each for each in bins_of_position if each.gyro == gyro]
            _draw_line(axes, gyro_bins, scale, slot, label=gyro_label(gyro), **options)
        mark_temperatures(axes, "x", marked_c)
    panels[0].set(ylabel=f"bias / ({scale.unit})")
    common_legend(figure, panels, ncols=len(AXES), title=_LEGEND_TITLE)
    return figure


_LIMIT_COLOUR = "#b3261e"


@house_style
def position_difference_figure(
    comparisons: Sequence[PositionComparison],
    limits: AcceptanceLimits | None = None,
    marked_c: Sequence[float] = (),
) -> Figure:
    """Draw the largest difference between positions in every bin of the three gyros.

    Filled markers are significant differences; see
    :func:`gyrobench.bench.report.run_text.significant_differences`. Acceptance limits are red lines.
    """
    significant = significant_differences(comparisons)
    scale = BiasScale.of(
        [each.largest_difference_dph for each in comparisons],
        [each.largest_difference_sigma_dph for each in comparisons],
    )
    figure = new_figure(3.6)
    axes = figure.add_subplot()
    for index, gyro in enumerate(AXES):
        for is_significant in (True, False):
            selected = [
                each for each in comparisons if each.gyro == gyro and (each in significant) is is_significant
            ]
            _draw_differences(axes, selected, scale, shift=0.22 * (index - 1), is_significant=is_significant)
    axes.set(
        title="Largest difference between two positions",
        xlabel="temperature of the gyro, bin / °C",
        ylabel=f"difference / ({scale.unit})",
    )
    if comparisons:
        axes.set_ylim(bottom=0.0)
        if limits is not None:
            _mark_limit(axes, limits.position_difference_dph * scale.factor, "acceptance limit")
        if limits is not None and limits.vertical_difference_dph is not None:
            _mark_limit(axes, limits.vertical_difference_dph * scale.factor, "with the gyro up and down")
        mark_temperatures(axes, "x", marked_c)
        common_legend(figure, [axes], "upper center", ncols=len(AXES), title=BARS)
    else:
        label_empty(axes, "no bin has dwells in two positions")
    return figure


def _mark_limit(axes: Axes, limit: float, name: str) -> None:
    axes.axhline(limit, color=_LIMIT_COLOUR, linewidth=1.0)
    axes.set_ylim(top=max(axes.get_ylim()[1], 1.15 * limit))
    axes.annotate(
        name,
        (0.0, limit),
        (3, 2),
        xycoords=axes.get_yaxis_transform(),
        textcoords="offset points",
        color=_LIMIT_COLOUR,
        fontsize=7,
    )


def _draw_differences(
    axes: Axes,
    comparisons: Sequence[PositionComparison],
    scale: BiasScale,
    shift: float,
    is_significant: bool,
) -> None:
    if not comparisons:
        return
    gyro = comparisons[0].gyro
    colour, _, marker = GYRO_STYLES[gyro]
    verdict = f"p < {POSITION_SIGNIFICANCE:g}" if is_significant else "not significant"
    widths = [each.bin_high_c - each.bin_low_c for each in comparisons]
    axes.errorbar(
        [0.5 * (c.bin_low_c + c.bin_high_c) + shift * w for c, w in zip(comparisons, widths, strict=True)],
        [each.largest_difference_dph * scale.factor for each in comparisons],
        [each.largest_difference_sigma_dph * scale.factor for each in comparisons],
        label=f"{gyro_label(gyro)}, {verdict}",
        linestyle="none",
        marker=marker,
        markersize=5.0,
        markerfacecolor=colour if is_significant else "white",
        color=colour,
        elinewidth=0.9,
        capsize=2.0,
    )
