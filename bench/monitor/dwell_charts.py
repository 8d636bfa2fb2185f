"""The dwell under way: velocities and heading of each window, and how the live bias becomes better."""

from __future__ import annotations

import math
from dataclasses import dataclass

from gyrobench.bench.live.picture_parts import DwellNow, LiveBias, WindowTrace
from gyrobench.bench.monitor.chart import MINUTE_S, Axis, Chart, CurvePath, band, line, time_axis, value_axis
from gyrobench.bench.navigation.positions import AXES, gyro_label
from gyrobench.bench.report.number_format import BiasScale, true_minus

_MM_PER_M = 1e3
_ARCSEC_PER_DEG = 3600.0
_LEAST_SPAN_MMPS = 2.0
_LEAST_SPAN_ARCSEC = 2.0
_LEAST_SPAN_BIAS = 1e-4
#: Later estimates set the scale: the first ones are so unsure that the rest would be a flat line.
_SETTLED = 0.5


@dataclass(frozen=True)
class WindowCharts:
    """Charts of one window, its number from 1."""

    number: int
    velocity: Chart
    heading: Chart


@dataclass(frozen=True)
class BiasChart:
    """Live bias of one gyro.

    Attributes
    ----------
    gyro : str
        "x", "y" or "z".
    label, text, unit : str
        "X gyro", its newest bias with its standard uncertainty, and their unit.
    chart : Chart
        How both came about.
    """

    gyro: str
    label: str
    text: str
    unit: str
    chart: Chart


def window_charts(dwell: DwellNow) -> list[WindowCharts]:
    """Draw each window of a dwell; all share their scales, so that they can be compared."""
    velocities = [
        _MM_PER_M * value
        for window in dwell.windows
        for value in (*window.velocity_east_mps, *window.velocity_north_mps)
    ]
    headings = [_ARCSEC_PER_DEG * value for window in dwell.windows for value in window.heading_change_deg]
    velocity_y = value_axis("Velocity, mm/s", velocities, _LEAST_SPAN_MMPS)
    heading_y = value_axis("Heading change, arcsec", headings, _LEAST_SPAN_ARCSEC)
    longest_s = max((max((window.planned_s, *window.time_s)) for window in dwell.windows), default=0.0)
    x = time_axis("Time in the window, min", 0.0, longest_s, MINUTE_S)
    return [
        WindowCharts(number, _velocity_chart(number, window, x, velocity_y),
                     _heading_chart(number, window, x, heading_y))
        for number, window in enumerate(dwell.windows, start=1)
    ]  # fmt: skip


def bias_charts(dwell: DwellNow) -> list[BiasChart]:
    """Draw the live bias of each gyro; empty as long as nothing can be told."""
    if not dwell.estimates:
        return []
    newest = dwell.estimates[-1]
    scale = BiasScale.of(newest.bias_dph, newest.sigma_dph)
    return [_bias_chart(index, gyro, dwell.estimates, scale) for index, gyro in enumerate(AXES)]


def _velocity_chart(number: int, window: WindowTrace, x: Axis, y: Axis) -> Chart:
    east = [_MM_PER_M * value for value in window.velocity_east_mps]
    north = [_MM_PER_M * value for value in window.velocity_north_mps]
    curves = (
        CurvePath("east", line(x, y, window.time_s, east), "East"),
        CurvePath("north", line(x, y, window.time_s, north), "North"),
    )
    return Chart(f"Velocity in window {number}", x, y, curves)


def _heading_chart(number: int, window: WindowTrace, x: Axis, y: Axis) -> Chart:
    heading = [_ARCSEC_PER_DEG * value for value in window.heading_change_deg]
    curves = (CurvePath("heading", line(x, y, window.time_s, heading), "positive from North to West"),)
    return Chart(f"Heading in window {number}", x, y, curves)


def _bias_chart(index: int, gyro: str, estimates: tuple[LiveBias, ...], scale: BiasScale) -> BiasChart:
    known = [each for each in estimates if math.isfinite(each.bias_dph[index] + each.sigma_dph[index])]
    first_s = estimates[0].time_s
    times_s = [each.time_s - first_s for each in known]
    bias = [scale.factor * each.bias_dph[index] for each in known]
    sigma = [scale.factor * each.sigma_dph[index] for each in known]
    low = [value - width for value, width in zip(bias, sigma, strict=True)]
    high = [value + width for value, width in zip(bias, sigma, strict=True)]
    settled = int(_SETTLED * len(known))
    x = time_axis("Since the first estimate, min", 0.0, max([0.0, *times_s]), MINUTE_S)
    y = value_axis(f"Bias, {scale.unit}", (*low[settled:], *high[settled:]), _LEAST_SPAN_BIAS)
    curves = (
        CurvePath(f"sigma gyro-{gyro}", band(x, y, times_s, low, high), "± 1 sigma"),
        CurvePath(f"gyro-{gyro}", line(x, y, times_s, bias), "bias"),
    )
    newest = estimates[-1]
    text = true_minus(scale.with_sigma(newest.bias_dph[index], newest.sigma_dph[index]))
    chart = Chart(f"Live bias of the {gyro_label(gyro)}", x, y, curves)
    return BiasChart(gyro, gyro_label(gyro), text, scale.unit, chart)
