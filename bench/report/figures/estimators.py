"""How the estimators differ, and whether the error model explains the data."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from gyrobench.bench.bias.dwell_table import DwellRow, paper_rows
from gyrobench.bench.bias.statistics import uniformity_band
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.report.figures.style import (
    BARS,
    POSITION_STYLES,
    common_legend,
    house_style,
    mark_temperatures,
    new_figure,
    say_empty,
)
from gyrobench.bench.report.number_format import PAPER, STATE_SPACE, BiasScale
from gyrobench.bench.report.statements import SIGNIFICANCE

_DODGE = 0.012  # of the range of temperatures, between neighbouring positions


@house_style
def estimators_figure(dwells: Iterable[DwellRow], marked_c: Sequence[float] = ()) -> Figure:
    """Draw the difference of the two estimates of every unflagged dwell against the gyro's temperature.

    Bars are combined uncertainties. Both use the same data, so noise alone separates them by less:
    points beyond their bars show systematic errors of the paper's method. Lines mark ``marked_c`` in degC.
    """
    both = with_both(dwells)
    pairs = [pair for row in both for pair in differences_dph(row)]
    scale = BiasScale.of(*(zip(*pairs, strict=True) if pairs else ((), ())))
    figure = new_figure(3.6, left_in=0.85)
    panels = figure.subplots(1, len(AXES), sharex=True, sharey=True)
    for axis, (gyro, axes) in enumerate(zip(AXES, panels, strict=True)):
        axes.set_title(gyro_label(gyro))
        axes.axhline(0.0, color="#444444", linewidth=0.9)
        _draw_estimator_differences(axes, axis, both, scale, marked_c)
    panels[0].set_ylabel(f"{PAPER} minus\n{STATE_SPACE} / ({scale.unit})")
    panels[1].set_xlabel("temperature of the gyro / °C")
    common_legend(figure, panels[:1], ncols=len(POSITIONS), title=BARS)
    if not both:
        say_empty(panels[1], "the paper's method gave no bias")
    return figure


def with_both(dwells: Iterable[DwellRow]) -> list[DwellRow]:
    """Dwells without flags that have both estimates."""
    return [row for row in dwells if not row.flags and paper_rows([row])]


def differences_dph(row: DwellRow) -> list[tuple[float, float]]:
    """Paper's method minus state-space bias for each gyro, and combined uncertainties."""
    both = zip(row.bias_dph, row.sigma_dph, row.paper_bias_dph, row.paper_sigma_dph, strict=True)
    return [(paper - bias, math.hypot(sigma, paper_sigma)) for bias, sigma, paper, paper_sigma in both]


def _draw_estimator_differences(
    axes: Axes, axis: int, rows: Sequence[DwellRow], scale: BiasScale, marked_c: Sequence[float]
) -> None:
    temperatures = [row.gyro_c[axis] for row in rows]
    dodge_c = _DODGE * (max(temperatures, default=0.0) - min(temperatures, default=0.0))
    for place, (position, style) in enumerate(POSITION_STYLES.items()):
        own = [row for row in rows if row.position == position]
        if own:
            pairs = [differences_dph(row)[axis] for row in own]
            _, _, bars = axes.errorbar(
                [row.gyro_c[axis] + (place - 2.5) * dodge_c for row in own],
                [difference * scale.factor for difference, _ in pairs],
                [sigma * scale.factor for _, sigma in pairs],
                label=position_label(position),
                linestyle="none",
                marker=style.marker,
                markersize=4.0,
                markerfacecolor=style.face,
                color=style.colour,
                elinewidth=0.7,
            )
            bars[0].set_alpha(0.4)
    if rows:
        mark_temperatures(axes, "x", marked_c)


#: Probability of the band, matching the significance level of the test.
_BAND = 1.0 - SIGNIFICANCE
#: Least number of p-values for a distribution.
_MIN_FOR_DISTRIBUTION = 5
#: Minimum range of the residuals' axis.
_RATIOS = (0.8, 1.2)
_MARGIN = 0.05


@house_style
def fit_figure(dwells: Iterable[DwellRow]) -> Figure:
    """Draw the size of the residuals of each dwell tested, and the distribution of their p-values.

    Dwells with flags are crossed out. Few dwells have no distribution: see :func:`has_distribution`.
    """
    tested = _tested(dwells)
    figure = new_figure(3.4, wspace=0.22)
    ratios = [1.5, 1.0] if has_distribution(tested) else [1.0]
    panels = figure.subplots(1, len(ratios), width_ratios=ratios, squeeze=False)[0]
    panels[0].set(title="Size of residuals", xlabel="dwell", ylabel="residual / expected")
    if not tested:
        say_empty(panels[0], "no dwell tested")
        return figure
    _draw_ratios(panels[0], tested)
    for axes in panels[1:]:
        _draw_distribution(axes, [row.fit_p_value for row in tested])
    common_legend(figure, panels, ncols=len(POSITIONS) + 1)
    return figure


def has_distribution(dwells: Iterable[DwellRow]) -> bool:
    """Whether enough dwells were tested for a distribution of their p-values."""
    return len(_tested(dwells)) >= _MIN_FOR_DISTRIBUTION


def _tested(dwells: Iterable[DwellRow]) -> list[DwellRow]:
    return [row for row in dwells if not math.isnan(row.fit_p_value)]


def _draw_ratios(axes: Axes, rows: Sequence[DwellRow]) -> None:
    axes.axhline(1.0, color="#444444", linewidth=0.9)
    for position, style in POSITION_STYLES.items():
        own = [row for row in rows if row.position == position]
        if own:
            axes.plot(
                [row.dwell for row in own],
                [row.fit_ratio for row in own],
                label=position_label(position),
                linestyle="none",
                marker=style.marker,
                markersize=4.5,
                markerfacecolor=style.face,
                color=style.colour,
            )
    flagged = [row for row in rows if row.flags]
    if flagged:
        axes.plot(
            [row.dwell for row in flagged],
            [row.fit_ratio for row in flagged],
            label="flagged",
            linestyle="none",
            marker="x",
            markersize=8.0,
            color="#b3261e",
        )
    _set_ranges(axes, [row.dwell for row in rows], [row.fit_ratio for row in rows])


def _set_ranges(axes: Axes, numbers: Sequence[int], ratios: Sequence[float]) -> None:
    low, high = min(*ratios, _RATIOS[0]), max(*ratios, _RATIOS[1])
    margin = _MARGIN * (high - low)
    side = max(_MARGIN * (max(numbers) - min(numbers)), 0.5)
    axes.set(ylim=(low - margin, high + margin), xlim=(min(numbers) - side, max(numbers) + side))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))


def _draw_distribution(axes: Axes, p_values: Sequence[float]) -> None:
    """Draw the cumulative distribution of the p-values and its band if the model is correct."""
    axes.set(title="p-values", xlabel="p-value of the fit", ylabel="share of dwells below")
    axes.set(xlim=(0, 1), ylim=(0, 1))
    count = len(p_values)
    band = uniformity_band(count, _BAND)
    ends = np.array([0.0, 1.0])
    axes.fill_between(ends, ends - band, ends + band, color="#dddddd", label="_band", linewidth=0.0)
    axes.plot(ends, ends, color="#444444", linewidth=0.9)
    axes.annotate(
        f"grey: {_BAND:.0%} band",
        (1.0, 0.0),
        (-3, 3),
        xycoords="axes fraction",
        textcoords="offset points",
        ha="right",
        fontsize=7,
        color="#444444",
    )
    axes.step(
        [0.0, *np.sort(p_values), 1.0], [*np.arange(count + 1) / count, 1.0], where="post", color="#0072B2"
    )
