"""Charts of the page, as data for a template.

A chart has axes with ticks, and curves as SVG paths. It has no size: positions of ticks are percentages of
the plot, and curves are drawn in a square of :data:`_SIDE` units that the browser stretches to the plot, so
that text keeps its size on any screen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrobench.bench.foundations.arrays import S_PER_H
from gyrobench.bench.foundations.text import hours_minutes
from gyrobench.bench.monitor.snapshot import CurrentDwell, LiveBias, LiveBin, RunSnapshot
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.report.number_format import BiasScale, true_minus

#: Width and height of the square in which curves are drawn.
_SIDE = 1000
_S_PER_MIN = 60.0

_TICK_STEPS = (1.0, 2.0, 5.0, 10.0)
_TIME_STEPS_S = tuple(
    [_S_PER_MIN * step for step in (1, 2, 5, 10, 20, 30)] + [S_PER_H * step for step in (1, 2, 3, 6, 12)]
)
_MAX_TICKS = 8
_MARGIN = 0.06


@dataclass(frozen=True)
class Tick:
    """A tick of an axis: its position in percent from the left or from the top, and its label."""

    percent: float
    text: str


@dataclass(frozen=True)
class Axis:
    """One axis: title with unit, limits in the unit of the values, and ticks.

    The values of an upright axis increase upwards, its percentages downwards.
    """

    title: str
    low: float
    high: float
    ticks: tuple[Tick, ...]
    is_upright: bool = False

    def percent(self, value: float) -> float:
        """Position of a value, in percent from the left or from the top, to a thousandth."""
        share = (value - self.low) / (self.high - self.low)
        return round(100.0 * (1.0 - share if self.is_upright else share), 3)


@dataclass(frozen=True)
class CurvePath:
    """A line or an area: CSS classes, data of an SVG path, and label in the legend.

    The path is empty for a curve without values, the label for a curve without a legend.
    """

    css_class: str
    path: str
    label: str


@dataclass(frozen=True)
class Chart:
    """A chart: title for screen readers, axes, curves in drawing order, and position of the present time."""

    title: str
    x: Axis
    y: Axis
    curves: tuple[CurvePath, ...]
    now_percent: float | None = None


def value_axis(title: str, values: Iterable[float], min_span: float) -> Axis:
    """Make an upright axis that covers the finite values.

    It spans at least ``min_span``, so that noise alone does not fill the plot.
    """
    finite = [value for value in values if math.isfinite(value)] or [0.0]
    middle, span = (min(finite) + max(finite)) / 2.0, max(max(finite) - min(finite), min_span)
    low, high = middle - (0.5 + _MARGIN) * span, middle + (0.5 + _MARGIN) * span
    exponent = 10.0 ** math.floor(math.log10((high - low) / _MAX_TICKS))
    step = next(exponent * tick for tick in _TICK_STEPS if (high - low) / (exponent * tick) <= _MAX_TICKS)
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    axis = Axis(title, low, high, (), is_upright=True)
    return _with_ticks(axis, step, lambda value: true_minus(f"{value:z.{decimals}f}"))


def time_axis(title: str, high_s: float, unit_s: float) -> Axis:
    """Make an axis of time from zero with ticks at round minutes or hours.

    Labels are in ``unit_s``, or h:mm for ticks at fractions of hours.
    """
    high_s = max(high_s, _S_PER_MIN)
    fitting = (step for step in _TIME_STEPS_S if high_s / step <= _MAX_TICKS)
    step_s = next(fitting, 24.0 * S_PER_H * math.ceil(high_s / (24.0 * S_PER_H * _MAX_TICKS)))
    is_clock = unit_s == S_PER_H and step_s % S_PER_H != 0.0
    axis = Axis(title, 0.0, high_s, ())
    return _with_ticks(axis, step_s, hours_minutes if is_clock else lambda time_s: f"{time_s / unit_s:.3g}")


def line_path(x: Axis, y: Axis, x_values: Sequence[float], y_values: Sequence[float]) -> str:
    """SVG path of a line through points, broken at unknown values."""
    commands = []
    is_pen_down = False
    for x_value, y_value in zip(x_values, y_values, strict=True):
        if not (math.isfinite(x_value) and math.isfinite(y_value)):
            is_pen_down = False
            continue
        point = _coordinates(x, y, x_value, y_value)
        # A line of zero length draws an isolated point as a dot.
        commands.append(f"L{point}" if is_pen_down else f"M{point}h0")
        is_pen_down = True
    return "".join(commands)


def band_path(
    x: Axis, y: Axis, x_values: Sequence[float], low: Sequence[float], high: Sequence[float]
) -> str:
    """SVG path around the area between two lines of finite values."""
    if not x_values:
        return ""
    upper = [_coordinates(x, y, *point) for point in zip(x_values, high, strict=True)]
    lower = [_coordinates(x, y, *point) for point in zip(x_values, low, strict=True)]
    return f"M{'L'.join(upper + lower[::-1])}Z"


def _coordinates(x: Axis, y: Axis, x_value: float, y_value: float) -> str:
    """Coordinates of a point in an SVG path."""
    per_percent = _SIDE / 100.0
    return f"{x.percent(x_value) * per_percent:.1f} {y.percent(y_value) * per_percent:.1f}"


def _with_ticks(axis: Axis, step: float, text: Callable[[float], str]) -> Axis:
    numbers = range(math.ceil(axis.low / step), math.floor(axis.high / step) + 1)
    return replace(axis, ticks=tuple(Tick(axis.percent(step * each), text(step * each)) for each in numbers))


_MM_PER_M = 1e3
_ARCSEC_PER_DEG = 3600.0
_MIN_SPAN_MMPS = 2.0
_MIN_SPAN_ARCSEC = 2.0
_MIN_SPAN_BIAS = 1e-4
#: Half the width of the dash at a mean, as a share of the plot.
_HALF_DASH = 0.01
#: Estimates after this share set the scale, since the first ones are very uncertain.
_SETTLED_SHARE = 0.5


@dataclass(frozen=True)
class BiasChart:
    """Live bias of one gyro: "x", "X gyro", newest bias with its standard uncertainty, unit, history."""

    gyro: str
    label: str
    text: str
    unit: str
    chart: Chart


def window_charts(dwell: CurrentDwell) -> list[tuple[Chart, Chart]]:
    """Draw velocity and heading of each window of a dwell, on common scales."""
    windows = [
        (
            window.time_s,
            [_MM_PER_M * value for value in window.velocity_east_mps],
            [_MM_PER_M * value for value in window.velocity_north_mps],
            [_ARCSEC_PER_DEG * value for value in window.heading_change_deg],
        )
        for window in dwell.windows
    ]
    velocities = [value for _, east, north, _ in windows for value in (*east, *north)]
    velocity_y = value_axis("Velocity, mm/s", velocities, _MIN_SPAN_MMPS)
    headings = [value for *_, heading in windows for value in heading]
    heading_y = value_axis("Heading change, arcsec", headings, _MIN_SPAN_ARCSEC)
    max_s = max((max((window.planned_s, *window.time_s)) for window in dwell.windows), default=0.0)
    x = time_axis("Time in the window, min", max_s, _S_PER_MIN)
    charts = []
    for number, (time_s, east, north, heading) in enumerate(windows, start=1):
        east_curve = CurvePath("east", line_path(x, velocity_y, time_s, east), "East")
        north_curve = CurvePath("north", line_path(x, velocity_y, time_s, north), "North")
        heading_path = line_path(x, heading_y, time_s, heading)
        heading_curve = CurvePath("heading", heading_path, "positive from North to West")
        velocity_chart = Chart(f"Velocity in window {number}", x, velocity_y, (east_curve, north_curve))
        charts.append((velocity_chart, Chart(f"Heading in window {number}", x, heading_y, (heading_curve,))))
    return charts


def bias_charts(dwell: CurrentDwell) -> list[BiasChart]:
    """Draw the live bias of each gyro; empty until the bias is observable."""
    if not dwell.estimates:
        return []
    newest = dwell.estimates[-1]
    scale = BiasScale.of(newest.bias_dph, newest.sigma_dph)
    return [_bias_chart(index, gyro, dwell.estimates, scale) for index, gyro in enumerate(AXES)]


def temperature_charts(bins: Sequence[LiveBin]) -> list[BiasChart]:
    """Draw the bins of each gyro over its temperature, a line for each position; empty without bins."""
    filled = [each for each in bins if each.count]
    if not filled:
        return []
    scale = BiasScale.of([each.bias_dph for each in filled], [each.sigma_dph for each in filled])
    return [_temperature_chart(gyro, [each for each in filled if each.gyro == gyro], scale) for gyro in AXES]


def _temperature_chart(gyro: str, bins: Sequence[LiveBin], scale: BiasScale) -> BiasChart:
    points: dict[str, list[tuple[float, float, float]]] = {}
    for each in bins:
        point = (each.low_c + each.high_c) / 2.0, scale.factor * each.bias_dph, scale.factor * each.sigma_dph
        points.setdefault(each.position, []).append(point)
    all_points = [point for position_points in points.values() for point in position_points]
    upright = value_axis("Gyro temperature, °C", (point[0] for point in all_points), _MIN_SPAN_C)
    ticks = tuple(Tick(100.0 - tick.percent, tick.text) for tick in upright.ticks)
    x = replace(upright, is_upright=False, ticks=ticks)
    ends = [bias + side * sigma for _, bias, sigma in all_points for side in (-1.0, 1.0)]
    y = value_axis(f"Bias, {scale.unit}", ends, _MIN_SPAN_BIAS)
    curves = tuple(
        CurvePath(f"position {position}", _path_with_bars(x, y, sorted(points[position])), label)
        for position, label in ((each, position_label(each)) for each in POSITIONS)
        if position in points
    )
    chart = Chart(f"Bias of the {gyro_label(gyro)} over its temperature", x, y, curves)
    return BiasChart(gyro, gyro_label(gyro), "", scale.unit, chart)


def _path_with_bars(x: Axis, y: Axis, points: Sequence[tuple[float, float, float]]) -> str:
    """SVG path of a line through points (x, y, sigma), each a dash with an upright bar of ± sigma."""
    half = _HALF_DASH * (x.high - x.low)
    marks = [
        line_path(x, y, (each_x - half, each_x + half), (value, value))
        + line_path(x, y, (each_x, each_x), (value - sigma, value + sigma))
        for each_x, value, sigma in points
    ]
    return line_path(x, y, *list(zip(*points, strict=True))[:2]) + "".join(marks)


def _bias_chart(index: int, gyro: str, estimates: tuple[LiveBias, ...], scale: BiasScale) -> BiasChart:
    finite = [each for each in estimates if math.isfinite(each.bias_dph[index] + each.sigma_dph[index])]
    first_s = estimates[0].time_s
    times_s = [each.time_s - first_s for each in finite]
    bias = [scale.factor * each.bias_dph[index] for each in finite]
    sigma = [scale.factor * each.sigma_dph[index] for each in finite]
    low = [value - width for value, width in zip(bias, sigma, strict=True)]
    high = [value + width for value, width in zip(bias, sigma, strict=True)]
    first_settled = int(_SETTLED_SHARE * len(finite))
    x = time_axis("Since the first estimate, min", max([0.0, *times_s]), _S_PER_MIN)
    y = value_axis(f"Bias, {scale.unit}", (*low[first_settled:], *high[first_settled:]), _MIN_SPAN_BIAS)
    curves = (
        CurvePath(f"sigma gyro-{gyro}", band_path(x, y, times_s, low, high), "± 1 sigma"),
        CurvePath(f"gyro-{gyro}", line_path(x, y, times_s, bias), "bias"),
    )
    newest = estimates[-1]
    text = true_minus(scale.with_sigma(newest.bias_dph[index], newest.sigma_dph[index]))
    chart = Chart(f"Live bias of the {gyro_label(gyro)}", x, y, curves)
    return BiasChart(gyro, gyro_label(gyro), text, scale.unit, chart)


_MIN_SPAN_C = 10.0
_MAX_MINUTE_AXIS_S = 2.0 * S_PER_H
_MEASURED_CURVES = (
    ("chamber_set_c", "set-point", "chamber set"),
    ("chamber_c", "chamber", "chamber air"),
    ("gyro_x_c", "gyro-x", "X gyro"),
    ("gyro_y_c", "gyro-y", "Y gyro"),
    ("gyro_z_c", "gyro-z", "Z gyro"),
)
_PLANNED_CURVES = (
    ("chamber_c", "chamber planned", "chamber, plan"),
    ("gyro_c", "gyro planned", "gyros, plan"),
)


@dataclass(frozen=True)
class PositionBar:
    """Planned time in a position, in percent of the time axis, and whether it is past and was not skipped."""

    start_percent: float
    width_percent: float
    is_over: bool


@dataclass(frozen=True)
class ProfileChart:
    """The chart of the temperatures, and the bars of each position."""

    chart: Chart
    lanes: dict[str, list[PositionBar]]


def profile_chart(snapshot: RunSnapshot) -> ProfileChart | None:
    """Draw the profile, the future plan shifted by the run's delay; None without plan and measurement."""
    planned, measured = snapshot.planned, snapshot.measured
    if not planned.time_s and not measured.time_s:
        return None
    planned_ends_s = [time_s + snapshot.behind_s for time_s in planned.time_s[-1:]]
    # The past of the plan is drawn as planned, which is later than now if the run is ahead of it.
    ends_s = [snapshot.now_s, snapshot.plan_now_s, *measured.time_s[-1:], *planned_ends_s]
    unit_s, unit = (S_PER_H, "h") if max(ends_s) > _MAX_MINUTE_AXIS_S else (_S_PER_MIN, "min")
    x = time_axis(f"Time since the start, {unit}", max(ends_s), unit_s)
    series = [getattr(planned, name) for name, _, _ in _PLANNED_CURVES]
    series += [getattr(measured, name) for name, _, _ in _MEASURED_CURVES]
    y = value_axis("Temperature, °C", [value for values in series for value in values], _MIN_SPAN_C)
    curves = [
        CurvePath(css_class, _planned_path(x, y, planned.time_s, getattr(planned, name), snapshot), label)
        for name, css_class, label in _PLANNED_CURVES
    ]
    curves += [
        CurvePath(css_class, line_path(x, y, measured.time_s, getattr(measured, name)), label)
        for name, css_class, label in _MEASURED_CURVES
    ]
    chart = Chart("Temperatures, planned and measured", x, y, tuple(curves), x.percent(snapshot.now_s))
    return ProfileChart(chart, _lanes(x, snapshot))


def _planned_path(
    x: Axis, y: Axis, time_s: Sequence[float], values: Sequence[float], snapshot: RunSnapshot
) -> str:
    """Path of a planned curve: up to now as planned, the future shifted by the delay."""
    if not time_s:
        return ""
    plan_now_s = snapshot.plan_now_s
    pairs = list(zip(time_s, values, strict=True))
    present = (plan_now_s, float(np.interp(plan_now_s, time_s, values)))
    end_s = min(plan_now_s, snapshot.now_s)  # a run ahead of its plan leaves out what it saved
    past = [*(pair for pair in pairs if pair[0] < end_s), (end_s, float(np.interp(end_s, time_s, values)))]
    future = [
        (plan_s + snapshot.behind_s, value) for plan_s, value in (present, *pairs) if plan_s >= plan_now_s
    ]
    return "".join(line_path(x, y, *zip(*part, strict=True)) for part in (past, future))


def _lanes(x: Axis, snapshot: RunSnapshot) -> dict[str, list[PositionBar]]:
    """Bars of each position, future ones shifted by the run's delay."""
    used = {span.position for span in snapshot.planned.positions}
    lanes: dict[str, list[PositionBar]] = {position: [] for position in POSITIONS if position in used}
    measured = {each.number for each in snapshot.dwells}
    for span in snapshot.planned.positions:
        # The return to an interrupted dwell takes the plan's present back before visits that are over.
        is_measured = bool(span.dwells) and measured.issuperset(span.dwells)
        start_s, end_s = span.start_s, span.end_s
        is_over = end_s <= snapshot.plan_now_s
        if not is_over and is_measured and start_s < snapshot.now_s:
            is_over, end_s = True, min(end_s, snapshot.now_s)
        elif not is_over:
            is_future = span.start_s > snapshot.plan_now_s
            start_s = start_s + snapshot.behind_s if is_future else min(start_s, snapshot.now_s)
            end_s += snapshot.behind_s
        start_percent, end_percent = x.percent(start_s), x.percent(end_s)
        lanes.setdefault(span.position, []).append(
            PositionBar(
                start_percent,
                round(end_percent - start_percent, 3),
                is_over and not snapshot.is_skipped(span),
            )
        )
    return lanes
