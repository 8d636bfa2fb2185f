"""Bias against temperature, position by position.

Counterparts of the paper's Figs. 8, 9, 12 and 13.

References
----------
Yu et al., "The Six-Position Calibration Technique of Gyro Bias for Rotational Inertial
Navigation System Based on Ring Laser Gyroscope", section 5.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench.bias.bins import BiasBin
from bench.bias.dwell_table import DwellRow
from bench.bias.equality import PositionComparison
from bench.navigation.positions import AXES, POSITIONS
from bench.report.style import (
    GYRO_STYLES,
    POSITION_STYLES,
    house_style,
    mark_paper_limit,
    new_figure,
    say_empty,
)
from bench.report.wording import (
    SIGNIFICANCE,
    BiasScale,
    differing,
    gyro_label,
    position_label,
    scale_of_bins,
)


@house_style
def bias_figure(gyro: str, dwells: Iterable[DwellRow], bins: Iterable[BiasBin]) -> Figure:
    """Draw one gyro's bias against its own temperature, a line for each position.

    Counterpart of the paper's Figs. 8 and 9, or 12 and 13. Single dwells are faint; the lines
    join the weighted means of the bins. All with standard uncertainties.

    Parameters
    ----------
    gyro : {"x", "y", "z"}
        Which gyro.
    dwells : iterable of DwellRow
        Dwells with flags are left out.
    bins : iterable of BiasBin
        Those of other gyros are left out.
    """
    good = [row for row in dwells if not row.flags]
    filled = [each for each in bins if each.gyro == gyro and not each.is_empty]
    axis = AXES.index(gyro)
    scale = scale_of_bins(filled)
    if not filled:
        scale = BiasScale.of([row.bias_dph[axis] for row in good], [row.sigma_dph[axis] for row in good])
    figure = new_figure(4.2)
    axes = figure.add_subplot()
    for position in POSITIONS:
        _draw_dwells(axes, axis, [row for row in good if row.position == position], scale)
        _draw_bins(axes, [each for each in filled if each.position == position], scale)
    axes.set(title=gyro_label(gyro), xlabel="temperature of the gyro / °C", ylabel=f"bias / ({scale.unit})")
    if good or filled:
        mark_paper_limit(axes, along="x")
    else:
        say_empty(axes, "no dwell gave a bias")
    if filled:
        figure.legend(loc="outside right upper")
    return figure


@house_style
def position_difference_figure(comparisons: Sequence[PositionComparison]) -> Figure:
    """Draw the largest difference between positions in every bin of the three gyros.

    Filled markers are differences that chance does not explain; see
    :func:`bench.report.wording.differing`.
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
        mark_paper_limit(axes, along="x")
        figure.legend(loc="outside upper center", ncols=len(AXES))
    else:
        say_empty(axes, "no bin holds dwells of two positions")
    return figure


def _draw_dwells(axes: Axes, axis: int, rows: Sequence[DwellRow], scale: BiasScale) -> None:
    if not rows:
        return
    style = POSITION_STYLES[rows[0].position]
    axes.errorbar(
        [row.gyro_c[axis] for row in rows],
        [row.bias_dph[axis] * scale.factor for row in rows],
        [row.sigma_dph[axis] * scale.factor for row in rows],
        linestyle="none",
        marker=style.marker,
        markersize=3.0,
        markerfacecolor=style.face,
        color=style.colour,
        elinewidth=0.7,
        alpha=0.35,
    )


def _draw_bins(axes: Axes, bins: Sequence[BiasBin], scale: BiasScale) -> None:
    if not bins:
        return
    style = POSITION_STYLES[bins[0].position]
    axes.errorbar(
        [each.temperature_c for each in bins],
        [each.bias_dph * scale.factor for each in bins],
        [each.sigma_dph * scale.factor for each in bins],
        label=position_label(bins[0].position),
        linestyle=style.line,
        marker=style.marker,
        markersize=5.5,
        markerfacecolor=style.face,
        color=style.colour,
        capsize=2.0,
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
