"""The table of units, ``units.csv``: of which batch each is. No instrument tells that, so people keep it."""

from __future__ import annotations

from dataclasses import dataclass

from gyrobench.bench.foundations.csv_tables import CsvTable


@dataclass(frozen=True)
class Unit:
    """One INS.

    Attributes
    ----------
    unit : str
        Serial number, as in the runs.
    batch : str
        Batch of its gyros.
    hardware, note : str
        Whatever else is to be known; may be empty.
    """

    unit: str
    batch: str
    hardware: str
    note: str


def parse_units(text: str, name: str) -> list[Unit]:
    """Read CSV text with the columns unit and batch, and maybe hardware and note.

    Parameters
    ----------
    text : str
        Content of the file.
    name : str
        What to call the file in messages.

    Raises
    ------
    DocumentError
        Lists all that is wrong with it, with lines.
    """
    table = CsvTable(text, name, required=("unit", "batch"))
    seen: dict[str, int] = {}
    units = []
    for index in range(len(table)):
        unit = table.name(index, "unit")
        first = seen.setdefault(unit, index)
        if first != index:
            table.problem(index, "unit", f"unit {unit} is also in line {table.lines[first]}")
        units.append(
            Unit(unit, table.name(index, "batch"), table.text(index, "hardware"), table.text(index, "note"))
        )
    table.raise_problems()
    return units
