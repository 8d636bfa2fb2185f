"""An earlier calibration, read for a verification."""

from __future__ import annotations

from pathlib import Path

from gyrobench.bench.bias.dwell_table import DwellRow, read_dwells
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.runs.folder import RunFolder


def read_calibration(path: Path) -> list[DwellRow]:
    """Read the dwells of a calibration.

    Parameters
    ----------
    path : Path
        A run folder, or a dwell table.

    Raises
    ------
    DocumentError
        There is no dwell table, it is wrong, or none of its dwells gave a bias.
    """
    table = RunFolder(path).dwells if path.is_dir() else path
    if not table.is_file():
        what = f"holds no {table.name}, so it is no calibration" if path.is_dir() else "does not exist"
        raise DocumentError(f"{path}: {what}. Give a run folder or the dwell table of a calibration")
    rows = read_dwells(table)
    if all(row.flags for row in rows):
        raise DocumentError(f"{table}: has no dwell that gave a bias. Give another calibration")
    return rows
