"""Charts as numbers that a template can draw: axes with ticks, and curves as SVG paths.

A chart has no size. Places of ticks are percentages of the plot, and curves are drawn in a square of
:data:`SIDE` units that the browser stretches to the plot, so that text keeps its size on any screen.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from gyrobench.bench.report.number_format import true_minus

#: Width and height of the square in which curves are drawn.
SIDE = 1000
HOUR_S, MINUTE_S = 3600.0, 60.0

_USUAL_STEPS = (1.0, 2.0, 5.0, 10.0)
_TIME_STEPS_S = tuple(
    [MINUTE_S * step for step in (1, 2, 5, 10, 20, 30)] + [HOUR_S * step for step in (1, 2, 3, 6, 12)]
)
_MOST_TICKS = 8
_MARGIN = 0.06


@dataclass(frozen=True)
class Tick:
    """A mark on an axis.

    Attributes
    ----------
    percent : float
        Where, from the left or from the top.
    text : str
        What stands there.
    """

    percent: float
    text: str


@dataclass(frozen=True)
class Axis:
    """One axis.

    Attributes
    ----------
    title : str
        Quantity and unit.
    low, high : float
        Ends, in the unit of the values.
    ticks : tuple of Tick
        Marks.
    is_upright : bool
        Whether it grows upwards, against the percentages.
    """

    title: str
    low: float
    high: float
    ticks: tuple[Tick, ...]
    is_upright: bool = False

    def percent(self, value: float) -> float:
        """Place of a value, in percent from the left or from the top, to a thousandth."""
        share = (value - self.low) / (self.high - self.low)
        return round(100.0 * (1.0 - share if self.is_upright else share), 3)


@dataclass(frozen=True)
class CurvePath:
    """A line or an area.

    Attributes
    ----------
    look : str
        CSS classes.
    path : str
        Data of an SVG path in the square; empty where nothing is known.
    label : str
        For the legend; empty for a curve that is not in it.
    """

    look: str
    path: str
    label: str = ""


@dataclass(frozen=True)
class Chart:
    """A chart.

    Attributes
    ----------
    title : str
        What it shows, also for those who can't see it.
    x, y : Axis
        Its axes.
    curves : tuple of CurvePath
        In the order of drawing.
    now_percent : float or None
        Where to mark the present; None for nowhere.
    """

    title: str
    x: Axis
    y: Axis
    curves: tuple[CurvePath, ...]
    now_percent: float | None = None


def value_axis(title: str, values: Iterable[float], least_span: float) -> Axis:
    """Make an upright axis for some values; NaN among them is passed over.

    Parameters
    ----------
    title : str
        Quantity and unit.
    values : iterable of float
        What it has to reach.
    least_span : float
        Lowest difference of its ends: without it, noise alone would fill the plot.
    """
    known = [value for value in values if math.isfinite(value)] or [0.0]
    middle, span = (min(known) + max(known)) / 2.0, max(max(known) - min(known), least_span)
    low, high = middle - (0.5 + _MARGIN) * span, middle + (0.5 + _MARGIN) * span
    exponent = 10.0 ** math.floor(math.log10((high - low) / _MOST_TICKS))
    step = next(
        exponent * usual for usual in _USUAL_STEPS if (high - low) / (exponent * usual) <= _MOST_TICKS
    )
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    axis = Axis(title, low, high, (), is_upright=True)
    return _with_ticks(axis, step, lambda value: true_minus(f"{value:z.{decimals}f}"))


def time_axis(title: str, low_s: float, high_s: float, unit_s: float) -> Axis:
    """Make an axis of time whose ticks are at usual minutes or hours, told in ``unit_s``."""
    high_s = max(high_s, low_s + MINUTE_S)
    fitting = (step for step in _TIME_STEPS_S if (high_s - low_s) / step <= _MOST_TICKS)
    step_s = next(fitting, 24.0 * HOUR_S * math.ceil((high_s - low_s) / (24.0 * HOUR_S * _MOST_TICKS)))
    return _with_ticks(Axis(title, low_s, high_s, ()), step_s, lambda time_s: f"{time_s / unit_s:.3g}")


def line(x: Axis, y: Axis, x_values: Sequence[float], y_values: Sequence[float]) -> str:
    """Path of a line through some points; it is broken where a value is not known."""
    pieces = []
    is_down = False
    for x_value, y_value in zip(x_values, y_values, strict=True):
        if not (math.isfinite(x_value) and math.isfinite(y_value)):
            is_down = False
            continue
        place = _place(x, y, x_value, y_value)
        # A point of no length shows as a dot, for it may have no neighbour.
        pieces.append(f"L{place}" if is_down else f"M{place}h0")
        is_down = True
    return "".join(pieces)


def band(x: Axis, y: Axis, x_values: Sequence[float], low: Sequence[float], high: Sequence[float]) -> str:
    """Path around the area between two lines; all values have to be known."""
    if not x_values:
        return ""
    there = [_place(x, y, *point) for point in zip(x_values, high, strict=True)]
    back = [_place(x, y, *point) for point in zip(x_values, low, strict=True)]
    return f"M{'L'.join(there + back[::-1])}Z"


def _place(x: Axis, y: Axis, x_value: float, y_value: float) -> str:
    per_percent = SIDE / 100.0
    return f"{x.percent(x_value) * per_percent:.1f} {y.percent(y_value) * per_percent:.1f}"


def _with_ticks(axis: Axis, step: float, text: Callable[[float], str]) -> Axis:
    numbers = range(math.ceil(axis.low / step), math.floor(axis.high / step) + 1)
    return replace(axis, ticks=tuple(Tick(axis.percent(step * each), text(step * each)) for each in numbers))
