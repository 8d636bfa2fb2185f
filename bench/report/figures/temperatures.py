"""Temperatures over time with the positions taken: of a run and of a plan.

Counterparts of the paper's Fig. 7.

References
----------
Yu et al., "The Six-Position Calibration Technique of Gyro Bias for Rotational Inertial
Navigation System Based on Ring Laser Gyroscope", section 5.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.report.figures.style import (
    GYRO_STYLES,
    POSITION_STYLES,
    common_legend,
    house_style,
    mark_temperatures,
    new_figure,
    say_empty,
)

if TYPE_CHECKING:
    from gyrobench.bench.procedure.plan import Plan

#: Column name to values, as :func:`gyrobench.bench.runs.telemetry.read_telemetry` gives them.
TelemetryValues = Mapping[str, FloatArray]
#: The columns that are drawn.
DRAWN = (
    *("time_s", "chamber_set_c", "chamber_c"),
    *(f"{sensor}_{axis}_c" for sensor in ("gyro", "board") for axis in AXES),
)

#: Parts of a line that are drawn each by four readings: more than a figure has columns of pixels.
_PARTS = 2000
_SHORT_RUN_S = 7200.0
_MIN_AXIS_S = 60.0
#: Of rotations, in no position.
_OTHER_COLOUR = "#555555"


@dataclass(frozen=True)
class _Band:
    """Time spent in one position."""

    start_s: float
    end_s: float
    position: str
    is_flagged: bool = False


@house_style
def temperature_figure(
    telemetry: TelemetryValues, dwells: Iterable[DwellRow], marked_c: Sequence[float] = ()
) -> Figure:
    """Draw the measured temperatures and dwells of a run over time, as planned in the paper's Fig. 7.

    Columns of the telemetry that are missing or all NaN are left out. The bands are the dwells, those with
    flags hollow in the lower panel; without any there is none. Lines mark ``marked_c`` in degC.
    """
    bands = [_Band(row.start_s, row.end_s, row.position, bool(row.flags)) for row in dwells]
    time_s = telemetry.get("time_s", np.empty(0))
    figure = new_figure(4.8, hspace=0.07)
    title = "Temperatures and positions" if bands else "Temperatures"
    ends_s = [*time_s[-1:], *(band.end_s for band in bands)]
    axes, unit_s = _time_axes(figure, title, ends_s, tuple(POSITIONS) if bands else ())
    _draw_bands(figure, bands, unit_s)
    time = time_s / unit_s

    def draw(column: str, label: str, **look: Any) -> None:
        values = telemetry.get(column, np.empty(0))
        if np.isfinite(values).any():
            shown = _drawn_readings(values)
            axes.plot(time[shown], values[shown], label=label, **look)

    draw("chamber_set_c", "chamber, set point", color="black", linestyle=":", linewidth=1.0)
    draw("chamber_c", "chamber, air", color="#777777", linewidth=1.6)
    for gyro, (colour, line, _) in GYRO_STYLES.items():
        draw(f"gyro_{gyro}_c", f"{gyro_label(gyro)}, optics", color=colour, linestyle=line)
        draw(
            f"board_{gyro}_c", f"{gyro_label(gyro)}, electronics", color=colour, linestyle=line, linewidth=0.5
        )
    _finish_temperatures(figure, axes, marked_c)
    return figure


def _drawn_readings(values: FloatArray) -> IntArray:
    """Places of the readings that make the line of all of ``values`` (n,): a run has tens of thousands.

    The first, lowest, highest and last one of each part, and where a gap begins (M4: Jugel et al., "M4: a
    visualization-oriented time series data aggregation", Proc. VLDB Endowment 7 (2014) 797).
    """
    size = -(-len(values) // _PARTS)
    if size <= 4:
        return np.arange(len(values))
    begins = np.arange(0, len(values), size)
    parts = np.full((len(begins), size), np.nan)
    parts.flat[: len(values)] = values
    is_gap = np.isnan(values)
    begins_gap = np.flatnonzero(is_gap[1:] & ~is_gap[:-1]) + 1
    lowest = begins + np.where(np.isnan(parts), np.inf, parts).argmin(axis=1)
    highest = begins + np.where(np.isnan(parts), -np.inf, parts).argmax(axis=1)
    return np.unique([*begins, *(begins[1:] - 1), len(values) - 1, *lowest, *highest, *begins_gap])


@house_style
def plan_figure(plan: Plan) -> Figure:
    """Draw the temperatures and positions that a plan expects: the counterpart of the paper's Fig. 7."""
    from gyrobench.bench.procedure.timeline import ROTATIONS, position_spans, temperature_profile

    time_s, chamber_c, gyro_c = temperature_profile(plan)
    figure = new_figure(4.8, hspace=0.07)
    bands = [_Band(*span) for span in position_spans(plan)]
    lanes = (*POSITIONS, *([ROTATIONS] if any(band.position == ROTATIONS for band in bands) else []))
    axes, unit_s = _time_axes(figure, f"Plan of {plan.procedure.procedure}", [plan.duration_s], lanes)
    _draw_bands(figure, bands, unit_s)
    axes.plot(time_s / unit_s, chamber_c, label="chamber, ramped set point", color="#777777", linewidth=1.6)
    axes.plot(time_s / unit_s, gyro_c, label="gyros, predicted", color=GYRO_STYLES["x"][0])
    _finish_temperatures(figure, axes, plan.procedure.marked_temperatures_c)
    return figure


def _time_axes(
    figure: Figure, title: str, ends_s: Sequence[float], positions: Sequence[str]
) -> tuple[Axes, float]:
    """Temperature above, any positions below; returns the upper axes and the seconds in a unit of time."""
    end_s = max(ends_s, default=0.0)
    unit_s, unit = (60.0, "min") if end_s < _SHORT_RUN_S else (3600.0, "h")
    heights = [4.2, len(positions) / len(POSITIONS)] if positions else [1.0]
    panels = figure.subplots(len(heights), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0]
    panels[0].set(title=title, ylabel="temperature / °C")
    for lanes in panels[1:]:
        lanes.set_ylim(len(positions) - 0.5, -0.5)
        lanes.set_yticks(range(len(positions)), [position_label(name) for name in positions], fontsize=7)
        lanes.grid(False)
    panels[-1].set(xlabel=f"time / {unit}", xlim=(0.0, max(end_s, _MIN_AXIS_S) / unit_s))
    return panels[0], unit_s


def _draw_bands(figure: Figure, bands: Iterable[_Band], unit_s: float) -> None:
    """Bands across the temperatures, bars in the row of the position below."""
    upper, lower = figure.axes[0], figure.axes[-1]
    lanes, shown = list(POSITIONS), list(bands)
    spans = [(each.start_s / unit_s, (each.end_s - each.start_s) / unit_s) for each in shown]
    colours = [
        POSITION_STYLES[each.position].colour if each.position in lanes else _OTHER_COLOUR for each in shown
    ]
    faces = ["none" if band.is_flagged else colour for band, colour in zip(shown, colours, strict=True)]
    across = upper.get_xaxis_transform()
    upper.broken_barh(spans, (0.0, 1.0), transform=across, facecolors=colours, alpha=0.18, linewidth=0.0)
    below = []
    for band, (start, width) in zip(shown, spans, strict=True):
        lane = [*lanes, band.position].index(band.position)
        low, high = lane - 0.38, lane + 0.38
        below.append([(start, low), (start, high), (start + width, high), (start + width, low)])
    bars = PolyCollection(below, facecolors=faces, edgecolors=colours, linewidths=0.8)
    lower.add_collection(bars, autolim=False)


def _finish_temperatures(figure: Figure, axes: Axes, marked_c: Sequence[float]) -> None:
    if axes.lines:
        common_legend(figure, [axes], "upper center", ncols=4)
        mark_temperatures(axes, "y", marked_c)
    else:
        say_empty(axes, "no temperatures recorded")
