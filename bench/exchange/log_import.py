"""From logs and their import map to a dwell table, with a record of what was left out and why."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow, write_dwells
from gyrobench.bench.exchange.dwell_rows import ReadLog, dwell_rows, read_log
from gyrobench.bench.exchange.import_map import LogMap, load_log_map
from gyrobench.bench.exchange.log_windows import Window
from gyrobench.bench.exchange.window_checks import (
    noise_of_means,
    temperature_resolution_c,
    temperature_warnings,
)
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH
from gyrobench.bench.foundations.csv_tables import write_text
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.earth import earth_rate_enu
from gyrobench.bench.navigation.positions import AXES


@dataclass(frozen=True, eq=False)
class LogImport:
    """A dwell table made from logs: rows, numbers of windows left out by reason, warnings, and the origin.

    The origin is for the record: logs with their hashes, import map, samples.
    """

    rows: list[DwellRow]
    left_out: dict[str, int]
    warnings: list[str]
    origin: dict[str, Any]

    def summary(self) -> str:
        """Result of the import in a few lines."""
        temperatures = np.array([row.gyro_c for row in self.rows])
        windows = len(self.rows) + sum(self.left_out.values())
        lines = [
            f"{len(self.rows)} dwells of {self.rows[0].end_s - self.rows[0].start_s:g} s, gyros at "
            f"{temperatures.min():.1f} to {temperatures.max():.1f} degC, positions "
            f"{', '.join(dict.fromkeys(row.position for row in self.rows))}, cycles "
            f"{', '.join(map(str, sorted({row.cycle for row in self.rows})))}",
            f"Noise of a dwell, x, y, z: {', '.join(f'{each:.3g}' for each in self.rows[0].sigma_dph)} deg/h",
            *(f"Left out: {reason}: {count} of {windows} windows" for reason, count in self.left_out.items()),
            *(f"Warning: {warning}" for warning in self.warnings),
        ]
        return "\n".join(lines)


def import_logs(logs: Sequence[Path], mapping: str) -> LogImport:
    """Average logs to a dwell table.

    ``logs``: in the order of time. ``mapping``: import map: file or shipped name. Raises DocumentError if the
    import map is wrong, or does not match a log, or a log can't be read. Raises MeasurementError if no window
    is valid, time goes back, or the temperatures can't support a curve.
    """
    map_path = find_document("imports", mapping)
    log_map = load_log_map(map_path)
    read = [read_log(path, log_map) for path in logs]
    left_out = Counter(reason for log in read for reason in log.reasons if reason)
    if missing := sum(log.missing for log in read):
        left_out["no sample at all"] = missing
    windows = [window for log in read for window in log.valid_windows]
    if not windows:
        reasons = "; ".join(f"{count}: {reason}" for reason, count in left_out.items())
        raise MeasurementError(
            f"{', '.join(map(str, logs))}: no window of {log_map.averages.window_s:g} s is valid. "
            f"{reasons or 'The log is shorter than skip_s and one window'}. Correct the log or the import map"
        )
    with _named(logs):
        noise_dph = noise_of_means([log.valid_windows for log in read])
    rows = dwell_rows(read, noise_dph, log_map)
    warnings = [*_log_warnings(read), *_map_warnings(log_map, rows)]
    with _named(logs):
        warnings += temperature_warnings(rows, windows, log_map)
    return LogImport(rows, dict(left_out), warnings, _origin(read, windows, map_path, log_map))


def write_import(out: Path, imported: LogImport) -> Path:
    """Write the dwell table, and beside it a record ``NAME.import.json``; returns the record's path.

    Raises RunFolderError if a file can't be written.
    """
    write_dwells(out, imported.rows)
    record = out.with_name(f"{out.stem}.import.json")
    content = imported.origin | {"left_out": imported.left_out, "warnings": imported.warnings}
    write_text(record, json.dumps(content, indent=1) + "\n")
    return record


@contextmanager
def _named(logs: Sequence[Path]) -> Iterator[None]:
    """Name the logs in errors."""
    try:
        yield
    except MeasurementError as error:
        raise MeasurementError(f"{', '.join(map(str, logs))}: {error}") from error


def _log_warnings(logs: Sequence[ReadLog]) -> list[str]:
    warnings = []
    for log in logs:
        if log.reader.truncated:
            warnings.append(f"{log.path}: its end is cut off or damaged, and left out")
        if log.reader.bad_status:
            warnings.append(f"{log.path}: {log.reader.bad_status} samples left out for their status")
        if log.reader.no_time:
            warnings.append(f"{log.path}: {log.reader.no_time} samples without a time left out")
        dropped = sum(each.dropped for each in log.windows) - log.reader.bad_status
        if dropped > 0:
            warnings.append(f"{log.path}: {dropped} samples without a valid rate left out")
    return warnings


def _map_warnings(log_map: LogMap, rows: Sequence[DwellRow]) -> list[str]:
    warnings = []
    if log_map.earth_rate is None:
        if len({row.position for row in rows}) > 1:
            warnings.append(
                "the Earth's rotation, up to 15 deg/h, remains in the biases and differs between positions. "
                "Give 'earth_rate' in the import map"
            )
    elif log_map.earth_rate.azimuth_deg is None:
        _, north, _ = earth_rate_enu(math.radians(log_map.earth_rate.latitude_deg))
        horizontal_dph = north * RADPS_TO_DPH
        warnings.append(
            "without an azimuth the Earth's rotation remains in the biases of the horizontal gyros, up to "
            f"{horizontal_dph:.1f} deg/h"
        )
    if len({row.cycle for row in rows}) == 1:
        warnings.append("all rows belong to one cycle: no cycle can be held out to test a model")
    return warnings


def _origin(
    logs: Sequence[ReadLog], windows: Sequence[Window], map_path: Path, log_map: LogMap
) -> dict[str, Any]:
    resolutions = {
        f"gyro_{axis}": temperature_resolution_c(windows, f"gyro_{axis}_c")
        for axis in AXES
        if log_map.averages.temperatures.constant_c is None
    }
    return {
        "logs": [
            {
                "file": str(log.path),
                "sha256": file_sha256(log.path),
                "samples": sum(each.samples for each in log.windows),
                "dropped": sum(each.dropped for each in log.windows),
                "windows": len(log.windows),
                "windows_used": len(log.valid_windows),
            }
            for log in logs
        ],
        "mapping": {"file": str(map_path), "sha256": file_sha256(map_path)},
        "map": log_map.model_dump(exclude_none=True),
        "temperature_resolution_c": {
            name: value if np.isfinite(value) else None for name, value in resolutions.items()
        },
    }
