"""The temperatures of a run over its time, planned and measured, and its positions below them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrobench.bench.live.picture import Picture
from gyrobench.bench.live.picture_parts import MeasuredProfile, PlannedProfile
from gyrobench.bench.monitor.chart import (
    HOUR_S,
    MINUTE_S,
    Axis,
    Chart,
    CurvePath,
    line,
    time_axis,
    value_axis,
)
from gyrobench.bench.navigation.positions import POSITIONS

_LEAST_SPAN_C = 10.0
_SHORT_S = 2.0 * HOUR_S
_MEASURED = (
    ("chamber_set_c", "set-point", "chamber set"),
    ("chamber_c", "chamber", "chamber air"),
    ("gyro_x_c", "gyro-x", "X gyro"),
    ("gyro_y_c", "gyro-y", "Y gyro"),
    ("gyro_z_c", "gyro-z", "Z gyro"),
)
_PLANNED = (("chamber_c", "chamber planned", "chamber, plan"), ("gyro_c", "gyro planned", "gyros, plan"))


@dataclass(frozen=True)
class Stay:
    """A stay in a position: places in percent of the time axis, and whether it is over by the plan."""

    start_percent: float
    width_percent: float
    is_over: bool


@dataclass(frozen=True)
class ProfileChart:
    """The chart and, by position, the stays there."""

    chart: Chart
    lanes: dict[str, list[Stay]]


def profile_chart(picture: Picture) -> ProfileChart | None:
    """Draw the profile; None where neither a plan nor a measurement is known.

    What is still to come is drawn as late as the run is behind its plan.
    """
    planned, measured = picture.planned, picture.measured
    if not planned.time_s and not measured.time_s:
        return None
    planned_ends_s = [time_s + picture.behind_s for time_s in planned.time_s[-1:]]
    ends_s = [picture.now_s, *measured.time_s[-1:], *planned_ends_s]
    unit_s, unit = (HOUR_S, "h") if max(ends_s) > _SHORT_S else (MINUTE_S, "min")
    x = time_axis(f"Time since the start, {unit}", 0.0, max(ends_s), unit_s)
    y = value_axis("Temperature, °C", _temperatures(planned, measured), _LEAST_SPAN_C)
    curves = [
        CurvePath(look, _planned_path(x, y, planned.time_s, getattr(planned, name), picture), label)
        for name, look, label in _PLANNED
    ]
    curves += [
        CurvePath(look, line(x, y, measured.time_s, getattr(measured, name)), label)
        for name, look, label in _MEASURED
    ]
    chart = Chart("Temperatures, planned and measured", x, y, tuple(curves), x.percent(picture.now_s))
    return ProfileChart(chart, _lanes(x, picture))


def _temperatures(planned: PlannedProfile, measured: MeasuredProfile) -> list[float]:
    series = [getattr(planned, name) for name, _, _ in _PLANNED]
    series += [getattr(measured, name) for name, _, _ in _MEASURED]
    return [value for values in series for value in values]


def _planned_path(
    x: Axis, y: Axis, time_s: Sequence[float], values: Sequence[float], picture: Picture
) -> str:
    """Past of a plan as it was planned, and its future from now on."""
    if not time_s:
        return ""
    plan_now_s = picture.plan_now_s
    pairs = list(zip(time_s, values, strict=True))
    present = (plan_now_s, float(np.interp(plan_now_s, time_s, values)))
    past = [*(pair for pair in pairs if pair[0] < plan_now_s), present]
    future = [(at_s + picture.behind_s, value) for at_s, value in (present, *pairs) if at_s >= plan_now_s]
    return "".join(line(x, y, *zip(*part, strict=True)) for part in (past, future))


def _lanes(x: Axis, picture: Picture) -> dict[str, list[Stay]]:
    used = {span.position for span in picture.planned.positions}
    lanes: dict[str, list[Stay]] = {position: [] for position in POSITIONS if position in used}
    for span in picture.planned.positions:
        is_over = span.end_s <= picture.plan_now_s
        start_s = span.start_s if span.start_s <= picture.plan_now_s else span.start_s + picture.behind_s
        end_s = span.end_s if is_over else span.end_s + picture.behind_s
        left, right = x.percent(start_s), x.percent(end_s)
        lanes.setdefault(span.position, []).append(Stay(left, round(right - left, 3), is_over))
    return lanes
