"""What the figures of a search for effects share: colours, and dwells as points."""

from __future__ import annotations

from matplotlib.axes import Axes

from gyrobench.bench.foundations.arrays import BoolArray, FloatArray
from gyrobench.bench.report.figures.style import GYRO_STYLES

#: Bars before and after; candidates that were found, are tied, or neither.
BEFORE_COLOUR, AFTER_COLOUR = "#AAAAAA", "#0072B2"
FOUND_COLOUR, TIED_COLOUR, OTHER_COLOUR = "#0072B2", "#E69F00", "#CCCCCC"
NOTE_COLOUR, NOISE_COLOUR, BAND_COLOUR = "#666666", "#222222", "#E3E3E3"
_HELD_OUT_COLOUR = "#D55E00"


def draw_dwells(
    axes: Axes,
    along: FloatArray,
    values: FloatArray,
    searched: BoolArray,
    gyro: str,
    size: float = 2.6,
) -> None:
    """Draw a point for each dwell (n,) of a gyro; those held out of the search are hollow."""
    colour, _, marker = GYRO_STYLES[gyro]
    for label, chosen, edge, face in (
        ("searched", searched, colour, colour),
        ("held out", ~searched, _HELD_OUT_COLOUR, "white"),
    ):
        axes.plot(
            along[chosen],
            values[chosen],
            linestyle="none",
            marker=marker,
            markersize=size,
            markeredgewidth=0.2 * size,
            markeredgecolor=edge,
            markerfacecolor=face,
            label=label,
        )
