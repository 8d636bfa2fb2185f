"""Export of selected data of a run: tables, telemetry, navigation, CAN frames, compensation.

The compensation is the bias model of a closed run for the manufacturer of the INS: a table over temperature,
and all terms.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv

from gyrobench.bench.closure.files import holds_search, read_held_out_cycles
from gyrobench.bench.closure.inputs import read_campaign
from gyrobench.bench.closure.loadable_model import declared_model, model_with_effects
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.closure.outcome import Closure
from gyrobench.bench.dwells.measurement_setup import measurement_setup
from gyrobench.bench.exchange.can_export import (
    UTC_FIELD,
    TimedLog,
    calendar_times,
    export_navigation,
    write_blf,
)
from gyrobench.bench.exchange.export_folder import ExportFolder, data_origin, field_of, type_of, unit_of
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.csv_tables import read_text
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError, RunFolderError
from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.foundations.packages import require
from gyrobench.bench.foundations.text import listed
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.runs.compensation_file import compensations_in_use, write_compensation
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.provenance import started_utc
from gyrobench.bench.runs.telemetry import TELEMETRY_COLUMNS, read_telemetry
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.compensation import PARAMETER_NAMES, TERMS, Compensation


class DataKind(StrEnum):
    """Kinds of data."""

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
#: Navigation of a whole run is large and rarely needed.
_DEFAULT_KINDS = tuple(kind for kind in DataKind if kind is not DataKind.NAVIGATION)
_DEFAULT_FORMATS = (Format.PARQUET, Format.BLF)


@dataclass(frozen=True)
class ExportSelection:
    """Selected data of a run.

    Raises DocumentError if a named kind has none of the formats, or a dwell is given without navigation.
    """

    what: Sequence[DataKind] = ()  #: Empty for all but navigation.
    formats: Sequence[Format] = ()  #: Empty for Parquet and BLF. Kinds without any of them are left out.
    dwell: int | None = None  #: Number of the only dwell whose navigation is exported; None for all.

    def __post_init__(self) -> None:
        unfit = [str(kind) for kind in self.what if not self.suffixes(kind)]
        if unfit:
            raise DocumentError(
                f"--format {','.join(self.formats)} does not fit {listed(unfit)}: CAN frames are written "
                "as blf or mf4, other data as parquet or csv"
            )
        if self.dwell is not None and DataKind.NAVIGATION not in self.what:
            raise DocumentError("--dwell selects a dwell of the navigation data; add --what navigation")

    def suffixes(self, kind: DataKind) -> list[str]:
        """Suffixes of the files of this kind."""
        supported = _CAN_FORMATS if kind is DataKind.CAN else _TABLE_FORMATS
        return [f".{each}" for each in self.formats or _DEFAULT_FORMATS if each in supported]

    def kinds(self) -> list[DataKind]:
        """Kinds that are written."""
        return [kind for kind in self.what or _DEFAULT_KINDS if self.suffixes(kind)]


def _export_csv(path: Path, name: str, destination: ExportFolder) -> None:
    """Write a CSV table of the run as Parquet, or copy it.

    Raises DocumentError if the table can't be read. Raises RunFolderError if the file can't be written.
    """
    about = {"source": path.name, "source_sha256": file_sha256(path)}
    table = _read_table(path)
    if name.endswith(".parquet"):
        destination.table(name, table.schema, iter([table]), **about)
        return
    units = {column: unit_of(column) for column in table.column_names if unit_of(column)}
    with destination.file(name, units=units, **about) as copy:
        copy.write_text(read_text(path), encoding="utf-8", newline="")


def _read_table(path: Path) -> pa.Table:
    """Read a CSV table; an empty cell is null, except in text columns.

    Raises DocumentError if it is not a table, or a cell does not match its column's type.
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


_SCHEMA = pa.schema([UTC_FIELD, *(field_of(name) for name in TELEMETRY_COLUMNS)])


def _export_telemetry(folder: RunFolder, start: datetime, name: str, destination: ExportFolder) -> None:
    """Write all readings; a row without values marks a gap.

    Raises RunFolderError if telemetry can't be read, or the file can't be written.
    """
    readings = read_telemetry(folder.telemetry)
    columns = {
        column: pa.array(values, pa.float64(), from_pandas=True).cast(type_of(column))
        for column, values in readings.items()
    }
    table = pa.table({UTC_FIELD.name: calendar_times(start, readings["time_s"]), **columns})
    destination.table(name, _SCHEMA, iter([table]), source=folder.telemetry.name)


_TABLE_FILE, _TERMS_FILE, _COMPENSATION_FILE = "compensation_table", "compensation_terms", "compensation.yaml"
#: Names of the tables of a kind, if they are not that of the kind.
_TABLE_NAMES = {
    DataKind.BINS: ("bias_bins",),
    DataKind.JOINT: ("joint", "joint_biases"),
    DataKind.COMPENSATION: (_TABLE_FILE, _TERMS_FILE),
}
_TABLE_MISSING = "{} is missing, as in an interrupted run; create it with `gyrobench bins {}`"


@dataclass(frozen=True)
class Exported:
    """Files written, and data missing in the run."""

    files: list[Path]  #: In order.
    missing: dict[DataKind, str]  #: Selected data that the run lacks, with the reason.


def export_run(folder: RunFolder, selection: ExportSelection, out: Path, force: bool = False) -> Exported:
    """Write the selected data to the folder ``out``; an interrupted run may lack some of it.

    With ``force`` existing files are replaced. Raises MissingPackageError if a format needs a package that is
    not installed. Raises DocumentError if a table, station or DBC file is wrong.
    Raises RunFolderError if files exist, can't be read or written, or the run holds none of the selected
    data.
    """
    missing = {kind: reason for kind in selection.kinds() if (reason := _missing_reason(folder, kind))}
    kinds = [kind for kind in selection.kinds() if kind not in missing]
    if not kinds:
        raise RunFolderError(
            f"{folder.path}: " + "; ".join(f"{kind}: {reason}" for kind, reason in missing.items())
        )
    if DataKind.CAN in kinds and Format.MF4 in selection.formats:
        require("asammdf")  # before the first file is written
    destination = ExportFolder(out, data_origin(folder), force)
    destination.refuse_existing([name for kind in kinds for name in _files(kind, selection)])
    for kind in kinds:
        _write(folder, kind, selection, destination)
    destination.finish()
    return Exported(destination.written, missing)


def _missing_reason(folder: RunFolder, kind: DataKind) -> str:
    """Reason why the run lacks a kind of data; empty if it has it."""
    match kind:
        case DataKind.VERIFICATION:
            return "" if folder.calibration_check.exists() else "the run made no calibration check"
        case DataKind.TELEMETRY:
            return "" if any(folder.telemetry.glob("part-*")) else "there are no readings"
        case DataKind.NAVIGATION | DataKind.CAN:
            return "" if any(folder.can.glob("part-*")) else "there are no CAN frames"
        case DataKind.COMPENSATION:
            if in_use := compensations_in_use(folder):
                return (
                    f"the INS applied a compensation already ({', '.join(in_use)}), so the model describes "
                    "only the remaining biases; measure the campaign without it"
                )
            is_closed = holds_search(folder.closure)
            return "" if is_closed else f"no search for effects yet; run `gyrobench close {folder.argument}`"
    names = [f"{table}.csv" for table in _TABLE_NAMES.get(kind, (str(kind),))]
    missing = [name for name in names if not (folder.path / name).exists()]
    return _TABLE_MISSING.format(missing[0], folder.argument) if missing else ""


def _files(kind: DataKind, selection: ExportSelection) -> list[str]:
    names = _TABLE_NAMES.get(kind, (str(kind),))
    if kind is DataKind.NAVIGATION and selection.dwell is not None:
        names = (f"{kind}_dwell_{selection.dwell}",)
    files = [name + suffix for name in names for suffix in selection.suffixes(kind)]
    return [*files, _COMPENSATION_FILE] if kind is DataKind.COMPENSATION else files


def _write(folder: RunFolder, kind: DataKind, selection: ExportSelection, destination: ExportFolder) -> None:
    if kind is DataKind.COMPENSATION:
        try:
            closure = close_loop(read_campaign(folder.path), read_held_out_cycles(folder.closure))
        except MeasurementError as error:
            raise RunFolderError(f"{folder.path}: {error}") from error
        export_compensation(closure, selection.suffixes(kind), destination)
        return
    for name in _files(kind, selection):
        match kind:
            case DataKind.TELEMETRY:
                _export_telemetry(folder, started_utc(folder), name, destination)
            case DataKind.NAVIGATION:
                setup = measurement_setup(Station(folder.station))
                export_navigation(folder, setup, name, destination, selection.dwell)
            case DataKind.CAN:
                _write_can(folder, name, destination)
            case _:
                _export_csv((folder.path / name).with_suffix(".csv"), name, destination)


def _write_can(folder: RunFolder, name: str, destination: ExportFolder) -> None:
    log, dbc = TimedLog(folder), Station(folder.station).dbc_path
    about = {"source": folder.can.name, "dbc": dbc.name, "parts_with_estimated_time": log.estimated}
    with destination.file(name, **about) as path:
        if name.endswith(".blf"):
            write_blf(path, log)
        else:
            # Optional, since python-can loads this package at every use of CAN.
            from gyrobench.bench.exchange.mf4 import write_mf4

            write_mf4(path, log, dbc, destination.origin)


#: Temperature step of the table, and decimals of its biases, far below the stability of any gyro.
_STEP_C, _DECIMALS = 1.0, 8
_MEANINGS = {
    "polynomial_dph": "times T^degree, T in degC held between low_c and high_c",
    "rate_dph_per_c_per_h": "times dT/dt, held within rate_limit_c_per_h",
    "gradient_dph_per_k": "times B - T, held between difference_low_k and difference_high_k",
    "saturating_dph_per_k": "times Up along this axis, (B - T) and 1 / (1 + exp(-c))",
    "growing_dph_per_k": "times Up along this axis, (B - T) and ln(1 + exp(c))",
    "onset_c": "c = (onset_c - T) / onset_width_c",
    "gravity_dph_per_g": "times Up along this axis",
    "warm_up_dph": "times exp(-t / warm_up_s), t since power-on",
    "hysteresis_dph_per_k": "times the play of T of half_width_k, less T",
}


def export_compensation(closure: Closure, suffixes: Sequence[str], destination: ExportFolder) -> None:
    """Write table, terms and the file that `gyrobench run --compensation` takes.

    ``suffixes``: those of the tables, ".csv" or ".parquet" or both. Raises RunFolderError if a file can't
    be written.
    """
    declared, model = declared_model(closure), model_with_effects(closure)
    about: dict[str, Any] = {
        "verdict": closure.verdict,
        "effects": list(model.effects),
        "notes": list(model.notes),
        "noise_dph": closure.noise_dph,
        "error_held_out_dph": closure.error_after_dph,
        "meaning": "to be subtracted from each gyro; T temperature of its optics, B of its electronics",
    }
    numbers = model.compensation
    table = _table(declared.compensation, numbers)
    terms = pa.Table.from_pylist(list(_terms(numbers)), _TERMS_SCHEMA)
    for suffix in suffixes:
        destination.table(_TABLE_FILE + suffix, table.schema, iter([table]), **about)
        destination.table(_TERMS_FILE + suffix, _TERMS_SCHEMA, iter([terms]), **about)
    with destination.file(_COMPENSATION_FILE, **about) as path:
        write_compensation(path, numbers, closure.campaign.reported_unit)


def _table(declared: Compensation, model: Compensation) -> pa.Table:
    """Part of the bias that depends only on temperature, for both models; null outside the fitted range."""
    low_c = math.ceil(float(declared.low_c.min()) / _STEP_C) * _STEP_C
    high_c = float(declared.high_c.max())
    temperature_c = np.arange(low_c, high_c + 1e-9, _STEP_C)
    columns = {"temperature_c": temperature_c}
    for name, compensation in (("bias_{}_dph", model), ("declared_bias_{}_dph", declared)):
        for index, axis in enumerate(AXES):
            columns[name.format(axis)] = _polynomial(compensation, index, temperature_c)
    return pa.table(
        {name: pa.array(values, pa.float64(), from_pandas=True) for name, values in columns.items()},
        pa.schema([field_of(name) for name in columns]),
    )


def _polynomial(compensation: Compensation, gyro: int, temperature_c: FloatArray) -> FloatArray:
    bias_dph = np.polynomial.polynomial.polyval(temperature_c, compensation.polynomial_dph[gyro])
    is_inside = (temperature_c >= compensation.low_c[gyro]) & (temperature_c <= compensation.high_c[gyro])
    return np.where(is_inside, np.round(bias_dph, _DECIMALS), np.nan)


_TERMS_SCHEMA = pa.schema(
    [
        *((name, pa.string()) for name in ("gyro", "number", "index")),
        *((name, pa.float64()) for name in ("value", "sigma")),
        *((name, pa.string()) for name in ("unit", "term", "meaning")),
    ]
)


def _terms(compensation: Compensation) -> Iterator[dict[str, Any]]:
    """One row for each number, without numbers that are zero for all gyros."""
    term_by_name = {name: term for term, name in TERMS.items()}
    for name in PARAMETER_NAMES:
        values = getattr(compensation, name)
        if not values.any() and name not in ("low_c", "high_c"):
            continue
        sigmas = compensation.sigma.get(name, np.full_like(values, np.nan))
        for axis, row, row_sigmas in zip(AXES, values, sigmas, strict=True):
            for index, (value, sigma) in enumerate(
                zip(np.atleast_1d(row), np.atleast_1d(row_sigmas), strict=True)
            ):
                is_polynomial = name == "polynomial_dph"
                index_label = f"degree {index}" if is_polynomial else AXES[index] if row.ndim else ""
                unit_suffix = f" per degC^{index}" if is_polynomial and index else ""
                yield {
                    "gyro": axis,
                    "number": name,
                    "index": index_label,
                    "value": float(f"{value:.9g}"),
                    "sigma": None if math.isnan(sigma) else float(f"{sigma:.3g}"),
                    "unit": unit_of(name) + unit_suffix,
                    "term": "declared" if is_polynomial else term_by_name.get(name, ""),
                    "meaning": _MEANINGS.get(name, ""),
                }
