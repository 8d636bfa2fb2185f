"""Import of logs into a dwell table by an import map, with a record of what was left out and why."""

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

from gyrobench.bench.bias.dwell_table import NOT_MEASURED, DwellRow, write_dwells
from gyrobench.bench.exchange.earth_check import earth_warnings
from gyrobench.bench.exchange.import_map import LogMap, load_log_map
from gyrobench.bench.exchange.log_windows import SampleReader, Trend, Window, cut_windows
from gyrobench.bench.exchange.window_checks import (
    earth_rate_dph,
    nearest_position,
    noise_of_means,
    rejection_reasons,
    temperature_resolution_c,
    temperature_warnings,
)
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, FloatArray, Triple, triple
from gyrobench.bench.foundations.csv_tables import write_text
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.files import file_sha256
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.earth import earth_rate_enu
from gyrobench.bench.navigation.positions import AXES, POSITIONS


@dataclass(frozen=True, eq=False)
class LogImport:
    """A dwell table made from logs: rows, numbers of windows left out by reason, warnings, and origin.

    ``origin`` is written to the record: logs with their hashes, import map, samples.
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
    """Average the windows of logs to the rows of a dwell table.

    ``logs``: in the order of time. ``mapping``: import map: file or shipped name. Raises DocumentError if the
    import map is wrong, or does not match a log, or a log can't be read. Raises MeasurementError if no window
    is valid, time goes back, or the temperatures can't support a curve.
    """
    map_path = find_document("imports", mapping)
    log_map = load_log_map(map_path)
    read_logs = [_read_log(path, log_map) for path in logs]
    left_out = Counter(reason for log in read_logs for reason in log.reasons if reason)
    if missing := sum(log.missing for log in read_logs):
        left_out["no sample at all"] = missing
    windows = [window for log in read_logs for window in log.valid_windows]
    if not windows:
        reasons = "; ".join(f"{count}: {reason}" for reason, count in left_out.items())
        raise MeasurementError(
            f"{', '.join(map(str, logs))}: no window of {log_map.averages.window_s:g} s is valid. "
            f"{reasons or 'The log is shorter than skip_s and one window'}. Correct the log or the import map"
        )
    with _prefix_errors(logs):
        noise_dph = noise_of_means([log.valid_windows for log in read_logs])
    rows = _dwell_rows(read_logs, noise_dph, log_map)
    warnings = [*_log_warnings(read_logs), *_map_warnings(log_map, rows)]
    with _prefix_errors(logs):
        warnings += temperature_warnings(rows, windows, log_map)
    return LogImport(rows, dict(left_out), warnings, _origin(read_logs, windows, map_path, log_map))


def write_import(out: Path, imported: LogImport) -> Path:
    """Write the dwell table and a record ``NAME.import.json`` beside it; returns the path of the record.

    Raises RunFolderError if a file can't be written.
    """
    write_dwells(out, imported.rows)
    record = out.with_name(f"{out.stem}.import.json")
    content = imported.origin | {"left_out": imported.left_out, "warnings": imported.warnings}
    write_text(record, json.dumps(content, indent=1) + "\n")
    return record


@contextmanager
def _prefix_errors(logs: Sequence[Path]) -> Iterator[None]:
    """Prefix measurement errors with the names of the logs."""
    try:
        yield
    except MeasurementError as error:
        raise MeasurementError(f"{', '.join(map(str, logs))}: {error}") from error


def _log_warnings(logs: Sequence[_ReadLog]) -> list[str]:
    warnings = []
    for log in logs:
        if log.reader.truncated:
            warnings.append(f"{log.path}: its end is cut off or damaged, and left out")
        bad_status, no_time = log.reader.bad_status, log.reader.no_time
        counts = (
            (bad_status, "samples left out for their status"),
            (no_time, "samples without a time left out"),
            (sum(each.dropped for each in log.windows) - bad_status, "samples without a valid rate left out"),
        )
        warnings += [f"{log.path}: {count} {what}" for count, what in counts if count > 0]
    return warnings


def _map_warnings(log_map: LogMap, rows: Sequence[DwellRow]) -> list[str]:
    warnings: list[str] = []
    if log_map.earth_rate is None:
        if len({row.position for row in rows}) > 1:
            warnings.append(
                "the Earth's rotation, up to 15 deg/h, remains in the biases and differs between positions. "
                "Give 'earth_rate' in the import map"
            )
    else:
        is_by_force = log_map.averages.position.accelerometers is not None
        warnings += earth_warnings(rows, log_map.earth_rate, is_by_force)
        if log_map.earth_rate.azimuth_deg is None:
            _, north, _ = earth_rate_enu(math.radians(log_map.earth_rate.latitude_deg))
            horizontal_dph = north * RADPS_TO_DPH
            warnings.append(
                "without an azimuth the Earth's rotation remains in the biases of the horizontal gyros, up "
                f"to {horizontal_dph:.1f} deg/h"
            )
    if len({row.cycle for row in rows}) == 1:
        warnings.append("all rows belong to one cycle: no cycle can be held out to test a model")
    return warnings


def _origin(
    logs: Sequence[_ReadLog], windows: Sequence[Window], map_path: Path, log_map: LogMap
) -> dict[str, Any]:
    """Origin of the rows, for the record of the import."""
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


def cycle_numbers(temperatures_c: Sequence[float], min_turn_c: float) -> list[int]:
    """Number, from 1, of the leg of the temperature between turning points at each time.

    An extreme is a turning point if the temperature comes back from it by ``min_turn_c``.
    """
    turns: list[int] = []
    direction = 0
    low = high = 0
    for index, value in enumerate(temperatures_c):
        if value > temperatures_c[high]:
            high = index
        if value < temperatures_c[low]:
            low = index
        if direction >= 0 and temperatures_c[high] - value >= min_turn_c:
            if direction > 0:
                turns.append(high)
            direction, low = -1, index
        elif direction <= 0 and value - temperatures_c[low] >= min_turn_c:
            if direction < 0:
                turns.append(low)
            direction, high = 1, index
    return [1 + sum(index > turn for turn in turns) for index in range(len(temperatures_c))]


@dataclass(frozen=True, eq=False)
class _ReadLog:
    """Windows of one log, with the reason why each is left out, empty for a valid window.

    ``missing``: number of windows without any sample between the first and the last.
    """

    path: Path
    reader: SampleReader
    windows: list[Window]
    reasons: list[str]
    missing: int

    @property
    def valid_windows(self) -> list[Window]:
        """Windows that become rows."""
        return [each for each, reason in zip(self.windows, self.reasons, strict=True) if not reason]


def _read_log(path: Path, log_map: LogMap) -> _ReadLog:
    """Divide one log into windows and check them.

    Raises DocumentError if the import map does not match the log, or it can't be read. Raises
    MeasurementError if time goes back.
    """
    reader = SampleReader(path, log_map)
    windows = list(cut_windows(reader.batches(), log_map.averages.window_s, log_map.skip_s))
    expected = round((windows[-1].end_s - windows[0].start_s) / log_map.averages.window_s) if windows else 0
    reasons = rejection_reasons(windows, log_map) if windows else []
    return _ReadLog(path, reader, windows, reasons, expected - len(windows))


def _dwell_rows(logs: Sequence[_ReadLog], sigma_dph: FloatArray, log_map: LogMap) -> list[DwellRow]:
    """One row for each valid window of the logs, which are in the order of time.

    ``sigma_dph`` (3,) is the standard uncertainty of a window's mean rates.

    Raises MeasurementError if logs of one power-on overlap or do not follow one another.
    """
    windows = [window for log in logs for window in log.valid_windows]
    offsets = _offsets_s(logs, log_map)
    log_indices = [index for index, log in enumerate(logs) for _ in log.valid_windows]
    cycles = _cycles(windows, log_indices, offsets, log_map)
    azimuth_deg = log_map.earth_rate.azimuth_deg if log_map.earth_rate else None
    rows = []
    for index, (window, log_index, cycle) in enumerate(zip(windows, log_indices, cycles, strict=True), 1):
        since_start_s = window.start_s + (0.0 if log_map.each_log_is_a_run else offsets[log_index])
        position = _position(window, log_map)
        earth = earth_rate_dph(position, log_map.earth_rate) if log_map.earth_rate else np.zeros(3)
        gyro_c, slope = _gyro_temperatures(window, log_map)
        rows.append(
            DwellRow(
                unit=log_map.unit,
                run=str(1 + log_index) if log_map.each_log_is_a_run else log_map.run,
                dwell=index,
                cycle=cycle,
                position=position,
                start_s=window.start_s + offsets[log_index],
                end_s=window.end_s + offsets[log_index],
                since_power_on_s=log_map.since_power_on_s + since_start_s,
                gyro_c=gyro_c,
                gyro_rate_c_per_h=slope,
                bias_dph=triple(window.rate_dph - earth),
                sigma_dph=triple(sigma_dph),
                azimuth_deg=np.nan if azimuth_deg is None else azimuth_deg,
                chamber_set_c=window.trends.get("chamber_set_c", Trend()).mean,
                chamber_c=window.trends.get("chamber_c", Trend()).mean,
                case_c=window.trends.get("case_c", Trend()).mean,
                board_c=_means(window, "board") if "board_x_c" in window.trends else NOT_MEASURED,
            )
        )
    return rows


def _offsets_s(logs: Sequence[_ReadLog], log_map: LogMap) -> list[float]:
    """Time of each log's first sample on the table's clock.

    Logs of one power-on share a clock; logs of several power-ons follow one another without a gap. Raises
    MeasurementError if logs of one power-on overlap or do not follow one another.
    """
    offsets: list[float] = []
    end_s = 0.0
    for log in logs:
        if log_map.each_log_is_a_run:
            offset = end_s
        else:
            offset = log.reader.first_s - logs[0].reader.first_s
            if offsets and offset < end_s - log_map.averages.window_s:
                raise MeasurementError(
                    f"{log.path}: begins {offset:.1f} s after {logs[0].path}, before the log "
                    "ahead of it ends. Give the logs in the order of time; if each is a separate power-on, "
                    "set 'each_log_is_a_run: true' in the import map"
                )
        offsets.append(offset)
        end_s = offset + (log.windows[-1].end_s if log.windows else 0.0)
    return offsets


def _cycles(
    windows: Sequence[Window], log_indices: Sequence[int], offsets: Sequence[float], log_map: LogMap
) -> list[int]:
    """Cycle of each window; ``log_indices``: index of its log."""
    rule = log_map.cycle
    if rule.constant is not None:
        return [rule.constant] * len(windows)
    if rule.column is not None:
        return [round(window.trends["cycle"].mean) for window in windows]
    if rule.each_log:
        return [1 + log_index for log_index in log_indices]
    if rule.block_s is not None:
        starts_s = [
            window.start_s + offsets[log_index]
            for window, log_index in zip(windows, log_indices, strict=True)
        ]
        # Rounding may put a sum of window lengths slightly before the border of a block.
        blocks = [int((start_s - starts_s[0]) / rule.block_s + 1e-9) for start_s in starts_s]
        return [1 + (block % rule.alternate if rule.alternate else block) for block in blocks]
    temperatures = [float(np.mean(_gyro_temperatures(window, log_map)[0])) for window in windows]
    return cycle_numbers(temperatures, rule.turning_point_c or 0.0)


def _position(window: Window, log_map: LogMap) -> str:
    rule = log_map.averages.position
    if rule.constant is not None:
        return rule.constant
    if rule.column is not None:
        return list(POSITIONS)[int(window.trends["position"].mean)]
    return nearest_position(window.force)[0]


def _gyro_temperatures(window: Window, log_map: LogMap) -> tuple[Triple, Triple]:
    """Mean temperatures of the gyros in a window, degC, and their rates, K/h."""
    constant = log_map.averages.temperatures.constant_c
    if constant is not None:
        return (constant, constant, constant), (0.0, 0.0, 0.0)
    return _means(window, "gyro"), triple(window.trends[f"gyro_{axis}_c"].slope_per_h for axis in AXES)


def _means(window: Window, sensor: str) -> Triple:
    return triple(window.trends[f"{sensor}_{axis}_c"].mean for axis in AXES)
