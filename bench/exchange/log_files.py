"""Logs as text or binary records, read in batches; errors are reported with line and column."""

from __future__ import annotations

import gzip
import io
import itertools
import re
import zlib
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from gyrobench.bench.exchange.import_map import Column, RecordFormat, TextFormat
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.text import did_you_mean

if TYPE_CHECKING:
    from pyarrow import DataType
    from pyarrow.csv import CSVStreamingReader


_SEPARATORS = {"comma": ",", "semicolon": ";", "tab": "\t", "whitespace": " "}
_BLOCK_BYTES = 1 << 22
_HEAD_LINES = 20  # lines from which the separator and missing samples are recognised
_GZIP_SIGNATURE = b"\x1f\x8b"
_NOT_MEASURED = (
    "", "nan", "NaN", "NAN", "-nan", "-NaN", "na", "NA", "n/a", "N/A", "null", "NULL", "None", "none"
)  # fmt: skip
_CALENDAR_TIME = re.compile(r"\d{1,4}[-./]\d{1,2}[-./]\d{2,4}[ T]?")
_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[-+]?(inf|infinity)", re.IGNORECASE)
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"

#: Values of a batch of samples by column: float64, or text.
Batch = dict[Column, NDArray[Any]]


class TextLog:
    """A text log; without a header, its columns are ``column 1``, ...

    ``truncated`` states whether the last line was cut off and left out, once all batches are read.

    Raises DocumentError if the file can't be read or has no sample.
    """

    def __init__(self, path: Path, layout: TextFormat) -> None:
        self._path = path
        self._layout = layout
        self.truncated = False
        try:
            head = [line for _, line in itertools.islice(self._numbered_lines(), _HEAD_LINES)]
        except _READ_ERRORS as error:
            raise DocumentError(f"{path}: can't be read: {_error_text(error)}") from error
        if any("\0" in line for line in head):
            raise DocumentError(f"{path}: is not text. For binary records give 'records' in the import map")
        if len(head) < (2 if layout.header else 1):
            raise DocumentError(f"{path}: holds no sample. Was the logger running?")
        self._separator = _separator(head, layout)
        cells = self._split(head[0])
        self.columns = cells if layout.header else [f"column {index + 1}" for index in range(len(cells))]

    def batches(self, numbers: Sequence[Column], texts: Sequence[Column]) -> Iterator[Batch]:
        """Read columns batch by batch; missing values are NaN.

        ``numbers``, ``texts``: columns to read as float64, and as text. Raises DocumentError if the
        file lacks a column, or cells can't be read; the message lists them.
        """
        import pyarrow as pa

        indices = {column: self._index(column) for column in (*numbers, *texts)}
        if both := {indices[column] for column in numbers} & {indices[column] for column in texts}:
            raise DocumentError(
                f"{self._path}: the import map uses column {self.columns[min(both)]} as a number and as a "
                "status or position. Correct the import map"
            )
        names = [str(index) for index in range(len(self.columns))]
        types = {names[indices[column]]: pa.float64() for column in numbers}
        types |= {names[indices[column]]: pa.string() for column in texts}
        short_rows: list[int] = []

        def skip(row: Any) -> str:
            short_rows.append(row.actual_columns)
            return "skip"

        with _open_decompressed(self._path) as stream:
            source = _SampleLines(stream, self._layout, self._separator)
            try:
                reader = self._reader(source, names, types, skip)
                for batch in reader:
                    yield {
                        column: batch[names[index]].to_numpy(zero_copy_only=False)
                        for column, index in indices.items()
                    }
            except _READ_ERRORS as error:
                raise DocumentError(f"{self._path}: can't be read: {_error_text(error)}") from error
            except pa.ArrowInvalid as error:
                raise self._cell_errors(indices, numbers, str(error)) from error
        if len(short_rows) > 1 or (short_rows and short_rows[0] > len(self.columns)):
            raise self._cell_errors(indices, numbers, "lines with another number of cells")
        self.truncated = bool(short_rows)
        last_samples = deque((cells for _, cells in self._numbered_samples()), 1) if self.truncated else ()
        if any(len(cells) >= len(self.columns) for cells in last_samples):  # the short line is another one
            raise self._cell_errors(indices, numbers, "a line with another number of cells")

    def _reader(
        self, source: _SampleLines, names: list[str], types: dict[str, DataType], skip: Callable[[Any], str]
    ) -> CSVStreamingReader:
        import pyarrow as pa
        from pyarrow import csv

        return csv.open_csv(
            pa.PythonFile(source, mode="r"),
            read_options=csv.ReadOptions(column_names=names, block_size=_BLOCK_BYTES, use_threads=False),
            parse_options=csv.ParseOptions(
                delimiter="\t" if self._separator == " " else self._separator, invalid_row_handler=skip
            ),
            convert_options=csv.ConvertOptions(
                include_columns=sorted(types),
                column_types=types,
                decimal_point=self._layout.decimal,
                null_values=list(_NOT_MEASURED),
                strings_can_be_null=False,
            ),
        )

    def _numbered_lines(self) -> Iterator[tuple[int, str]]:
        """Lines that are header or samples, with their numbers from 1."""
        with _open_decompressed(self._path) as stream:
            for number, raw in enumerate(stream, 1):
                line = raw.decode("utf-8-sig", "replace").rstrip("\r\n")
                if number > self._layout.skip_lines and self._is_sample(line):
                    yield number, line

    def _is_sample(self, line: str) -> bool:
        comment = self._layout.comment
        return bool(line.strip()) and not (comment and line.lstrip().startswith(comment))

    def _split(self, line: str) -> list[str]:
        cells = line.split() if self._separator == " " else line.split(self._separator)
        return [cell.strip().strip('"') for cell in cells]

    def _index(self, column: Column) -> int:
        if isinstance(column, int):
            if column <= len(self.columns):
                return column - 1
        elif self._layout.header and self.columns.count(column) == 1:
            return self.columns.index(column)
        elif self.columns.count(column) > 1:
            raise DocumentError(f"{self._path}: the header gives '{column}' twice; map it by its number")
        raise DocumentError(
            f"{self._path}: there is no column '{column}'{did_you_mean(str(column), self.columns)}. It has "
            f"{len(self.columns)}: {', '.join(map(repr, self.columns))}. Correct the import map"
        )

    def _numbered_samples(self) -> Iterator[tuple[int, list[str]]]:
        """Cells of each sample, with the number of its line from 1."""
        lines = itertools.islice(self._numbered_lines(), 1 if self._layout.header else 0, None)
        return ((number, self._split(line)) for number, line in lines)

    def _cell_errors(
        self, indices: dict[Column, int], numbers: Sequence[Column], reason: str
    ) -> DocumentError:
        """Error that lists wrong cells, found line by line; ``reason``: message if none is found."""
        problems: dict[str, str] = {}
        repeats: Counter[str] = Counter()
        problem_lines: Counter[int] = Counter()
        first_line = 0

        def add(kind: str, line: int, text: str) -> None:
            repeats[kind] += kind in problems
            problem_lines[line] += 1
            problems.setdefault(kind, f"{self._path}:{line}: {text}")

        for line, cells in self._numbered_samples():
            first_line = first_line or line
            if len(cells) != len(self.columns):
                add("", line, f"{len(cells)} cells instead of {len(self.columns)}")
                continue
            for column in dict.fromkeys(numbers):
                name, cell = self.columns[indices[column]], cells[indices[column]]
                if not _is_number(cell, self._layout.decimal):
                    other = "." if self._layout.decimal == "," else ","
                    hint = f" (is 'text.decimal' '{other}'?)" if _is_number(cell, other) else ""
                    if _CALENDAR_TIME.match(cell):
                        hint = " (a calendar time: give 'time.unit' iso8601, or 'time.format')"
                    add(name, line, f"column {name}: expected a number; found '{cell[:60]}'{hint}")
        messages = [
            f"{text} (and in {repeats[kind]} more lines)" if repeats[kind] else text
            for kind, text in problems.items()
        ]
        if self._layout.header and not repeats.total() and problem_lines == {first_line: len(set(numbers))}:
            messages.append(
                "If that line has the units of the columns, give 'text: {header: false, skip_lines: "
                f"{first_line}}}' and map the columns by their numbers"
            )
        return DocumentError("\n".join(messages) or f"{self._path}: can't be read: {reason}")


def _open_decompressed(path: Path) -> IO[bytes]:
    """Open a file, decompressed if it is compressed by gzip."""
    with path.open("rb") as stream:
        is_compressed = stream.read(2) == _GZIP_SIGNATURE
    return cast("IO[bytes]", gzip.open(path)) if is_compressed else path.open("rb")


#: Errors of reading a file, compressed or not.
_READ_ERRORS = (OSError, EOFError, zlib.error)


def _error_text(error: Exception) -> str:
    return (error.strerror if isinstance(error, OSError) else None) or str(error)


def _size_bytes(path: Path) -> int:
    """Size of the decompressed file."""
    size = 0
    with _open_decompressed(path) as stream:
        while block := stream.read(_BLOCK_BYTES):
            size += len(block)
    return size


class _SampleLines(io.RawIOBase):
    """Lines of samples of a text log, as bytes; blanks that separate cells are replaced by one tab."""

    def __init__(self, stream: IO[bytes], layout: TextFormat, separator: str) -> None:
        self._stream = stream
        self._has_blank_separators = separator == " "
        comment = layout.comment
        self._comment = (
            re.compile(rb"^[ \t]*" + re.escape(comment.encode()) + rb"[^\n]*\n?", re.MULTILINE)
            if comment
            else None
        )
        for _ in range(layout.skip_lines):
            stream.readline()
        if layout.header:
            while not self._clean(stream.readline()).strip():
                pass

    def readable(self) -> bool:
        """Whether it can be read: always."""
        return True

    def read(self, size: int = -1) -> bytes:
        """Read about ``size`` bytes, always whole lines; empty at the end of the file."""
        while True:
            block = self._stream.read(_BLOCK_BYTES if size < 0 else size) + self._stream.readline()
            cleaned = self._clean(block)
            if cleaned or not block:
                return cleaned

    def _clean(self, block: bytes) -> bytes:
        """Lines without comments, as UTF-8, with one tab between cells that blanks separate."""
        block = block.removeprefix(_BYTE_ORDER_MARK)
        if self._comment:
            block = self._comment.sub(b"", block)
        # pyarrow prints a traceback if it can't decode a line that it passes to the row handler.
        if not block.isascii():
            block = block.decode(errors="replace").encode()
        if self._has_blank_separators:
            block = re.sub(rb"[ \t]+", b"\t", re.sub(rb"(?m)^[ \t]+|[ \t]+(?=\r?$)", b"", block))
        return block


def _separator(head: list[str], layout: TextFormat) -> str:
    """Separator of the cells, from the layout or the first line."""
    if layout.separator != "auto":
        return _SEPARATORS[layout.separator]
    candidates = "\t;" if layout.decimal == "," else "\t;,"
    for separator in candidates:
        if separator in head[0]:
            return separator
    return " "


def _is_number(cell: str, decimal: str) -> bool:
    if cell in _NOT_MEASURED:
        return True
    return (decimal == "." or "." not in cell) and bool(_NUMBER.fullmatch(cell.replace(decimal, ".")))


_BATCH_RECORDS = 100_000


class RecordLog:
    """A log of binary records; an incomplete record at the end is left out, and ``truncated`` is set.

    Raises DocumentError if the file can't be read or has no record.
    """

    def __init__(self, path: Path, layout: RecordFormat) -> None:
        self._path = path
        self._layout = layout
        self.columns = list(layout.fields)
        self._dtype = np.dtype(layout.type)
        self._record_bytes = self._dtype.itemsize * len(self.columns)
        try:
            size = _size_bytes(path) - layout.header_bytes
        except _READ_ERRORS as error:
            raise DocumentError(f"{path}: can't be read: {_error_text(error)}") from error
        if size < self._record_bytes:
            raise DocumentError(
                f"{path}: holds no record of {self._record_bytes} bytes. Was the logger running?"
            )
        self.truncated = size % self._record_bytes > 0

    def batches(self, numbers: Sequence[Column], texts: Sequence[Column]) -> Iterator[Batch]:
        """Read columns batch by batch, ``numbers`` as float64 and ``texts`` as text.

        Raises DocumentError if there is no such column, or the file can't be read.
        """
        indices = {column: self._index(column) for column in (*numbers, *texts)}
        try:
            with _open_decompressed(self._path) as stream:
                stream.seek(self._layout.header_bytes)
                while data := stream.read(_BATCH_RECORDS * self._record_bytes):
                    record_count = len(data) // self._record_bytes
                    value_count = record_count * len(self.columns)
                    records = (
                        np.frombuffer(data, self._dtype, value_count).reshape(record_count, -1).astype(float)
                    )
                    yield {column: records[:, indices[column]] for column in numbers} | {
                        column: np.array([f"{value:g}" for value in records[:, indices[column]]])
                        for column in texts
                    }
        except _READ_ERRORS as error:
            raise DocumentError(f"{self._path}: can't be read: {_error_text(error)}") from error

    def _index(self, column: Column) -> int:
        if isinstance(column, int) and column <= len(self.columns):
            return column - 1
        if column in self.columns:
            return self.columns.index(str(column))
        raise DocumentError(
            f"{self._path}: there is no field '{column}'. The import map names {len(self.columns)}: "
            f"{', '.join(self.columns)}"
        )
