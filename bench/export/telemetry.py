"""Readings of the bench's instruments as one table."""

from __future__ import annotations

from datetime import datetime

import numpy as np
import pyarrow as pa

from gyrobench.bench.export.calendar_times import UTC_FIELD, calendar_times
from gyrobench.bench.export.columns import field_of, type_of
from gyrobench.bench.export.destination import Destination
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.telemetry import COLUMNS, read_telemetry

_SCHEMA = pa.schema([UTC_FIELD, *(field_of(name) for name in COLUMNS)])


def export_telemetry(folder: RunFolder, began: datetime, name: str, destination: Destination) -> None:
    """Write all readings; where readings are missing a row without values stands between them.

    Raises
    ------
    RunFolderError
        Telemetry can't be read, or the file can't be written.
    """
    readings = read_telemetry(folder.telemetry)
    columns = {column: _values(column, values) for column, values in readings.items()}
    table = pa.table({UTC_FIELD.name: calendar_times(began, readings["time_s"]), **columns})
    destination.table(name, _SCHEMA, iter([table]), source=folder.telemetry.name)


def _values(column: str, values: np.ndarray) -> pa.Array:
    """Values with null for what is not known."""
    known = pa.array(values, pa.float64(), from_pandas=True)
    return known.cast(type_of(column))
