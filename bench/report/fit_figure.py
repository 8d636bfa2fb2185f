"""Does the error model explain the data? The tests of fit of all dwells."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.bias.tables.dwell_table import DwellRow
from bench.bias.uniformity import uniformity_band
from bench.navigation.positions import POSITIONS
from bench.report.style import POSITION_STYLES, house_style, new_figure, say_empty
from bench.report.wording import position_label

_MANY = 0.95


@house_style
def fit_figure(dwells: Iterable[DwellRow]) -> Figure:
    """Draw how large the residuals of each dwell are, and how its p-values are distributed.

    Parameters
    ----------
    dwells : iterable of DwellRow
        Dwells without a test of fit are left out; those with flags are crossed out.
    """
    tested = [row for row in dwells if not math.isnan(row.fit_p_value)]
    figure = new_figure(3.4)
    left, right = figure.subplots(1, 2, width_ratios=[1.5, 1.0])
    left.set(title="Size of the residuals", xlabel="dwell", ylabel="residual / expected")
    right.set(
        title="p-values",
        xlabel="p-value of the fit",
        ylabel="share of dwells below",
        xlim=(0, 1),
        ylim=(0, 1),
    )
    if tested:
        _draw_ratios(left, tested)
        _draw_distribution(right, [row.fit_p_value for row in tested])
        figure.legend(loc="outside lower center", ncols=len(POSITIONS) + 1)
    else:
        say_empty(left, "no dwell was tested")
    return figure


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


def _draw_distribution(axes: Axes, p_values: Sequence[float]) -> None:
    """Draw the share of dwells below each p-value, and the band that chance keeps it in."""
    count = len(p_values)
    band = uniformity_band(count, _MANY)
    ends = np.array([0.0, 1.0])
    axes.fill_between(ends, ends - band, ends + band, color="#dddddd", label="_chance", linewidth=0.0)
    axes.plot(ends, ends, color="#444444", linewidth=0.9)
    axes.annotate(
        f"grey: {_MANY:.0%} by chance",
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
