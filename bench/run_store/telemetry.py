"""Telemetry: the readings of the bench's instruments, as a folder of Parquet files.

pandas, polars, DuckDB and the like open the folder as one table.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from bench.errors import RunFolderError

#: Columns, in order; all are 64-bit floats, NaN where a value is not known.
COLUMNS = (
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
_PART = "part-{:05d}.parquet"


class Telemetry:
    """Writes the readings, part by part.

    Raises
    ------
    RunFolderError
        A part can't be written.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        self._next = 1 + max((int(path.stem[5:]) for path in folder.glob("part-*.parquet")), default=0)
        self._rows: list[tuple[float, ...]] = []

    def add(self, row: tuple[float, ...]) -> None:
        """Add one row with the values of :data:`COLUMNS`."""
        self._rows.append(row)
        if len(self._rows) >= _ROWS_PER_PART:
            self.flush()

    def flush(self) -> None:
        """Write what has been collected."""
        if not self._rows:
            return
        values = np.array(self._rows, dtype=np.float64).T
        path = self._folder / _PART.format(self._next)
        temporary = path.with_suffix(".part")
        try:
            pq.write_table(pa.table(dict(zip(COLUMNS, values, strict=True))), temporary)
            temporary.replace(path)
        except OSError as error:
            raise RunFolderError(f"{path}: can't be written: {error}. Is the disk full?") from error
        self._next += 1
        self._rows.clear()


def read_telemetry(folder: Path) -> dict[str, NDArray[np.float64]]:
    """All readings of a run, column name to values, in the order of time.

    Raises
    ------
    RunFolderError
        A part can't be read.
    """
    parts = sorted(folder.glob("part-*.parquet"))
    try:
        tables = [pq.read_table(path) for path in parts]
    except (OSError, pa.ArrowException) as error:
        raise RunFolderError(f"{folder}: can't be read: {error}") from error
    if not tables:
        return {name: np.empty(0) for name in COLUMNS}
    table = pa.concat_tables(tables)
    return {name: table.column(name).to_numpy() for name in COLUMNS}
