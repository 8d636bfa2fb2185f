"""A gyro's bias by position in two runs, side by side on one scale: before and after a change.

Counterparts of the paper's Figs. 8 and 12, and of 9 and 13.
"""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.artist import Artist
from matplotlib.figure import Figure

from gyrobench.bench.bias.bins import BiasBin
from gyrobench.bench.navigation.positions import POSITIONS, gyro_label
from gyrobench.bench.report.figures.bias import draw_bins
from gyrobench.bench.report.style import house_style, mark_paper_limit, new_figure, say_empty
from gyrobench.bench.report.wording import scale_of_bins


@house_style
def before_after_figure(gyro: str, before: Sequence[BiasBin], after: Sequence[BiasBin]) -> Figure:
    """Draw one gyro's bias against its temperature, a line for each position, a panel for each run.

    Parameters
    ----------
    gyro : {"x", "y", "z"}
        Which gyro.
    before, after : sequence of BiasBin
        Of the two runs; those of other gyros are left out.
    """
    runs = [[each for each in bins if each.gyro == gyro and not each.is_empty] for bins in (before, after)]
    scale = scale_of_bins([each for bins in runs for each in bins])
    figure = new_figure(3.6)
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, name, bins in zip(panels, ("before", "after"), runs, strict=True):
        axes.set(title=f"{gyro_label(gyro)}, {name}", xlabel="temperature of the gyro / °C")
        for position in POSITIONS:
            draw_bins(axes, [each for each in bins if each.position == position], scale)
        if not bins:
            say_empty(axes, "no dwell gave a bias")
    panels[0].set(ylabel=f"bias / ({scale.unit})")
    handles: dict[str, Artist] = {}
    for axes in panels:
        if any(runs):
            mark_paper_limit(axes, along="x")
        lines, labels = axes.get_legend_handles_labels()
        handles |= dict(zip(labels, lines, strict=True))
    if handles:
        figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=len(POSITIONS))
    return figure
