"""Reads and writes CSV tables; checks each cell and reports mistakes with line and column."""

from __future__ import annotations

import csv
import io
import math
import re
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields
from functools import cached_property, partial
from itertools import chain, islice
from pathlib import Path
from typing import Any, Generic, TypeVar

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import decode_text, read_limited, read_lines, write_whole
from gyrobench.bench.foundations.text import (
    WRITE_POINT,
    counted,
    did_you_mean,
    format_cell,
    has_decimal_comma,
)

_RowT = TypeVar("_RowT")

#: UTF-8, with or without the byte order mark that some spreadsheets write.
_ENCODING = "utf-8-sig"
#: Enough for some hundred thousand dwells.
_MAX_TABLE_BYTES = 100_000_000
#: Far beyond any measured value; squares and sums of values within these limits stay finite.
_MAX_NUMBER, _MIN_UNCERTAINTY = 1e30, 1e-30
#: Beyond the range of any gyro; much larger temperatures would fill the memory with empty bins.
COLDEST_C, HOTTEST_C = -273.15, 1000.0
_MAX_LISTED_PROBLEMS = 20
#: Separators that are used in place of a comma, and their names in messages.
_OTHER_SEPARATORS = {";": "';'", "\t": "a tab"}
_BATCH_LINES = 100
_INTEGER = re.compile(r"[-+]?[0-9]{1,18}")
_LINE = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")
_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")


class CsvTable:
    """A CSV text whose cells are read as values by row and column name.

    A wrong cell is recorded and gives a substitute value; :meth:`raise_problems` reports all wrong cells.

    Raises DocumentError if the header is missing, a column is missing or given twice, or a row has too few or
    too many cells.

    Parameters
    ----------
    text : str
        Content, with a header.
    name : str
        Name of the file in messages.
    required : sequence of str
        Columns that must be present.
    skipped_lines : int
        Number of lines of the file between the header and the first row of ``text``.

    Attributes
    ----------
    lines : list of int
        Line on which each row ends, from 1.
    header : list of str
        Names of the columns.
    """

    def __init__(self, text: str, name: str, required: Sequence[str], skipped_lines: int = 0) -> None:
        self._name = name
        #: Problems by column and kind: the first, and in how many rows.
        self._problems: dict[tuple[str, str], tuple[str, int]] = {}
        #: The rows as text, and the cells of the row that was read last: storing all cells would take five
        #: times the memory.
        self._rows: list[str] = []
        self._current, self._cells = -1, [""]
        self.lines: list[int] = []
        row_lines: list[str] = []
        reader = csv.reader(_lines(text, row_lines), strict=True)
        counts = []
        try:
            self.header = header = [cell.strip() for cell in next(reader, [])]
            row_lines.clear()
            for cells in reader:
                if cells:
                    self._rows.append("".join(row_lines))
                    self.lines.append(reader.line_num + skipped_lines)
                    counts.append(len(cells))
                row_lines.clear()
        except csv.Error as error:
            raise DocumentError(
                f"{name}:{reader.line_num + skipped_lines}: not valid CSV: {error}"
            ) from error
        self._columns = {column: index for index, column in enumerate(header)}
        self._check_shape(counts, required)

    def __len__(self) -> int:
        return len(self._rows)

    def is_numeric(self, column: str) -> bool:
        """Whether a column contains only numbers and empty cells, and at least one number."""
        texts = {self.text(index, column).lower() for index in range(len(self))} - {"", "nan"}
        return bool(texts) and all(
            _NUMBER.fullmatch(text) and abs(float(text)) <= _MAX_NUMBER for text in texts
        )

    def text(self, index: int, column: str) -> str:
        """Text of a cell; empty if the table has no such column."""
        position = self._columns.get(column)
        if position is None:
            return ""
        if index != self._current:
            self._current, self._cells = index, next(csv.reader([self._rows[index]], strict=True))
        return self._cells[position].strip()

    def name(self, index: int, column: str) -> str:
        """Read a name; refuses one that a spreadsheet would take for a formula."""
        text = self.text(index, column)
        if text.startswith(("=", "+", "-", "@")):
            self.problem(
                index, column, f"a name can't begin with '{text[0]}', as formulas do; found '{text}'"
            )
        return sys.intern(text)  # stored once, not once for each row

    def flags(self, index: int, column: str) -> tuple[str, ...]:
        """Read flags as written by :func:`gyrobench.bench.foundations.text.flag_text`; none if empty."""
        text = self.text(index, column)
        return tuple(map(sys.intern, text.split("; "))) if text else ()

    def choice(self, index: int, column: str, allowed: Collection[str]) -> str:
        """Read one of the allowed words."""
        text = self.text(index, column)
        if text not in allowed:
            near = did_you_mean(text, allowed)
            self.problem(index, column, f"expected one of {', '.join(allowed)}; found '{text}'{near}")
        return sys.intern(text)

    def integer(self, index: int, column: str) -> int:
        """Read a whole number."""
        text = self.text(index, column)
        if _INTEGER.fullmatch(text):
            return int(text)
        self.problem(index, column, f"expected a whole number; found '{text}'")
        return 0

    def number(self, index: int, column: str, may_be_empty: bool = False) -> float:
        """Read a number of plausible size; NaN for an empty cell or ``nan`` if ``may_be_empty``."""
        text = self.text(index, column)
        if text and _NUMBER.fullmatch(text):
            value = float(text)
            if abs(value) <= _MAX_NUMBER:
                return value
            self.problem(index, column, f"{value:g} is beyond {_MAX_NUMBER:g}")
        elif not (may_be_empty and text.lower() in ("", "nan")):
            point = f". {WRITE_POINT}" if has_decimal_comma(text) else ""
            self.problem(index, column, f"expected a number; found '{text}'{point}")
        return math.nan

    def uncertainty(self, index: int, column: str, may_be_empty: bool = False) -> float:
        """Read a standard uncertainty, which must be above zero."""
        value = self.number(index, column, may_be_empty)
        if value < _MIN_UNCERTAINTY:
            self.problem(index, column, f"an uncertainty must be above zero; found {value:g}")
        return value

    def part_of_uncertainty(self, index: int, column: str, may_be_empty: bool = False) -> float:
        """Read a part of a standard uncertainty, which may be zero."""
        value = self.number(index, column, may_be_empty)
        if value < 0.0:
            self.problem(index, column, f"a part of an uncertainty can't be negative; found {value:g}")
        return value

    def temperature(self, index: int, column: str, may_be_empty: bool) -> float:
        """Read the temperature of a gyro, degC."""
        value_c = self.number(index, column, may_be_empty)
        if value_c < COLDEST_C or value_c > HOTTEST_C:
            self.problem(
                index,
                column,
                f"{value_c:g} degC is not a gyro temperature; allowed: {COLDEST_C:g} to {HOTTEST_C:g}",
            )
        return value_c

    def rows(self, read: Callable[[int], _RowT]) -> list[_RowT]:
        """Call ``read`` with each row index. Raises DocumentError that lists the recorded problems."""
        rows = [read(index) for index in range(len(self))]
        self.raise_problems()
        return rows

    def problem(self, index: int, column: str, message: str) -> None:
        """Record that a cell is wrong; of problems alike in a column the first is listed."""
        key = column, message.partition("; found")[0]
        first, count = self._problems.get(
            key, (f"{self._name}:{self.lines[index]}: column {column}: {message}", 0)
        )
        self._problems[key] = first, count + 1

    def raise_problems(self) -> None:
        """Raise a DocumentError that lists the recorded problems, if there are any."""
        if not self._problems:
            return
        problems = [
            first + (f" (and in {counted(count - 1, 'more line')})" if count > 1 else "")
            for first, count in self._problems.values()
        ]
        unlisted = len(problems) - _MAX_LISTED_PROBLEMS
        lines = problems[:_MAX_LISTED_PROBLEMS] + ([f"... and {unlisted} more"] if unlisted > 0 else [])
        raise DocumentError("\n".join(lines))

    def _check_shape(self, counts: Sequence[int], required: Sequence[str]) -> None:
        header = self.header
        missing = [column for column in required if column not in self._columns]
        if missing:
            columns = f"the column{'s' if len(missing) > 1 else ''} {', '.join(missing)}"
            if not header and not counts:
                raise DocumentError(f"{self._name}:1: the file is empty. It needs a header with {columns}")
            for mark, name in _OTHER_SEPARATORS.items():
                if len(header) == 1 and mark in header[0]:
                    raise DocumentError(
                        f"{self._name}:1: the separator seems to be {name}. Write the table with commas and "
                        "decimal points"
                    )
            raise DocumentError(
                f"{self._name}:1: the header lacks {columns}; it has {', '.join(header) or 'none'}"
            )
        duplicates = sorted({column for column in header if header.count(column) > 1})
        if duplicates:
            raise DocumentError(f"{self._name}:1: the header gives {', '.join(duplicates)} more than once")
        for count, line in zip(counts, self.lines, strict=True):
            if count != len(header):
                raise DocumentError(f"{self._name}:{line}: {count} cells where the header has {len(header)}")


def _lines(text: str, row_lines: list[str]) -> Iterator[str]:
    """Yield the lines of a text with their ends; also appends each to ``row_lines``."""
    for line in _LINE.finditer(text):
        row_lines.append(line[0])
        yield line[0]


def format_csv(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format rows as CSV text with a header; lines end with a line feed."""
    return "".join(_format_lines(columns, rows))


def _format_lines(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    line = io.StringIO(newline="")
    writer = csv.writer(line, lineterminator="\r\n")  # so that a cell with either character is quoted
    for cells in chain([columns], rows):
        writer.writerow(cells)
        yield line.getvalue().removesuffix("\r\n") + "\n"
        line.seek(0)
        line.truncate()


CellReader = Callable[[CsvTable, int, str], Any]
#: Readers of cells by the type of the field.
_READERS: Mapping[str, CellReader] = {
    "str": lambda table, index, name: sys.intern(table.text(index, name)),  # mostly a few words
    "int": CsvTable.integer,
    "int | None": lambda table, index, name: table.integer(index, name) if table.text(index, name) else None,
    "tuple[str, ...]": CsvTable.flags,
    "float": partial(CsvTable.number, may_be_empty=True),
}


def one_of(allowed: Collection[str]) -> CellReader:
    """Return a reader of cells that contain one of the allowed words."""
    return lambda table, index, name: table.choice(index, name, allowed)


@dataclass(frozen=True)
class RecordTable(Generic[_RowT]):
    """A CSV table whose rows are instances of a data class.

    A cell is read by the type of its field: str, int, ``int | None``, float or flags; columns of fields with
    a default may be missing, and count as empty.
    """

    kind: type[_RowT]
    #: Used instead for the fields that they name.
    readers: Mapping[str, CellReader] = field(default_factory=dict)
    names: Mapping[str, str] = field(default_factory=dict)  #: Columns that differ in name from their fields.
    left_out: Collection[str] = ()  #: Fields without a column.

    @cached_property
    def _fields(self) -> list[Field[Any]]:
        return [each for each in fields(self.kind) if each.name not in self.left_out]  # type: ignore[arg-type]

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns, in order."""
        return tuple(self.names.get(each.name, each.name) for each in self._fields)

    def records(self, rows: Iterable[_RowT]) -> list[dict[str, Any]]:
        """Values of rows by column."""
        return [dict(zip(self.columns, self._values(row), strict=True)) for row in rows]

    def format(self, rows: Iterable[_RowT]) -> str:
        """CSV text with a header; lines end with a line feed."""
        return "".join(self._lines(rows))

    def write(self, path: Path, rows: Iterable[_RowT]) -> None:
        """Write a CSV file, atomically; raises as :func:`write_text`."""
        write_whole(path, map(str.encode, self._lines(rows)))

    def read(self, path: Path) -> list[_RowT]:
        """Read a CSV file. Raises DocumentError if it can't be read or is wrong, with all problems."""
        return self.parse(read_text(path), str(path))

    def parse(self, text: str, name: str) -> list[_RowT]:
        """Read CSV text called ``name`` in messages. Raises DocumentError, which lists all problems."""
        required = [
            column
            for each, column in zip(self._fields, self.columns, strict=True)
            if each.default is MISSING and each.default_factory is MISSING
        ]
        return self._rows(CsvTable(text, name, required))

    def iterate(self, path: Path) -> Iterator[_RowT]:
        """Read the rows one at a time, without holding the whole table in memory; no column may be missing.

        Raises DocumentError at the first part of the file that is wrong.
        """
        lines = read_lines(path, _MAX_TABLE_BYTES, DocumentError)
        header, skipped_lines = next(lines, b""), 0
        while (part := list(islice(lines, _BATCH_LINES))) or not skipped_lines:
            while sum(line.count(b'"') for line in part) % 2 and (line := next(lines, b"")):
                part.append(line)  # belongs to a quoted cell with line ends
            text = decode_text(path, b"".join([header, *part]), _ENCODING)
            yield from self._rows(CsvTable(text, str(path), self.columns, skipped_lines))
            skipped_lines += max(len(part), 1)

    def _values(self, row: _RowT) -> list[Any]:
        return [getattr(row, each.name) for each in self._fields]

    def _lines(self, rows: Iterable[_RowT]) -> Iterator[str]:
        return _format_lines(self.columns, (list(map(format_cell, self._values(row))) for row in rows))

    def _rows(self, table: CsvTable) -> list[_RowT]:
        cells = [
            (each.name, self.readers.get(each.name) or _READERS[str(each.type)], column)
            for each, column in zip(self._fields, self.columns, strict=True)
        ]
        return table.rows(
            lambda index: self.kind(**{name: read(table, index, column) for name, read, column in cells})
        )


def read_text(path: Path) -> str:
    """Read a UTF-8 file, without the byte order mark that some spreadsheets write.

    Raises DocumentError if the file can't be read, is too large, or is not UTF-8.
    """
    return decode_text(path, read_limited(path, _MAX_TABLE_BYTES, DocumentError), _ENCODING)


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 file atomically; line ends are not changed.

    Raises RunFolderError if the file can't be written.
    """
    write_whole(path, text.encode())
