"""Tables: dwells, and what a verification gave."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

from gyrobench.bench.bias.bins import bin_biases
from gyrobench.bench.bias.dwell_table import DwellRow, format_dwells, read_dwells
from gyrobench.bench.closure.inputs import read_campaign
from gyrobench.bench.dwells.earlier_calibration import read_calibration
from gyrobench.bench.navigation.positions import AXES
from tests.fuzz.checks import WrongResultError, cells_of, check_cell, check_finite, written


def use_dwell_table(folder: Path, data: bytes) -> None:
    path = written(folder, "fuzzed.csv", data)
    rows = read_dwells(path)
    _check_table(rows, data)
    campaign = read_campaign(path)
    check_finite(campaign.bias_dph, "a bias of the campaign")
    bin_biases([row for row in rows if not row.flags], 5.0)
    read_calibration(path)


def _check_table(rows: list[DwellRow], data: bytes) -> None:
    """Compare a table with what the csv module reads, and with itself written and read."""
    expected = cells_of(data)
    if len(rows) != len(expected):
        raise WrongResultError(f"{len(rows)} rows instead of {len(expected)}")
    for row, cells in zip(rows, expected, strict=True):
        pairs: list[tuple[Any, str]] = [
            (getattr(row, name), cells[name]) for name in ("unit", "run", "position")
        ]
        pairs += [
            (getattr(row, name), cells.get(name, ""))
            for name in ("dwell", "cycle", "start_s", "end_s", "case_c")
        ]
        for axis, bias, sigma, gyro_c in zip(AXES, row.bias_dph, row.sigma_dph, row.gyro_c, strict=True):
            pairs += [
                (bias, cells[f"bias_{axis}_dph"]),
                (sigma, cells[f"sigma_{axis}_dph"]),
                (gyro_c, cells[f"gyro_{axis}_c"]),
            ]
        for value, cell in pairs:
            check_cell(value, cell)
    again = list(csv.reader(io.StringIO(format_dwells(rows), newline="")))
    if len(again) != len(rows) + 1:
        raise WrongResultError("the table is another after writing and reading")


def dwell_table() -> bytes:
    from tests.bench.report.made_up_closure import made_up_rows

    return format_dwells(made_up_rows()[:24]).encode()
