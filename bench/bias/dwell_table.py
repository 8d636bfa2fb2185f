"""Reads and writes the dwell table ``dwells.csv``, which has one row per dwell."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import Any, overload

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray, Triple
from gyrobench.bench.foundations.csv_tables import CsvTable, format_csv, read_text, write_text
from gyrobench.bench.foundations.text import flag_text, format_number
from gyrobench.bench.navigation.positions import AXES, POSITIONS

#: Fields of one number each, in the order of the columns.
SCALARS = ("azimuth_deg", "start_s", "end_s", "since_power_on_s", "chamber_set_c", "chamber_c", "case_c")
_TRIPLES = {
    "gyro_c": "gyro_{}_c",
    "gyro_rate_c_per_h": "gyro_{}_rate_c_per_h",
    "board_c": "board_{}_c",
    "bias_dph": "bias_{}_dph",
    "sigma_dph": "sigma_{}_dph",
    "common_sigma_dph": "common_sigma_{}_dph",
    "paper_bias_dph": "paper_bias_{}_dph",
    "paper_sigma_dph": "paper_sigma_{}_dph",
    "accelerometer_ug": "accelerometer_{}_ug",
    "accelerometer_sigma_ug": "accelerometer_sigma_{}_ug",
    "accelerometer_common_sigma_ug": "accelerometer_common_sigma_{}_ug",
}
_FIT = ("fit_ratio", "fit_p_value")
#: Readers of values with further checks; all others are read as plain numbers.
_READERS = {
    "gyro_c": CsvTable.temperature,
    **dict.fromkeys(("sigma_dph", "paper_sigma_dph", "accelerometer_sigma_ug"), CsvTable.uncertainty),
    **dict.fromkeys(("common_sigma_dph", "accelerometer_common_sigma_ug"), CsvTable.part_of_uncertainty),
}


def columns_of(names: Iterable[str]) -> tuple[str, ...]:
    """Columns of fields; a field of three values has three columns."""
    return tuple(
        column
        for name in names
        for column in ((_TRIPLES[name].format(axis) for axis in AXES) if name in _TRIPLES else (name,))
    )


#: Fields other than measured numbers, and the number of measured numbers in a row.
_LABEL_FIELDS = ("unit", "run", "dwell", "cycle", "position", "other", "flags")
_NUMBER_COUNT = len(SCALARS) + 3 * len(_TRIPLES) + len(_FIT)
_FIELD_NAMES = ("unit", "run", "dwell", "cycle", "position", *SCALARS, *_TRIPLES, *_FIT)

#: Columns of a table as it is written.
COLUMNS = (*columns_of(_FIELD_NAMES), "flags")
#: Other column: number of other units in the chamber that were on, mean over the dwell.
NEIGHBOURS_ON = "neighbours_on"
#: Values of three gyros without a measurement.
NOT_MEASURED: Triple = (math.nan, math.nan, math.nan)
#: Largest share of a standard uncertainty that counts as common to the dwells of an attitude.
_MAX_COMMON = 0.99
#: Unit of an INS that does not report its serial number.
UNKNOWN_UNIT = "unknown"


@dataclass(frozen=True, slots=True)
class DwellRow:
    """One position at one temperature; fields of three values are those of the x, y and z gyro."""

    #: unit, run: Serial number of the INS, and one value per power-on.
    unit: str
    run: str
    dwell: int  #: Number of the dwell, unique in the table, in time order.
    cycle: int  #: Number of the pass of the temperature profile.
    position: str  #: Key of :data:`gyrobench.bench.navigation.positions.POSITIONS`.
    #: start_s, end_s: Time on one clock for the whole table.
    start_s: float
    end_s: float
    since_power_on_s: float  #: At the start of the dwell.
    #: gyro_c, gyro_rate_c_per_h: Mean temperature of each gyro's optics, and its slope.
    gyro_c: Triple
    gyro_rate_c_per_h: Triple
    #: bias_dph, sigma_dph: Measured bias in body axes, and its standard uncertainty; by the state-space
    #: estimator if the bench measured it.
    bias_dph: Triple
    sigma_dph: Triple
    azimuth_deg: float = math.nan  #: Azimuth at the start of the dwell; NaN if not known.
    #: chamber_set_c, chamber_c, case_c: Mean temperatures; NaN if not measured.
    chamber_set_c: float = math.nan
    chamber_c: float = math.nan
    case_c: float = math.nan
    #: Mean temperature of each gyro's electronics; NaN if there is no sensor.
    board_c: Triple = NOT_MEASURED
    #: Part of the standard uncertainties that is the same error in all dwells of one attitude, at any
    #: temperature; NaN if it is not known.
    common_sigma_dph: Triple = NOT_MEASURED
    #: paper_bias_dph, paper_sigma_dph: The same by the paper's method; NaN if that does not apply.
    paper_bias_dph: Triple = NOT_MEASURED
    paper_sigma_dph: Triple = NOT_MEASURED
    #: accelerometer_ug, accelerometer_sigma_ug: Biases of the accelerometers and their standard
    #: uncertainties, ug; NaN if not known. The vertical one is not measured and keeps its prior uncertainty.
    accelerometer_ug: Triple = NOT_MEASURED
    accelerometer_sigma_ug: Triple = NOT_MEASURED
    #: Part of these that is the same error in all dwells of one attitude; NaN if it is not known.
    accelerometer_common_sigma_ug: Triple = NOT_MEASURED
    #: fit_ratio, fit_p_value: See :class:`gyrobench.bench.bias.statistics.Chi2Test`; NaN if not known.
    fit_ratio: float = math.nan
    fit_p_value: float = math.nan
    #: Numbers of other columns by name, such as ``supply_w``: inputs that an effect may follow.
    other: tuple[tuple[str, float], ...] = ()
    #: Faults of the dwell; empty if there are none. A dwell with flags may have no result: NaN for its
    #: biases, their uncertainties and the gyros' temperatures.
    flags: tuple[str, ...] = ()


def noise_and_common(
    rows: Sequence[DwellRow], sigma: str = "sigma_dph", common_sigma: str = "common_sigma_dph"
) -> tuple[FloatArray, FloatArray]:
    """Parts (n, 3) of the uncertainties: independent from dwell to dwell, and common to those of an attitude.

    Together they are the stated uncertainties. Part of these is always independent, so that no dwell counts
    as if it had no noise. ``sigma``, ``common_sigma``: fields of the uncertainties and of their common part.
    """
    sigmas, common = (
        np.array([getattr(row, name) for row in rows], dtype=np.float64).reshape(-1, 3)
        for name in (sigma, common_sigma)
    )
    common = np.fmin(np.nan_to_num(common), _MAX_COMMON * sigmas)
    return np.sqrt(sigmas**2 - common**2), common


#: Fields whose columns may be missing or have empty cells.
_OPTIONAL = {field.name for field in fields(DwellRow) if field.default is not MISSING}
_REQUIRED = columns_of(name for name in _FIELD_NAMES if name not in _OPTIONAL)


class PackedDwells(Sequence[DwellRow]):
    """Rows packed into a third of the memory, for tables that are kept for long.

    Each row is created on access, so two copies of a row compare equal only if they contain no NaN.
    """

    def __init__(self, rows: Iterable[DwellRow]) -> None:
        self._labels: list[tuple[Any, ...]] = []
        self._measured_values = array("d")
        for row in rows:
            self._labels.append(tuple(getattr(row, name) for name in _LABEL_FIELDS))
            self._measured_values.extend(_measured_values(row))

    def __len__(self) -> int:
        return len(self._labels)

    @overload
    def __getitem__(self, index: int) -> DwellRow: ...
    @overload
    def __getitem__(self, index: slice) -> list[DwellRow]: ...
    def __getitem__(self, index: int | slice) -> DwellRow | list[DwellRow]:
        if isinstance(index, slice):
            return [self[row_index] for row_index in range(*index.indices(len(self)))]
        row_index = range(len(self))[index]
        numbers = iter(self._measured_values[row_index * _NUMBER_COUNT : (row_index + 1) * _NUMBER_COUNT])
        values: dict[str, Any] = dict(zip(_LABEL_FIELDS, self._labels[row_index], strict=True))
        values |= {name: next(numbers) for name in SCALARS}
        values |= {name: (next(numbers), next(numbers), next(numbers)) for name in _TRIPLES}
        values |= zip(_FIT, numbers, strict=True)
        return DwellRow(**values)


def paper_rows(rows: Iterable[DwellRow]) -> list[DwellRow]:
    """Rows with the paper's biases instead of the state-space ones; rows without any are left out."""
    return [
        replace(
            row, bias_dph=row.paper_bias_dph, sigma_dph=row.paper_sigma_dph, common_sigma_dph=NOT_MEASURED
        )
        for row in rows
        if not all(map(math.isnan, row.paper_bias_dph))
    ]


def format_dwells(rows: Iterable[DwellRow]) -> str:
    """CSV text with a header; equal rows give equal text."""
    rows = list(rows)
    other = tuple(dict.fromkeys(name for row in rows for name, _ in row.other))
    cells = (
        [*_cells(row), *(format_number(dict(row.other).get(name, math.nan)) for name in other)]
        for row in rows
    )
    return format_csv((*COLUMNS, *other), cells)


def write_dwells(path: Path, rows: Iterable[DwellRow]) -> None:
    """Write a dwell table. Raises RunFolderError if the file can't be written."""
    write_text(path, format_dwells(rows))


def parse_dwells(text: str, name: str) -> list[DwellRow]:
    """Read a dwell table from CSV text.

    Columns may be in any order; the numbers in unknown columns are kept. The columns of ``flags``, the
    paper's method, accelerometers, goodness of fit and the temperatures that may be empty may also be
    missing. Values of the gyros may be empty in a row with flags, which give the reason.

    ``name``: name of the file in messages. Raises DocumentError, which lists all problems of the table, each
    with file, line and column.
    """
    return list(_rows(text, name))


def read_dwells(path: Path) -> list[DwellRow]:
    """Read a dwell table; see :func:`parse_dwells`.

    Raises DocumentError if the file can't be read or is not a dwell table.
    """
    return parse_dwells(read_text(path), str(path))


def read_packed_dwells(path: Path) -> PackedDwells:
    """Read a dwell table as :class:`PackedDwells`; see :func:`parse_dwells`."""
    return PackedDwells(_rows(read_text(path), str(path)))


def _rows(text: str, name: str) -> Iterator[DwellRow]:
    """Yield the rows, then raise DocumentError if the table has problems."""
    table = CsvTable(text, name, required=_REQUIRED)
    other = [name for name in table.header if name not in COLUMNS and table.is_numeric(name)]
    seen: dict[int, int] = {}
    for index in range(len(table)):
        row = _row(table, index, other)
        first = seen.setdefault(row.dwell, index)
        if first != index:
            table.problem(index, "dwell", f"dwell {row.dwell} is also in line {table.lines[first]}")
        yield row
    table.raise_problems()


def _measured_values(row: DwellRow) -> Iterator[float]:
    """Measured numbers of a row, in the order of the columns."""
    yield from (getattr(row, name) for name in SCALARS)
    for name in _TRIPLES:
        yield from getattr(row, name)
    yield from (getattr(row, name) for name in _FIT)


def _cells(row: DwellRow) -> list[str]:
    names = [row.unit, row.run, str(row.dwell), str(row.cycle), row.position]
    return [*names, *map(format_number, _measured_values(row)), flag_text(row.flags)]


def _row(table: CsvTable, index: int, other: Sequence[str]) -> DwellRow:
    failed = bool(table.text(index, "flags"))

    def read_triple(name: str) -> Triple:
        read = _READERS.get(name, CsvTable.number)
        x, y, z = (read(table, index, each, failed or name in _OPTIONAL) for each in columns_of((name,)))
        return x, y, z

    values: dict[str, Any] = {
        name: table.number(index, name, may_be_empty=name in _OPTIONAL) for name in (*SCALARS, *_FIT)
    }
    values |= {name: read_triple(name) for name in _TRIPLES}
    row = DwellRow(
        unit=table.name(index, "unit"),
        run=table.name(index, "run"),
        dwell=table.integer(index, "dwell"),
        cycle=table.integer(index, "cycle"),
        position=table.choice(index, "position", POSITIONS),
        other=tuple((name, table.number(index, name, may_be_empty=True)) for name in other),
        flags=table.flags(index, "flags"),
        **values,
    )
    if row.end_s < row.start_s:
        table.problem(
            index, "end_s", f"the dwell ends at {row.end_s:g} s, before it starts at {row.start_s:g} s"
        )
    return row
