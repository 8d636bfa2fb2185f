"""Logs as binary records of equal length, read in batches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.sensor_log.document import Column, RecordFormat
from gyrobench.bench.sensor_log.text_log import Batch

_BATCH_RECORDS = 100_000


class RecordLog:
    """A log of binary records.

    Parameters
    ----------
    path : Path
        The file.
    layout : RecordFormat
        How it is written.

    Attributes
    ----------
    columns : list of str
        Names of the fields.
    truncated : bool
        Whether the file ends in the middle of a record, which is left out.

    Raises
    ------
    DocumentError
        The file can't be read or has no record.
    """

    def __init__(self, path: Path, layout: RecordFormat) -> None:
        self._path = path
        self._layout = layout
        self.columns = list(layout.fields)
        self._type = np.dtype(layout.type)
        self._bytes = self._type.itemsize * len(self.columns)
        try:
            size = path.stat().st_size - layout.header_bytes
        except OSError as error:
            raise DocumentError(f"{path}: can't be read: {error.strerror}") from error
        if size < self._bytes:
            raise DocumentError(f"{path}: holds no record of {self._bytes} bytes. Was the logger running?")
        self.truncated = size % self._bytes > 0

    def batches(self, numbers: Sequence[Column], texts: Sequence[Column]) -> Iterator[Batch]:
        """Read columns batch by batch, as float64; those wanted as text as text.

        Raises
        ------
        DocumentError
            There is no such column, or the file can't be read.
        """
        indices = {column: self._index(column) for column in (*numbers, *texts)}
        try:
            with self._path.open("rb") as stream:
                stream.seek(self._layout.header_bytes)
                while data := stream.read(_BATCH_RECORDS * self._bytes):
                    whole = len(data) // self._bytes
                    count = whole * len(self.columns)
                    records = np.frombuffer(data, self._type, count).reshape(whole, -1).astype(float)
                    yield {column: records[:, indices[column]] for column in numbers} | {
                        column: np.array([f"{value:g}" for value in records[:, indices[column]]])
                        for column in texts
                    }
        except OSError as error:
            raise DocumentError(f"{self._path}: can't be read: {error.strerror}") from error

    def _index(self, column: Column) -> int:
        if isinstance(column, int) and column <= len(self.columns):
            return column - 1
        if column in self.columns:
            return self.columns.index(str(column))
        raise DocumentError(
            f"{self._path}: there is no field '{column}'. The mapping names {len(self.columns)}: "
            f"{', '.join(self.columns)}"
        )
