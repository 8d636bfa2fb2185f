"""Telemetry: the readings of the bench's instruments, as a folder of Parquet files.

pandas, polars, DuckDB and the like open the folder as one table. Where readings are missing, a row
of NaN with the time of the next reading marks the gap, so that a line through the readings is
broken there.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import make_folder, read_limited, write_whole
from gyrobench.bench.runs.folder import find_parts, part_path

#: Columns, in order; all are 64-bit floats, NaN where a value is not known.
TELEMETRY_COLUMNS = (
    "time_s",
    "chamber_set_c",
    "chamber_c",
    "outer_deg",
    "inner_deg",
    "outer_rate_dps",
    "inner_rate_dps",
    "gyro_x_c",
    "gyro_y_c",
    "gyro_z_c",
    "board_x_c",
    "board_y_c",
    "board_z_c",
    "case_c",
    "ins_mode",
    "step",
    "dwell",
)
_ROWS_PER_PART = 900
#: Maximum loss after a kill.
_MAX_UNWRITTEN_S = 600.0
_SUFFIX = ".parquet"
_MAX_PART_BYTES, _MAX_PART_ROWS = 10_000_000, 100_000


class Telemetry:
    """Writes the readings, part by part.

    The present part is rewritten as a whole with every flush until it is full: a run of weeks has few parts,
    and each is readable at any instant. Existing parts are kept; the readings continue in a new part, after a
    gap. Raises RunFolderError if a part can't be written.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        make_folder(folder)
        parts = find_parts(folder, _SUFFIX)
        self._number = 1 + max(parts, default=0)
        #: The present part, column by column, and how many of its rows are filled, and written.
        self._values = np.empty((len(TELEMETRY_COLUMNS), _ROWS_PER_PART + 1))
        self._rows = self._written_rows = 0
        self._gap = bool(parts)

    def add(self, row: tuple[float, ...]) -> None:
        """Add one row with the values of :data:`TELEMETRY_COLUMNS`."""
        if self._rows >= _ROWS_PER_PART:
            self.flush()  # the last try failed
        if self._gap:
            self._gap = False
            self._append((row[0], *[math.nan] * (len(TELEMETRY_COLUMNS) - 1)))
        self._append(row)
        unwritten_s = row[0] - self._values[0, self._written_rows]
        if unwritten_s >= _MAX_UNWRITTEN_S or self._rows >= _ROWS_PER_PART:
            self.flush()

    def _append(self, row: tuple[float, ...]) -> None:
        self._values[:, self._rows] = row
        self._rows += 1

    def flush(self) -> None:
        """Write what has been collected; when this returns, it is on the disk."""
        if self._written_rows == self._rows:
            return
        # By buffers: pyarrow's own conversions import pandas, where it is installed.
        columns = [
            pa.Array.from_buffers(pa.float64(), self._rows, [None, pa.py_buffer(each)])
            for each in self._values
        ]
        buffer = io.BytesIO()
        table = pa.Table.from_arrays(columns, TELEMETRY_COLUMNS)
        pq.write_table(table, buffer, use_dictionary=False, write_statistics=False)
        write_whole(part_path(self._folder, self._number, _SUFFIX), buffer.getvalue())
        self._written_rows = self._rows
        if self._rows >= _ROWS_PER_PART:
            self._number += 1
            self._rows = self._written_rows = 0


def read_telemetry(folder: Path, columns: Sequence[str] = TELEMETRY_COLUMNS) -> dict[str, FloatArray]:
    """All readings of a run, column name to values, in the order of time.

    Raises RunFolderError if a part can't be read.
    """
    parts = [_read_part(path, columns) for path in find_parts(folder, _SUFFIX).values()]
    # Columns leave the parts one by one, or the readings were in the memory twice.
    return {name: np.concatenate([np.empty(0), *(part.pop(name) for part in parts)]) for name in columns}


def damaged_telemetry(folder: Path) -> dict[Path, str]:
    """Parts that can't be read, and why. Raises RunFolderError if the folder can't be read."""
    damaged = {}
    for path in find_parts(folder, _SUFFIX).values():
        try:
            _read_part(path)
        except RunFolderError as error:
            damaged[path] = str(error)
    return damaged


def last_reading_s(folder: Path) -> float:
    """Time of the last reading of a run, zero where there is none; may be later than its last journal entry.

    Raises RunFolderError if the last part can't be read.
    """
    parts = find_parts(folder, _SUFFIX)
    return float(_read_part(parts[max(parts)])["time_s"].max(initial=0.0)) if parts else 0.0


def _floats(column: pa.ChunkedArray) -> FloatArray:
    """Values without pyarrow's own conversion, which imports pandas."""
    if column.type != pa.float64() or column.null_count:  # written by another program
        column = column.cast(pa.float64()).fill_null(math.nan)
    values = column.combine_chunks()
    return np.frombuffer(values.buffers()[1] or b"", np.float64, len(values), 8 * values.offset)


def _read_part(path: Path, columns: Sequence[str] = TELEMETRY_COLUMNS) -> dict[str, FloatArray]:
    content = pa.BufferReader(read_limited(path, _MAX_PART_BYTES, RunFolderError))
    try:
        part = pq.ParquetFile(content)
        # Damaged bytes could request gigabytes.
        if part.metadata.num_rows > _MAX_PART_ROWS:
            raise RunFolderError(f"{path}: {part.metadata.num_rows} rows; a part has up to {_ROWS_PER_PART}")
        table = part.read(columns=list(columns), use_threads=False)  # their start takes longer
        return {name: _floats(table.column(name)) for name in columns}
    except (OSError, KeyError, ValueError, pa.ArrowException) as error:
        if isinstance(error, RunFolderError):
            raise
        raise RunFolderError(f"{path}: can't be read: {error}") from error
