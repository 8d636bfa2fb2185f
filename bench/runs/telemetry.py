"""Telemetry: the readings of the bench's instruments, as a folder of Parquet files.

pandas, polars, DuckDB and the like open the folder as one table. If readings are missing, a row
of NaN with the time of the next reading marks the gap, so that a line through the readings is
broken there.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import make_folder, read_limited, write_whole
from gyrobench.bench.runs.folder import find_parts, part_path

#: Columns, in order; all are 64-bit floats, NaN for unknown values.
TELEMETRY_COLUMNS = (
    "time_s", "chamber_set_c", "chamber_c", "outer_deg", "inner_deg", "outer_rate_dps", "inner_rate_dps",
    "gyro_x_c", "gyro_y_c", "gyro_z_c", "board_x_c", "board_y_c", "board_z_c", "case_c", "ins_mode",
    "step", "dwell",
)  # fmt: skip
_COLUMN_NAMES = frozenset(TELEMETRY_COLUMNS)
_ROWS_PER_PART = 900
#: Maximum loss after a kill, in real time and on virtual time, where writing takes a large share of the run.
_MAX_UNWRITTEN_S, _MAX_UNWRITTEN_VIRTUAL_S = 60.0, 600.0
_SUFFIX = ".parquet"
_MAX_PART_BYTES, _MAX_PART_ROWS = 10_000_000, 100_000


class Telemetry:
    """Writes the readings, part by part.

    Each flush rewrites the whole current part until it is full: so a run of weeks has few parts, and each is
    readable at any time. Existing parts are kept; the readings continue in a new part, after a gap.
    ``is_virtual``: whether the run is on virtual time; a kill then loses more readings. Raises RunFolderError
    if a part can't be written.
    """

    def __init__(self, folder: Path, is_virtual: bool = False) -> None:
        self._folder = folder
        self._max_unwritten_s = _MAX_UNWRITTEN_VIRTUAL_S if is_virtual else _MAX_UNWRITTEN_S
        make_folder(folder)
        parts = find_parts(folder, _SUFFIX)
        self._part_number = 1 + max(parts, default=0)
        #: The current part by column, and the numbers of rows that are filled and that are written.
        self._values = np.empty((len(TELEMETRY_COLUMNS), _ROWS_PER_PART + 1))
        self._row_count = self._written_count = 0
        self._needs_gap = bool(parts)

    def add(self, row: Mapping[str, float]) -> None:
        """Add one row: its time, and known values by their columns. Raises KeyError for another name."""
        if not row.keys() <= _COLUMN_NAMES:
            raise KeyError(*(row.keys() - _COLUMN_NAMES))
        if self._row_count >= _ROWS_PER_PART:
            self.flush()  # the last attempt failed
        if self._needs_gap:
            self._needs_gap = False
            self._append({"time_s": row["time_s"]})
        self._append(row)
        unwritten_s = row["time_s"] - self._values[0, self._written_count]
        if unwritten_s >= self._max_unwritten_s or self._row_count >= _ROWS_PER_PART:
            self.flush()

    def _append(self, row: Mapping[str, float]) -> None:
        self._values[:, self._row_count] = [*map(row.get, TELEMETRY_COLUMNS)]  # None becomes NaN
        self._row_count += 1

    def flush(self) -> None:
        """Write the collected rows; they are on the disk when this returns."""
        if self._written_count == self._row_count:
            return
        # From buffers, since pyarrow's own conversions import pandas if it is installed.
        columns = [
            pa.Array.from_buffers(pa.float64(), self._row_count, [None, pa.py_buffer(each)])
            for each in self._values
        ]
        buffer = io.BytesIO()
        table = pa.Table.from_arrays(columns, TELEMETRY_COLUMNS)
        pq.write_table(table, buffer, use_dictionary=False, write_statistics=False)
        write_whole(part_path(self._folder, self._part_number, _SUFFIX), buffer.getvalue())
        self._written_count = self._row_count
        if self._row_count >= _ROWS_PER_PART:
            self._part_number += 1
            self._row_count = self._written_count = 0


def read_telemetry(folder: Path, columns: Sequence[str] = TELEMETRY_COLUMNS) -> dict[str, FloatArray]:
    """All readings of a run, column name to values, in the order of time.

    Raises RunFolderError if a part can't be read.
    """
    parts = [_read_part(path, columns) for path in find_parts(folder, _SUFFIX).values()]
    # Columns are removed from the parts one by one, so that the readings are not in memory twice.
    return {name: np.concatenate([np.empty(0), *(part.pop(name) for part in parts)]) for name in columns}


def damaged_telemetry(folder: Path) -> dict[Path, str]:
    """Parts that can't be read, with the reasons. Raises RunFolderError if the folder can't be read."""
    damaged = {}
    for path in find_parts(folder, _SUFFIX).values():
        try:
            _read_part(path)
        except RunFolderError as error:
            damaged[path] = str(error)
    return damaged


def last_reading_s(folder: Path) -> float:
    """Time of the last reading of a run, zero if there is none; may be later than its last journal entry.

    Raises RunFolderError if the last part can't be read.
    """
    parts = find_parts(folder, _SUFFIX)
    return float(_read_part(parts[max(parts)])["time_s"].max(initial=0.0)) if parts else 0.0


def _floats(column: pa.ChunkedArray) -> FloatArray:
    """Values of a column, without pyarrow's own conversion, which imports pandas."""
    if column.type != pa.float64() or column.null_count:  # written by another program
        column = column.cast(pa.float64()).fill_null(math.nan)
    values = column.combine_chunks()
    return np.frombuffer(values.buffers()[1] or b"", np.float64, len(values), 8 * values.offset)


def _read_part(path: Path, columns: Sequence[str] = TELEMETRY_COLUMNS) -> dict[str, FloatArray]:
    """Columns of one part; raises RunFolderError if it can't be read."""
    content = pa.BufferReader(read_limited(path, _MAX_PART_BYTES, RunFolderError))
    try:
        part = pq.ParquetFile(content)
        # Damaged bytes could request gigabytes.
        if part.metadata.num_rows > _MAX_PART_ROWS:
            raise RunFolderError(f"{path}: {part.metadata.num_rows} rows; a part has up to {_ROWS_PER_PART}")
        table = part.read(columns=list(columns), use_threads=False)  # starting them takes longer
        unknown = np.full(part.metadata.num_rows, math.nan)  # a column that an older version did not write
        known = {"time_s", *table.column_names}
        return {name: _floats(table.column(name)) if name in known else unknown for name in columns}
    except (OSError, KeyError, ValueError, pa.ArrowException) as error:
        if isinstance(error, RunFolderError):
            raise
        raise RunFolderError(f"{path}: can't be read: {error}") from error
