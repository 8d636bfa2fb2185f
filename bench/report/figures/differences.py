"""Where the positions differ, and by how much."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gyrobench.bench.bias.bins import PositionComparison
from gyrobench.bench.navigation.positions import AXES, gyro_label
from gyrobench.bench.report.findings import SIGNIFICANCE, differing
from gyrobench.bench.report.style import GYRO_STYLES, house_style, mark_paper_limit, new_figure, say_empty
from gyrobench.bench.report.wording import BiasScale

_LIMIT_COLOUR = "#b3261e"


@house_style
def position_difference_figure(
    comparisons: Sequence[PositionComparison], limit_dph: float | None = None
) -> Figure:
    """Draw the largest difference between positions in every bin of the three gyros.

    Filled markers are differences that chance does not explain; see
    :func:`gyrobench.bench.report.findings.differing`. The limit of acceptance is a line, where there is one.
    """
    found = differing(comparisons)
    scale = BiasScale.of(
        [each.largest_difference_dph for each in comparisons],
        [each.largest_difference_sigma_dph for each in comparisons],
    )
    figure = new_figure(3.6)
    axes = figure.add_subplot()
    for number, gyro in enumerate(AXES):
        for is_found in (True, False):
            chosen = [each for each in comparisons if each.gyro == gyro and (each in found) is is_found]
            _draw_differences(axes, chosen, scale, shift=0.22 * (number - 1), is_found=is_found)
    axes.set(
        title="Largest difference between two positions",
        xlabel="temperature of the gyro, bin / °C",
        ylabel=f"difference / ({scale.unit})",
    )
    if comparisons:
        axes.set_ylim(bottom=0.0)
        if limit_dph is not None:
            _mark_limit(axes, limit_dph * scale.factor)
        mark_paper_limit(axes, along="x")
        figure.legend(loc="outside upper center", ncols=len(AXES))
    else:
        say_empty(axes, "no bin holds dwells of two positions")
    return figure


def _mark_limit(axes: Axes, limit: float) -> None:
    axes.axhline(limit, color=_LIMIT_COLOUR, linewidth=1.0)
    axes.set_ylim(top=max(axes.get_ylim()[1], 1.15 * limit))
    axes.annotate(
        "limit of acceptance",
        (0.0, limit),
        (3, 2),
        xycoords=axes.get_yaxis_transform(),
        textcoords="offset points",
        color=_LIMIT_COLOUR,
        fontsize=7,
    )


def _draw_differences(
    axes: Axes, comparisons: Sequence[PositionComparison], scale: BiasScale, shift: float, is_found: bool
) -> None:
    if not comparisons:
        return
    gyro = comparisons[0].gyro
    colour, _, marker = GYRO_STYLES[gyro]
    verdict = f"p < {SIGNIFICANCE:g}" if is_found else "no difference found"
    widths = [each.bin_high_c - each.bin_low_c for each in comparisons]
    axes.errorbar(
        [0.5 * (c.bin_low_c + c.bin_high_c) + shift * w for c, w in zip(comparisons, widths, strict=True)],
        [each.largest_difference_dph * scale.factor for each in comparisons],
        [each.largest_difference_sigma_dph * scale.factor for each in comparisons],
        label=f"{gyro_label(gyro)}, {verdict}",
        linestyle="none",
        marker=marker,
        markersize=5.0,
        markerfacecolor=colour if is_found else "white",
        color=colour,
        elinewidth=0.9,
        capsize=2.0,
    )
