"""A plot in characters: lines over an axis, with the numbers at its ends."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from rich.text import Text

from gyrobench.bench.live.canvas import Canvas, Point

#: Most room for the numbers of the vertical axis.
_LABEL_WIDTH = 6
_DOTTED = 3
_DIM = "dim"
_STEPS = (1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True)
class Curve:
    """One line of a plot.

    Attributes
    ----------
    x, y : sequence of float, same length
        NaN breaks the line.
    style : str
        Colour, as rich names it.
    letter : str
        Written at the line's end, so that it is told from others without colour; may be empty.
    is_dotted : bool
        Whether it is single dots.
    """

    x: Sequence[float]
    y: Sequence[float]
    style: str
    letter: str = ""
    is_dotted: bool = False


def plot(
    curves: Sequence[Curve],
    width: int,
    height: int,
    x_range: tuple[float, float],
    x_labels: tuple[str, str],
    least_span: float,
    is_ascii: bool,
    mark_x: float | None = None,
) -> list[Text]:
    """Draw curves into a rectangle of characters.

    Parameters
    ----------
    width, height : int
        Of the whole with labels, in characters.
    x_range : tuple of float
        Ends of the horizontal axis.
    x_labels : tuple of str
        What is written at its ends.
    least_span : float
        The vertical axis spans as much at least.
    is_ascii : bool
        Whether only ASCII may be used.
    mark_x : float, optional
        Where a vertical line stands.
    """
    low, high = _y_range(curves, least_span)
    label_width = max(len(_number(low)), len(_number(high)))
    canvas = Canvas(width - label_width - 1, height - 1, is_ascii)

    def place(x: float, y: float) -> Point:
        return (x - x_range[0]) / (x_range[1] - x_range[0]), (y - low) / (high - low)

    if mark_x is not None:
        canvas.line([place(mark_x, low), place(mark_x, high)], _DIM)
    elif low < 0.0 < high:
        canvas.line([place(x, 0.0) for x in x_range], _DIM, _DOTTED)
    for curve in curves:
        points = [place(x, y) for x, y in zip(curve.x, curve.y, strict=True)]
        canvas.line(points, curve.style, _DOTTED if curve.is_dotted else 1)
    for curve in curves:
        ends = [
            place(x, y)
            for x, y in zip(curve.x, curve.y, strict=True)
            if math.isfinite(x) and math.isfinite(y)
        ]
        if curve.letter and ends:
            canvas.letter(ends[-1], curve.letter, f"bold {curve.style}")
    return _with_axes(canvas, (_number(low), _number(high)), label_width, x_labels, "|" if is_ascii else "│")


def _with_axes(
    canvas: Canvas, y_labels: tuple[str, str], label_width: int, x_labels: tuple[str, str], bar: str
) -> list[Text]:
    lines = []
    last = canvas.height - 1
    for number, row in enumerate(canvas.rows()):
        label = y_labels[1] if number == 0 else y_labels[0] if number == last else ""
        lines.append(Text.assemble((f"{label:>{label_width}}{bar}", _DIM), row))
    left, right = x_labels
    below = " " * (label_width + 1) + left + right.rjust(canvas.width - len(left))
    return [*lines, Text(below, _DIM)]


def _y_range(curves: Iterable[Curve], least_span: float) -> tuple[float, float]:
    """Round numbers around all values."""
    values = [value for curve in curves for value in curve.y if math.isfinite(value)]
    low, high = (min(values), max(values)) if values else (0.0, 0.0)
    lacking = least_span - (high - low)
    if lacking > 0.0:
        low, high = low - lacking / 2.0, high + lacking / 2.0
    step = _round_step((high - low) / 8.0)
    return math.floor(low / step + 1e-9) * step, math.ceil(high / step - 1e-9) * step


def _round_step(span: float) -> float:
    """Smallest 1, 2 or 5 times a power of ten that is not below a number."""
    decade = 10.0 ** math.floor(math.log10(span))
    return next(decade * step for step in _STEPS if decade * step >= span * (1.0 - 1e-9))


def _number(value: float) -> str:
    text = f"{value:z.3g}"
    return text if len(text) <= _LABEL_WIDTH else f"{value:z.0e}"
