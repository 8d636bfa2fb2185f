"""The tables of a run, with types and units."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pyarrow as pa
import pyarrow.csv

from gyrobench.bench.export.columns import field_of, type_of, unit_of
from gyrobench.bench.export.destination import Destination
from gyrobench.bench.foundations.csv_tables import read_text
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import file_sha256


def export_csv(path: Path, name: str, destination: Destination) -> None:
    """Write a CSV table of the run as Parquet, or as it is.

    Raises
    ------
    DocumentError
        The table can't be read.
    RunFolderError
        The file can't be written.
    """
    about = {"source": path.name, "source_sha256": file_sha256(path)}
    table = read_table(path)
    if name.endswith(".parquet"):
        destination.table(name, table.schema, iter([table]), **about)
        return
    units = {column: unit_of(column) for column in table.column_names if unit_of(column)}
    with destination.file(name, units=units, **about) as copy:
        copy.write_text(read_text(path), encoding="utf-8", newline="")


def read_table(path: Path) -> pa.Table:
    """Read a CSV table; an empty cell is null, but for text.

    Raises
    ------
    DocumentError
        It is no table, or a cell is not what its column says.
    """
    text = read_text(path)
    header = next(csv.reader(io.StringIO(text)), [])
    options = pa.csv.ConvertOptions(
        column_types={column: type_of(column) for column in header},
        null_values=[""],
        strings_can_be_null=False,
    )
    parse = pa.csv.ParseOptions(newlines_in_values=True)
    try:
        table = pa.csv.read_csv(io.BytesIO(text.encode()), parse_options=parse, convert_options=options)
    except pa.ArrowException as error:
        raise DocumentError(f"{path}: can't be read: {error}") from error
    return table.cast(pa.schema([field_of(column) for column in table.column_names]))
