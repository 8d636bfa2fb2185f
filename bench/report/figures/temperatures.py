"""Temperatures and positions over time, of a run and of a plan.

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
    label_empty,
    mark_temperatures,
    new_figure,
)

if TYPE_CHECKING:
    from gyrobench.bench.procedure.plan import Plan

#: Values by column, as returned by :func:`gyrobench.bench.runs.telemetry.read_telemetry`.
TelemetryValues = Mapping[str, FloatArray]
#: Columns that the figure shows.
DRAWN_COLUMNS = (
    *("time_s", "chamber_set_c", "chamber_c"),
    *(f"{sensor}_{axis}_c" for sensor in ("gyro", "board") for axis in AXES),
)

#: Number of parts of a line, each reduced to four readings: more than a figure has columns of pixels.
_MAX_LINE_PARTS = 2000
_SHORT_RUN_S = 7200.0
_MIN_AXIS_S = 60.0
#: Colour of rotations, which are in no position.
_ROTATIONS_COLOUR = "#555555"


@dataclass(frozen=True)
class _PositionSpan:
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

    Columns of the telemetry that are missing or all NaN are left out. The bands are dwells, hollow in the
    lower panel if flagged; without dwells there is no lower panel. Lines mark ``marked_c`` in degC.
    """
    spans = [_PositionSpan(row.start_s, row.end_s, row.position, bool(row.flags)) for row in dwells]
    time_s = telemetry.get("time_s", np.empty(0))
    figure = new_figure(4.8, hspace=0.07)
    title = "Temperatures and positions" if spans else "Temperatures"
    ends_s = [*time_s[-1:], *(span.end_s for span in spans)]
    axes, unit_s = _time_axes(figure, title, ends_s, tuple(POSITIONS) if spans else ())
    _draw_spans(figure, spans, unit_s)
    time = time_s / unit_s

    def draw(column: str, label: str, **style: Any) -> None:
        values = telemetry.get(column, np.empty(0))
        if np.isfinite(values).any():
            indices = _line_indices(values)
            axes.plot(time[indices], values[indices], label=label, **style)

    draw("chamber_set_c", "chamber, set point", color="black", linestyle=":", linewidth=1.0)
    draw("chamber_c", "chamber, air", color="#777777", linewidth=1.6)
    for gyro, (colour, line, _) in GYRO_STYLES.items():
        draw(f"gyro_{gyro}_c", f"{gyro_label(gyro)}, optics", color=colour, linestyle=line)
        draw(
            f"board_{gyro}_c", f"{gyro_label(gyro)}, electronics", color=colour, linestyle=line, linewidth=0.5
        )
    _add_legend_and_marks(figure, axes, marked_c)
    return figure


def _line_indices(values: FloatArray) -> IntArray:
    """Indices of the readings that suffice to draw the line of ``values`` (n,), tens of thousands in a run.

    These are the first, lowest, highest and last one of each part, and the starts of gaps (M4: Jugel et al.,
    "M4: a visualization-oriented time series data aggregation", Proc. VLDB Endowment 7 (2014) 797).
    """
    part_size = -(-len(values) // _MAX_LINE_PARTS)
    if part_size <= 4:
        return np.arange(len(values))
    starts = np.arange(0, len(values), part_size)
    parts = np.full((len(starts), part_size), np.nan)
    parts.flat[: len(values)] = values
    is_gap = np.isnan(values)
    gap_starts = np.flatnonzero(is_gap[1:] & ~is_gap[:-1]) + 1
    lowest = starts + np.where(np.isnan(parts), np.inf, parts).argmin(axis=1)
    highest = starts + np.where(np.isnan(parts), -np.inf, parts).argmax(axis=1)
    return np.unique([*starts, *(starts[1:] - 1), len(values) - 1, *lowest, *highest, *gap_starts])


@house_style
def plan_figure(plan: Plan) -> Figure:
    """Draw the temperatures and positions that a plan expects: the counterpart of the paper's Fig. 7."""
    from gyrobench.bench.procedure.timeline import ROTATIONS, position_spans, temperature_profile

    time_s, chamber_c, gyro_c = temperature_profile(plan)
    figure = new_figure(4.8, hspace=0.07)
    spans = [_PositionSpan(*span) for span in position_spans(plan)]
    lanes = (*POSITIONS, *([ROTATIONS] if any(span.position == ROTATIONS for span in spans) else []))
    axes, unit_s = _time_axes(figure, f"Plan of {plan.procedure.procedure}", [plan.duration_s], lanes)
    _draw_spans(figure, spans, unit_s)
    axes.plot(time_s / unit_s, chamber_c, label="chamber, ramped set point", color="#777777", linewidth=1.6)
    axes.plot(time_s / unit_s, gyro_c, label="gyros, predicted", color=GYRO_STYLES["x"][0])
    _add_legend_and_marks(figure, axes, plan.procedure.marked_temperatures_c)
    return figure


def _time_axes(
    figure: Figure, title: str, ends_s: Sequence[float], positions: Sequence[str]
) -> tuple[Axes, float]:
    """Create axes for temperatures and, below, any positions; returns the upper axes and the time unit, s."""
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


def _draw_spans(figure: Figure, spans: Iterable[_PositionSpan], unit_s: float) -> None:
    """Draw each span as a band across the temperatures and as a bar in the lane of its position."""
    upper, lower = figure.axes[0], figure.axes[-1]
    lanes, all_spans = list(POSITIONS), list(spans)
    extents = [(each.start_s / unit_s, (each.end_s - each.start_s) / unit_s) for each in all_spans]
    colours = [
        POSITION_STYLES[each.position].colour if each.position in lanes else _ROTATIONS_COLOUR
        for each in all_spans
    ]
    faces = ["none" if span.is_flagged else colour for span, colour in zip(all_spans, colours, strict=True)]
    across = upper.get_xaxis_transform()
    upper.broken_barh(extents, (0.0, 1.0), transform=across, facecolors=colours, alpha=0.18, linewidth=0.0)
    below = []
    for span, (start, width) in zip(all_spans, extents, strict=True):
        lane = [*lanes, span.position].index(span.position)
        low, high = lane - 0.38, lane + 0.38
        below.append([(start, low), (start, high), (start + width, high), (start + width, low)])
    bars = PolyCollection(below, facecolors=faces, edgecolors=colours, linewidths=0.8)
    lower.add_collection(bars, autolim=False)


def _add_legend_and_marks(figure: Figure, axes: Axes, marked_c: Sequence[float]) -> None:
    if axes.lines:
        common_legend(figure, [axes], "upper center", ncols=4)
        mark_temperatures(axes, "y", marked_c)
    else:
        label_empty(axes, "no temperatures recorded")
