"""Writes the selected data of a run: tables, telemetry, navigation, CAN frames, compensation."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv

from gyrobench.bench.closure.files import read_held_out_cycles
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.dwells.closure_inputs import read_campaign
from gyrobench.bench.dwells.dwell import measurement_setup
from gyrobench.bench.exchange.can_export import (
    UTC_FIELD,
    TimedLog,
    calendar_times,
    export_navigation,
    write_blf,
)
from gyrobench.bench.exchange.compensation_tables import compensation_files, export_compensation
from gyrobench.bench.exchange.export_folder import ExportFolder, data_origin, field_of, type_of, unit_of
from gyrobench.bench.foundations.csv_tables import read_text
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError, RunFolderError
from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.foundations.text import listed
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.provenance import started_utc
from gyrobench.bench.runs.telemetry import COLUMNS, read_telemetry
from gyrobench.bench.station.station import Station


class DataKind(StrEnum):
    """What can be exported."""

    DWELLS = "dwells"
    BINS = "bins"
    JOINT = "joint"
    VERIFICATION = "verification"
    TELEMETRY = "telemetry"
    NAVIGATION = "navigation"
    CAN = "can"
    COMPENSATION = "compensation"


class Format(StrEnum):
    """Formats of files."""

    PARQUET = "parquet"
    CSV = "csv"
    BLF = "blf"
    MF4 = "mf4"


_CAN_FORMATS = (Format.BLF, Format.MF4)
_TABLE_FORMATS = (Format.PARQUET, Format.CSV)
#: What is written where nobody says so; navigation of a whole run is large, and seldom wanted.
_DEFAULT_KINDS = tuple(what for what in DataKind if what is not DataKind.NAVIGATION)
_DEFAULT_FORMATS = (Format.PARQUET, Format.BLF)


@dataclass(frozen=True)
class ExportSelection:
    """What somebody wants of a run.

    Attributes
    ----------
    what : sequence of DataKind
        Empty for all that is usual.
    formats : sequence of Format
        Empty for Parquet and BLF. What has none of them is left out.
    dwell : int or None
        Navigation of this dwell alone.

    Raises
    ------
    DocumentError
        Something that is asked for by name has none of the formats, or a dwell is chosen of nothing.
    """

    what: Sequence[DataKind] = ()
    formats: Sequence[Format] = ()
    dwell: int | None = None

    def __post_init__(self) -> None:
        unfit = [str(what) for what in self.what if not self.suffixes(what)]
        if unfit:
            raise DocumentError(
                f"--format {','.join(self.formats)} does not fit {listed(unfit)}: CAN frames are blf "
                "or mf4, all else as parquet or csv"
            )
        if self.dwell is not None and DataKind.NAVIGATION not in self.what:
            raise DocumentError("--dwell chooses a dwell of the navigation; give --what navigation as well")

    def suffixes(self, what: DataKind) -> list[str]:
        """Endings of the files that something is written to."""
        can_be = _CAN_FORMATS if what is DataKind.CAN else _TABLE_FORMATS
        return [f".{each}" for each in self.formats or _DEFAULT_FORMATS if each in can_be]

    def kinds(self) -> list[DataKind]:
        """What is to be written."""
        return [what for what in self.what or _DEFAULT_KINDS if self.suffixes(what)]


def export_csv(path: Path, name: str, destination: ExportFolder) -> None:
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


_SCHEMA = pa.schema([UTC_FIELD, *(field_of(name) for name in COLUMNS)])


def export_telemetry(folder: RunFolder, began: datetime, name: str, destination: ExportFolder) -> None:
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


_TABLES = MappingProxyType(
    {
        DataKind.DWELLS: ("dwells",),
        DataKind.BINS: ("bias_bins",),
        DataKind.JOINT: ("joint", "joint_biases"),
        DataKind.VERIFICATION: ("verification",),
    }
)
_TABLE_MISSING = "{} is not there, as where a run was cut off; `gyrobench bins {}` makes it"


@dataclass(frozen=True)
class Exported:
    """What was written, and what was not.

    Attributes
    ----------
    files : list of Path
        In order.
    missing : dict of What to str
        What the run does not hold, and why.
    """

    files: list[Path]
    missing: dict[DataKind, str]


def export_run(folder: RunFolder, wanted: ExportSelection, out: Path, force: bool = False) -> Exported:
    """Write what is wanted of a run, as far as the run holds it; one that was cut off holds less.

    Parameters
    ----------
    out : Path
        Folder to write to; made if it isn't there.
    force : bool
        Whether files that are there are replaced.

    Raises
    ------
    DocumentError
        A table, station or DBC file is wrong.
    RunFolderError
        Files are there already, something can't be read or written, or the run holds nothing of what is
        wanted.
    """
    missing = {what: why for what in wanted.kinds() if (why := _why_missing(folder, what))}
    kinds = [what for what in wanted.kinds() if what not in missing]
    if not kinds:
        raise RunFolderError(
            f"{folder.path}: " + "; ".join(f"{what}: {why}" for what, why in missing.items())
        )
    destination = ExportFolder(out, data_origin(folder), force)
    destination.refuse_existing([name for what in kinds for name in _files(what, wanted)])
    for what in kinds:
        _write(folder, what, wanted, destination)
    destination.finish()
    return Exported(destination.written, missing)


def _why_missing(folder: RunFolder, what: DataKind) -> str:
    """Why the run does not hold something; empty where it does."""
    match what:
        case DataKind.VERIFICATION:
            return "" if folder.verification.exists() else "the run verified nothing"
        case DataKind.TELEMETRY:
            return "" if any(folder.telemetry.glob("part-*")) else "there are no readings"
        case DataKind.NAVIGATION | DataKind.CAN:
            return "" if any(folder.can.glob("part-*")) else "there are no CAN frames"
        case DataKind.COMPENSATION:
            is_closed = (folder.closure / "closure.json").exists()
            return "" if is_closed else f"the run was not searched; `gyrobench close {folder.path}` does that"
    names = [f"{table}.csv" for table in _TABLES[what]]
    missing = [name for name in names if not (folder.path / name).exists()]
    return _TABLE_MISSING.format(missing[0], folder.path) if missing else ""


def _files(what: DataKind, wanted: ExportSelection) -> list[str]:
    """Names of the files that something is written to."""
    suffixes = wanted.suffixes(what)
    if what is DataKind.COMPENSATION:
        return compensation_files(suffixes)
    names = _TABLES.get(what, (str(what),))
    if what is DataKind.NAVIGATION and wanted.dwell is not None:
        names = (f"{what}_dwell_{wanted.dwell}",)
    return [name + suffix for name in names for suffix in suffixes]


def _write(folder: RunFolder, what: DataKind, wanted: ExportSelection, destination: ExportFolder) -> None:
    if what is DataKind.COMPENSATION:
        _write_compensation(folder, wanted.suffixes(what), destination)
        return
    for name in _files(what, wanted):
        match what:
            case DataKind.TELEMETRY:
                export_telemetry(folder, started_utc(folder), name, destination)
            case DataKind.NAVIGATION:
                setup = measurement_setup(Station(folder.station))
                export_navigation(folder, setup, name, destination, wanted.dwell)
            case DataKind.CAN:
                _write_can(folder, name, destination)
            case _:
                export_csv((folder.path / name).with_suffix(".csv"), name, destination)


def _write_can(folder: RunFolder, name: str, destination: ExportFolder) -> None:
    log, dbc = TimedLog(folder), Station(folder.station).dbc_path
    about = {"source": folder.can.name, "dbc": dbc.name, "parts_with_estimated_time": log.estimated}
    with destination.file(name, **about) as path:
        if name.endswith(".blf"):
            write_blf(path, log)
        else:
            _write_mf4(path, log, dbc, destination.origin)


def _write_mf4(path: Path, log: TimedLog, dbc: Path, origin: Mapping[str, Any]) -> None:
    """Write MDF4; its library is optional, since python-can loads it with every use of CAN where it is."""
    try:
        from gyrobench.bench.exchange.mf4 import write_mf4
    except ImportError as error:
        raise RunFolderError(
            f"{path}: MDF4 needs asammdf, which is not installed. Install it: pip install 'gyrobench[mf4]'"
        ) from error
    write_mf4(path, log, dbc, origin)


def _write_compensation(folder: RunFolder, suffixes: list[str], destination: ExportFolder) -> None:
    try:
        closure = close_loop(read_campaign(folder.path), read_held_out_cycles(folder.closure))
    except MeasurementError as error:
        raise RunFolderError(f"{folder.path}: {error}") from error
    export_compensation(closure, suffixes, destination)
