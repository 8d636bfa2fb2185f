"""The dwell table ``dwells.csv``: one row per dwell, read from and written to CSV."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from bench.bias.csv_text import CsvTable, format_csv, format_number, read_text, write_text
from bench.navigation.positions import AXES, POSITIONS

#: Values of the x, y and z gyro.
Triple = tuple[float, float, float]

_SCALARS = ("start_s", "end_s", "since_power_on_s", "chamber_set_c", "chamber_c", "case_c")
_TRIPLES = {
    "gyro_c": "gyro_{}_c",
    "gyro_rate_c_per_h": "gyro_{}_rate_c_per_h",
    "board_c": "board_{}_c",
    "bias_dph": "bias_{}_dph",
    "sigma_dph": "sigma_{}_dph",
}
_MAY_BE_EMPTY = {"chamber_set_c", "chamber_c", "case_c", "board_c", "residual_ratio"}

#: Columns that a table is written with.
COLUMNS = (
    *("unit", "run", "dwell", "cycle", "position"),
    *_SCALARS,
    *(pattern.format(axis) for pattern in _TRIPLES.values() for axis in AXES),
    *("residual_ratio", "flags"),
)


@dataclass(frozen=True)
class DwellRow:
    """One position at one temperature; fields of three values are those of the x, y and z gyro.

    Attributes
    ----------
    unit, run : str
        Serial number of the INS, and one value per power-on.
    dwell : int
        Number unique in the table, in time order.
    cycle : int
        Which pass of the temperature profile.
    position : str
        Key of :data:`bench.navigation.positions.POSITIONS`.
    start_s, end_s : float
        Time on one clock for the whole table.
    since_power_on_s : float
        At the start of the dwell.
    gyro_c, gyro_rate_c_per_h : tuple of float
        Mean temperature of each gyro's optics, and its slope.
    bias_dph, sigma_dph : tuple of float
        Measured bias in body axes, and its standard uncertainty.
    chamber_set_c, chamber_c, case_c : float
        Mean temperatures; NaN where not measured.
    board_c : tuple of float
        Mean temperature of each gyro's electronics; NaN where there is no sensor.
    residual_ratio : float
        See :class:`bench.bias.dwell.BiasEstimate`; NaN where not known.
    flags : str
        What was wrong with the dwell; empty where nothing was. A dwell with flags may be without
        result: NaN for its biases, their uncertainties and the gyros' temperatures.
    """

    unit: str
    run: str
    dwell: int
    cycle: int
    position: str
    start_s: float
    end_s: float
    since_power_on_s: float
    gyro_c: Triple
    gyro_rate_c_per_h: Triple
    bias_dph: Triple
    sigma_dph: Triple
    chamber_set_c: float = float("nan")
    chamber_c: float = float("nan")
    case_c: float = float("nan")
    board_c: Triple = (float("nan"), float("nan"), float("nan"))
    residual_ratio: float = float("nan")
    flags: str = ""


def format_dwells(rows: Iterable[DwellRow]) -> str:
    """CSV text with a header; equal rows give equal text."""
    return format_csv(COLUMNS, (_cells(row) for row in rows))


def write_dwells(path: Path, rows: Iterable[DwellRow]) -> None:
    """Write a dwell table.

    Raises
    ------
    RunFolderError
        The file can't be written.
    """
    write_text(path, format_dwells(rows))


def parse_dwells(text: str, name: str) -> list[DwellRow]:
    """Read CSV text.

    Columns may come in any order and others may be among them; ``residual_ratio``, ``flags``
    and the temperatures that may be empty may also be missing. Values of the gyros may be empty
    in a row with flags, which say why.

    Parameters
    ----------
    text : str
        Content of the file.
    name : str
        What to call the file in messages.

    Raises
    ------
    DocumentError
        Lists everything that is wrong with the table, each with file, line and column.
    """
    table = CsvTable(text, name, required=[column for column in COLUMNS if _is_required(column)])
    rows = [_row(table, index) for index in range(len(table))]
    seen: dict[int, int] = {}
    for index, row in enumerate(rows):
        first = seen.setdefault(row.dwell, index)
        if first != index:
            table.problem(index, "dwell", f"dwell {row.dwell} is also in line {table.lines[first]}")
    table.raise_problems()
    return rows


def read_dwells(path: Path) -> list[DwellRow]:
    """Read a dwell table; see :func:`parse_dwells`.

    Raises
    ------
    DocumentError
        The file can't be read or is no dwell table.
    """
    return parse_dwells(read_text(path), str(path))


def _is_required(column: str) -> bool:
    return column != "flags" and column not in _MAY_BE_EMPTY and not column.startswith("board_")


def _cells(row: DwellRow) -> list[str]:
    triples = [value for name in _TRIPLES for value in getattr(row, name)]
    numbers = [*(getattr(row, name) for name in _SCALARS), *triples, row.residual_ratio]
    names = [row.unit, row.run, str(row.dwell), str(row.cycle), row.position]
    return [*names, *map(format_number, numbers), row.flags]


def _row(table: CsvTable, index: int) -> DwellRow:
    failed = bool(table.text(index, "flags"))

    def triple(name: str) -> Triple:
        x, y, z = (
            table.number(index, _TRIPLES[name].format(axis), may_be_empty=failed or name in _MAY_BE_EMPTY)
            for axis in AXES
        )
        return x, y, z

    def scalar(name: str) -> float:
        return table.number(index, name, may_be_empty=name in _MAY_BE_EMPTY)

    row = DwellRow(
        unit=table.text(index, "unit"),
        run=table.text(index, "run"),
        dwell=table.integer(index, "dwell"),
        cycle=table.integer(index, "cycle"),
        position=table.choice(index, "position", POSITIONS),
        start_s=scalar("start_s"),
        end_s=scalar("end_s"),
        since_power_on_s=scalar("since_power_on_s"),
        chamber_set_c=scalar("chamber_set_c"),
        chamber_c=scalar("chamber_c"),
        case_c=scalar("case_c"),
        gyro_c=triple("gyro_c"),
        gyro_rate_c_per_h=triple("gyro_rate_c_per_h"),
        board_c=triple("board_c"),
        bias_dph=triple("bias_dph"),
        sigma_dph=triple("sigma_dph"),
        residual_ratio=scalar("residual_ratio"),
        flags=table.text(index, "flags"),
    )
    _check(table, index, row)
    return row


def _check(table: CsvTable, index: int, row: DwellRow) -> None:
    if row.end_s < row.start_s:
        table.problem(
            index, "end_s", f"the dwell ends at {row.end_s:g} s, before it starts at {row.start_s:g} s"
        )
    for axis, sigma in zip(AXES, row.sigma_dph, strict=True):
        if sigma <= 0.0:
            table.problem(index, f"sigma_{axis}_dph", f"an uncertainty must be above zero; found {sigma:g}")
