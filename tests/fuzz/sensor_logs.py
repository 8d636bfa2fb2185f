"""Logs of other units, and the mappings that say how to read them."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, read_dwells
from gyrobench.bench.exchange.log_import import import_logs, write_import
from gyrobench.bench.foundations.documents import read_document
from tests.fuzz.checks import WrongResultError, check_document, written

MAP = """\
unit: A7
text: {separator: comma, comment: "#"}
time: {column: time, unit: s}
gyro: {unit: deg/s, x: gx, y: gy, z: {column: gz, sign: -1}, full_scale: 100}
temperatures: {gyros: temp, min_swing_c: 5, scale: 1.0, offset_c: 0.0}
position: z_up
cycle: {turning_point_c: 5}
earth_rate: {latitude_deg: 40, azimuth_deg: 0}
window_s: 60
skip_s: 0
"""


#: A larger rate is none, as docs/import.md says.
_LARGEST_DPH = 1e15


def log() -> str:
    random = np.random.default_rng(2)
    time_s = np.arange(1200.0)
    temperature_c = 40.0 - 30.0 * np.abs(time_s / 600.0 - 1.0)
    rates = random.standard_normal((1200, 3)) * 0.005 + 0.01
    rows = np.column_stack([time_s, rates, temperature_c + 0.01 * random.standard_normal(1200)])
    return "time,gx,gy,gz,temp\n" + "".join(",".join(f"{value:.9g}" for value in row) + "\n" for row in rows)


def use_map(folder: Path, data: bytes) -> None:
    path = written(folder, "fuzzed.yaml", data)
    samples = written(folder, "log.csv", log().encode())
    imported = import_logs([samples], str(path))
    check_document(read_document(path))
    write_import(folder / "dwells.csv", imported)
    read_dwells(folder / "dwells.csv")


def use_log(folder: Path, data: bytes) -> None:
    path = written(folder, "fuzzed.csv", data)
    imported = import_logs(
        [path],
        str(
            written(
                folder,
                "map.yaml",
                MAP.replace("earth_rate: {latitude_deg: 40, azimuth_deg: 0}\n", "").encode(),
            )
        ),
    )
    table = folder / "dwells.csv"
    write_import(table, imported)
    _check_means(read_dwells(table), data)


def _check_means(rows: list[DwellRow], data: bytes) -> None:
    """Compare biases with means of what the csv module reads."""
    lines = [
        line
        for line in data.decode("utf-8-sig", "replace").splitlines()
        if line.strip() and not line.lstrip().startswith("#")
    ]
    header, *cells = csv.reader(lines)
    names = [name.strip() for name in header]
    whole = [line for line in cells if len(line) == len(header)]
    columns = {name: [_number(line[names.index(name)]) for line in whole] for name in ("time", "gx")}
    time_s, rate = np.array(columns["time"]), np.array(columns["gx"]) * 3600.0
    known = np.isfinite(time_s)
    time_s, rate = time_s[known] - time_s[known][0], rate[known]
    rate[~(np.abs(rate) <= _LARGEST_DPH)] = math.nan
    for row in rows:
        inside = (time_s >= row.start_s) & (time_s < row.end_s) & np.isfinite(rate)
        if not math.isclose(row.bias_dph[0], rate[inside].mean(), rel_tol=1e-4, abs_tol=0.5):
            raise WrongResultError(
                f"bias {row.bias_dph[0]} of the window at {row.start_s} s, not {rate[inside].mean()}"
            )


def _number(text: str) -> float:
    try:
        return float(text.strip().strip('"'))
    except ValueError:
        return math.nan
