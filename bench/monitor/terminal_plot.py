"""Plots of characters: braille dots, or ASCII marks on a terminal without Unicode."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from rich.text import Text

from gyrobench.bench.monitor.attitude_drawing import view_axes
from gyrobench.bench.monitor.snapshot import Attitude
from gyrobench.bench.navigation.positions import AXES

#: Bit of each dot of a braille character, by row from the top and column.
_BRAILLE = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
_BRAILLE_BLANK = 0x2800
#: ASCII mark by the bits of a cell: 1 for the upper half, 2 for the lower half.
_ASCII = " '.:"
_NO_STYLE = ""

Point = tuple[float, float]


class Canvas:
    """A grid of characters with coordinates from 0 to 1, from the left and from the bottom."""

    def __init__(self, width: int, height: int, is_ascii: bool = False) -> None:
        self.width, self.height = width, height
        self._is_ascii = is_ascii
        self._dots_per_column, self._dots_per_row = (1, 2) if is_ascii else (2, 4)
        self._bits: dict[tuple[int, int], int] = {}
        self._styles: dict[tuple[int, int], str] = {}
        self._letters: dict[tuple[int, int], str] = {}

    def line(self, points: Sequence[Point], style: str = _NO_STYLE, every: int = 1) -> None:
        """Join points by lines, broken at unknown points.

        With ``every`` above 1, dots are set only in every such column: the line is dotted.
        """
        previous: tuple[int, int] | None = None
        for point in points:
            current = self._dot(point)
            if current is not None:
                for dot in _line_dots(previous or current, current):
                    if dot[0] % every == 0:
                        self._set(dot, style)
            previous = current

    def letter(self, point: Point, letter: str, style: str = _NO_STYLE) -> None:
        """Write a character at a point, over any line."""
        dot = self._dot(point)
        if dot is not None:
            cell = (dot[0] // self._dots_per_column, dot[1] // self._dots_per_row)
            self._letters[cell] = letter
            self._styles[cell] = style

    def rows(self) -> list[Text]:
        """The drawing, a text for each row from the top."""
        return [self._row(row) for row in range(self.height)]

    def _row(self, row: int) -> Text:
        cells = [(column, row) for column in range(self.width)]
        styled = itertools.groupby(cells, key=lambda cell: self._styles.get(cell, _NO_STYLE))
        parts = (("".join(map(self._character, cells_of_style)), style) for style, cells_of_style in styled)
        return Text.assemble(*parts)

    def _character(self, cell: tuple[int, int]) -> str:
        if letter := self._letters.get(cell):
            return letter
        bits = self._bits.get(cell, 0)
        if self._is_ascii:
            return _ASCII[bits]
        return chr(_BRAILLE_BLANK + bits) if bits else " "

    def _dot(self, point: Point) -> tuple[int, int] | None:
        """Column and row of the dot at a point, from the upper left corner."""
        x, y = point
        if not (math.isfinite(x) and math.isfinite(y) and -1e-9 <= x <= 1 + 1e-9 and -1e-9 <= y <= 1 + 1e-9):
            return None
        columns, rows = self.width * self._dots_per_column, self.height * self._dots_per_row
        return round(x * (columns - 1)), round((1.0 - y) * (rows - 1))

    def _set(self, dot: tuple[int, int], style: str) -> None:
        column, row = dot
        cell = (column // self._dots_per_column, row // self._dots_per_row)
        bit = 1 << row % 2 if self._is_ascii else _BRAILLE[row % 4][column % 2]
        self._bits[cell] = self._bits.get(cell, 0) | bit
        if cell not in self._letters:
            self._styles[cell] = style


def _line_dots(first: tuple[int, int], last: tuple[int, int]) -> Iterable[tuple[int, int]]:
    """Dots of the straight line from one dot to another."""
    steps = max(abs(last[0] - first[0]), abs(last[1] - first[1]), 1)
    for step in range(steps + 1):
        share = step / steps
        yield (round(first[0] + share * (last[0] - first[0])), round(first[1] + share * (last[1] - first[1])))


#: Largest width of the numbers of the vertical axis.
_LABEL_WIDTH = 6
_DOT_INTERVAL = 3
_DIM = "dim"
_STEPS = (1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True)
class PlotCurve:
    """One line of a plot, broken at NaN, with a rich style and a letter at its end."""

    x: Sequence[float]
    y: Sequence[float]
    style: str
    letter: str = ""
    is_dotted: bool = False


def plot(
    curves: Sequence[PlotCurve],
    width: int,
    height: int,
    x_range: tuple[float, float],
    x_labels: tuple[str, str],
    min_span: float,
    is_ascii: bool,
    mark_x: float | None = None,
) -> list[Text]:
    """Draw curves into a rectangle of ``width`` by ``height`` characters, labels included.

    The vertical axis spans at least ``min_span``; a vertical line marks ``mark_x``.
    """
    low, high = _y_range(curves, min_span)
    label_width = max(len(_number(low)), len(_number(high)))
    canvas = Canvas(width - label_width - 1, height - 1, is_ascii)

    def to_canvas(x: float, y: float) -> Point:
        return (x - x_range[0]) / (x_range[1] - x_range[0]), (y - low) / (high - low)

    if mark_x is not None:
        canvas.line([to_canvas(mark_x, low), to_canvas(mark_x, high)], _DIM)
    elif low < 0.0 < high:
        canvas.line([to_canvas(x, 0.0) for x in x_range], _DIM, _DOT_INTERVAL)
    points_of_curves = [[to_canvas(x, y) for x, y in zip(each.x, each.y, strict=True)] for each in curves]
    for curve, points in zip(curves, points_of_curves, strict=True):
        canvas.line(points, curve.style, _DOT_INTERVAL if curve.is_dotted else 1)
    for curve, points in zip(curves, points_of_curves, strict=True):
        known = [(x, y) for x, y in points if math.isfinite(x + y)]
        if curve.letter and known:
            canvas.letter(known[-1], curve.letter, f"bold {curve.style}")
    return _with_axes(canvas, (_number(low), _number(high)), label_width, x_labels, "|" if is_ascii else "│")


def _with_axes(
    canvas: Canvas, y_labels: tuple[str, str], label_width: int, x_labels: tuple[str, str], bar: str
) -> list[Text]:
    """Rows of the canvas with labels of the axes."""
    lines = []
    last = canvas.height - 1
    for index, row in enumerate(canvas.rows()):
        label = y_labels[1] if index == 0 else y_labels[0] if index == last else ""
        lines.append(Text.assemble((f"{label:>{label_width}}{bar}", _DIM), row))
    start_label, end_label = x_labels
    x_axis = " " * (label_width + 1) + start_label + end_label.rjust(canvas.width - len(start_label))
    return [*lines, Text(x_axis, _DIM)]


def _y_range(curves: Iterable[PlotCurve], min_span: float) -> tuple[float, float]:
    """Limits at round numbers around all values."""
    values = [value for curve in curves for value in curve.y if math.isfinite(value)]
    low, high = (min(values), max(values)) if values else (0.0, 0.0)
    missing_span = min_span - (high - low)
    if missing_span > 0.0:
        low, high = low - missing_span / 2.0, high + missing_span / 2.0
    step = _round_step((high - low) / 8.0)
    return math.floor(low / step + 1e-9) * step, math.ceil(high / step - 1e-9) * step


def _round_step(span: float) -> float:
    """Smallest 1, 2 or 5 times a power of ten that is not below a number."""
    decade = 10.0 ** math.floor(math.log10(span))
    return next(decade * step for step in _STEPS if decade * step >= span * (1.0 - 1e-9))


def _number(value: float) -> str:
    text = f"{value:z.3g}"
    return text if len(text) <= _LABEL_WIDTH else f"{value:z.0e}"


_STYLES = ("red", "green", "cyan")
#: The viewpoint is south-east of the unit and above it.
_VIEW_AXES = view_axes(math.radians(-65.0), math.radians(25.0))
#: A character is twice as high as it is wide.
_ASPECT = 2.0


def attitude_lines(attitude: Attitude, width: int, height: int, is_ascii: bool) -> list[Text]:
    """Draw the body axes in ``width`` by ``height`` characters."""
    canvas = Canvas(width, height, is_ascii)
    axis_length = min(0.5, 0.5 * height * _ASPECT / width) * 0.9
    centre: Point = (0.5, 0.5)
    in_view = (np.array(attitude.body_in_enu).T @ _VIEW_AXES).tolist()
    axes = zip(in_view, AXES, _STYLES, strict=True)
    # Axes that point away from the viewpoint are drawn first.
    for (right, up, _), axis, style in sorted(axes, key=lambda each: -each[0][2]):
        end = (centre[0] + axis_length * right, centre[1] + axis_length * up * width / (height * _ASPECT))
        canvas.line([centre, end], style)
        canvas.letter(end, axis, f"bold {style}")
    return canvas.rows()
