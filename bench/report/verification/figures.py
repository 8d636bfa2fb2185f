"""What each compensation leaves, as bars by stop, and as the way of a rotational INS over a day."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gyrobench.bench.report.figures.style import house_style, new_figure, say_empty
from gyrobench.bench.report.verification.wording import LABELS
from gyrobench.bench.verification.comparison import DECLARED, EFFECT, NONE, Comparison, ComparisonRow

#: Colour and line of each compensation.
STYLES = {NONE: ("#AAAAAA", ":"), DECLARED: ("#E69F00", "--"), EFFECT: ("#0072B2", "-")}
_NOISE_COLOUR = "#222222"
_GROUP_WIDTH = 0.8
_PANELS = (
    ("bias without the gyros' means", "rms / (0.001 deg/h)", "varying_rms_dph", "bias_noise_dph", 1000.0),
    ("spread between positions", "largest / (0.001 deg/h)", "spread_dph", "spread_noise_dph", 1000.0),
    ("velocity error East", "largest / (mm/s)", "velocity_east_mps", "velocity_noise_mps", 1000.0),
    ("rotational INS in 24 h", "largest error / nmi", "position_nmi", "position_noise_nmi", 1.0),
)


@house_style
def leftovers_figure(comparison: Comparison) -> Figure:
    """Draw the sizes of all stops as bars, one for each compensation, with their noise as a line."""
    figure = new_figure(5.6)
    for axes, (title, unit, size, noise, factor) in zip(figure.subplots(2, 2).ravel(), _PANELS, strict=True):
        _bars(axes, comparison, size, noise, factor)
        axes.set_title(title, fontsize=9)
        axes.set_ylabel(unit)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(handles))
    return figure


@house_style
def day_figure(comparison: Comparison) -> Figure:
    """Draw the distance from the true position over a day, for each stop with all six positions."""
    stops = [
        (rows, days)
        for rows, days in zip(
            zip(*(each.rows for each in comparison.leftovers), strict=False),
            zip(*((stop.day for stop in each.stops) for each in comparison.leftovers), strict=False),
            strict=True,
        )
        if any(days)
    ]
    figure = new_figure(1.0 + 1.7 * max(len(stops), 1))
    panels = figure.subplots(max(len(stops), 1), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    if not stops:
        say_empty(panels[0], "no stop with all six positions")
        return figure
    for axes, (rows, days) in zip(panels, stops, strict=True):
        for row, day in zip(rows, days, strict=True):
            if day is not None:
                colour, line = STYLES[row.compensation]
                axes.plot(
                    day.error.time_s / 3600.0,
                    day.error.distance_nmi,
                    color=colour,
                    linestyle=line,
                    label=LABELS[row.compensation],
                )
        axes.axhline(rows[-1].position_noise_nmi, color=_NOISE_COLOUR, linewidth=0.8, label="noise")
        axes.set_title(f"{rows[0].gyro_c:.0f} °C", fontsize=9)
        axes.set_ylabel("distance / nmi")
    panels[-1].set_xlabel("time / h")
    panels[-1].set_xlim(0.0, 24.0)
    panels[-1].set_xticks(np.arange(0, 25, 4))
    panels[-1].set_ylim(bottom=0.0)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(handles))
    return figure


def _bars(axes: Axes, comparison: Comparison, size: str, noise: str, factor: float) -> None:
    rows = [row for row in comparison.leftovers[0].rows if not math.isnan(getattr(row, size))]
    shown = [row.stop for row in rows]
    if not rows:
        say_empty(axes, "not measured")
        return
    places = np.arange(len(rows))
    width = _GROUP_WIDTH / len(comparison.leftovers)
    for number, left in enumerate(comparison.leftovers):
        values = [factor * getattr(row, size) for row in left.rows if row.stop in shown]
        offset = (number - 0.5 * (len(comparison.leftovers) - 1)) * width
        axes.bar(
            places[: len(values)] + offset,
            values,
            0.92 * width,
            color=STYLES[left.compensation][0],
            label=LABELS[left.compensation],
        )
    noises = [factor * getattr(row, noise) for row in rows]
    axes.hlines(
        noises,
        places - 0.5 * _GROUP_WIDTH,
        places + 0.5 * _GROUP_WIDTH,
        color=_NOISE_COLOUR,
        linewidth=1.2,
        label="noise",
    )
    axes.set_xticks(places, _stop_labels(rows))
    axes.set_ylim(bottom=0.0)
    axes.grid(visible=False, axis="x")


def _stop_labels(rows: Sequence[ComparisonRow]) -> list[str]:
    """Temperature, and the cycle where there are several."""
    several = len({row.cycle for row in rows}) > 1
    return [f"{row.gyro_c:.0f} °C" + (f"\ncycle {row.cycle}" if several else "") for row in rows]
