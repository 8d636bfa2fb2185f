"""Drawing with characters: dots of braille, or marks of plain ASCII where there is nothing better."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence

from rich.text import Text

#: Bit of each dot of a braille character, by row from the top and column.
_BRAILLE = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
_BRAILLE_BLANK = 0x2800
#: ASCII marks by which halves of a cell are set: upper 1, lower 2.
_ASCII = " '.:"
_NO_STYLE = ""

Point = tuple[float, float]


class Canvas:
    """A grid of characters, drawn on by coordinates from 0 to 1, from the left and from the bottom.

    Parameters
    ----------
    width, height : int
        In characters.
    is_ascii : bool
        Whether only ASCII may be used.
    """

    def __init__(self, width: int, height: int, is_ascii: bool = False) -> None:
        self.width, self.height = width, height
        self._is_ascii = is_ascii
        self._per_column, self._per_row = (1, 2) if is_ascii else (2, 4)
        self._bits: dict[tuple[int, int], int] = {}
        self._styles: dict[tuple[int, int], str] = {}
        self._letters: dict[tuple[int, int], str] = {}

    def line(self, points: Sequence[Point], style: str = _NO_STYLE, every: int = 1) -> None:
        """Join points by lines; a point that is not known breaks the line.

        With ``every`` above 1 only each so many columns of dots has one: the line is dotted.
        """
        before: tuple[int, int] | None = None
        for point in points:
            now = self._dot(point)
            if now is not None:
                for dot in _between(before or now, now):
                    if dot[0] % every == 0:
                        self._set(dot, style)
            before = now

    def letter(self, point: Point, letter: str, style: str = _NO_STYLE) -> None:
        """Write a character over whatever is at a point."""
        dot = self._dot(point)
        if dot is not None:
            cell = (dot[0] // self._per_column, dot[1] // self._per_row)
            self._letters[cell] = letter
            self._styles[cell] = style

    def rows(self) -> list[Text]:
        """The drawing, a text for each row from the top."""
        return [self._row(row) for row in range(self.height)]

    def _row(self, row: int) -> Text:
        cells = [(column, row) for column in range(self.width)]
        styled = itertools.groupby(cells, key=lambda cell: self._styles.get(cell, _NO_STYLE))
        parts = (("".join(map(self._character, same)), style) for style, same in styled)
        return Text.assemble(*parts)

    def _character(self, cell: tuple[int, int]) -> str:
        return self._letters.get(cell) or self._mark(self._bits.get(cell, 0))

    def _mark(self, bits: int) -> str:
        if self._is_ascii:
            return _ASCII[bits]
        return chr(_BRAILLE_BLANK + bits) if bits else " "

    def _dot(self, point: Point) -> tuple[int, int] | None:
        """Column and row of the dot at a point, from the upper left corner."""
        x, y = point
        if not (math.isfinite(x) and math.isfinite(y) and -1e-9 <= x <= 1 + 1e-9 and -1e-9 <= y <= 1 + 1e-9):
            return None
        columns, rows = self.width * self._per_column, self.height * self._per_row
        return round(x * (columns - 1)), round((1.0 - y) * (rows - 1))

    def _set(self, dot: tuple[int, int], style: str) -> None:
        column, row = dot
        cell = (column // self._per_column, row // self._per_row)
        bit = 1 << row % 2 if self._is_ascii else _BRAILLE[row % 4][column % 2]
        self._bits[cell] = self._bits.get(cell, 0) | bit
        if cell not in self._letters:
            self._styles[cell] = style


def _between(first: tuple[int, int], last: tuple[int, int]) -> Iterable[tuple[int, int]]:
    """All dots of the straight line from one dot to another."""
    steps = max(abs(last[0] - first[0]), abs(last[1] - first[1]), 1)
    for step in range(steps + 1):
        share = step / steps
        yield (
            round(first[0] + share * (last[0] - first[0])),
            round(first[1] + share * (last[1] - first[1])),
        )
