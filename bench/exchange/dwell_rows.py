"""From the valid windows of logs to the rows of a dwell table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gyrobench.bench.bias.dwell_table import NOT_MEASURED, DwellRow, Triple
from gyrobench.bench.exchange.import_map import LogMap
from gyrobench.bench.exchange.log_windows import SampleReader, Window, cut_windows
from gyrobench.bench.exchange.window_checks import earth_rate_dph, nearest_position, reasons_against
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import AXES, POSITIONS


def cycle_numbers(temperatures_c: Sequence[float], min_turn_c: float) -> list[int]:
    """Number the legs of the temperature between its turning points in time, from 1.

    The temperature turned at its extreme once it came back by ``min_turn_c``.
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
class ReadLog:
    """Windows of one log, with the reason why each is left out, empty for a valid window.

    ``missing`` counts the windows without any sample between the first and the last.
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


def read_log(path: Path, log_map: LogMap) -> ReadLog:
    """Cut one log into windows and judge them.

    Raises DocumentError if the import map does not match the log, or it can't be read. Raises
    MeasurementError if time goes back.
    """
    reader = SampleReader(path, log_map)
    windows = list(cut_windows(reader.batches(), log_map.averages.window_s, log_map.skip_s))
    expected = round((windows[-1].end_s - windows[0].start_s) / log_map.averages.window_s) if windows else 0
    reasons = reasons_against(windows, log_map) if windows else []
    return ReadLog(path, reader, windows, reasons, expected - len(windows))


def dwell_rows(logs: Sequence[ReadLog], sigma_dph: FloatArray, log_map: LogMap) -> list[DwellRow]:
    """One row for each valid window of the logs, which are in the order of time.

    ``sigma_dph`` (3,) is the standard uncertainty of a window's mean rates.

    Raises MeasurementError if logs of one power-on overlap or do not follow one another.
    """
    windows = [window for log in logs for window in log.valid_windows]
    offsets = _offsets_s(logs, log_map)
    origins = [index for index, log in enumerate(logs) for _ in log.valid_windows]
    cycles = _cycles(windows, origins, offsets, log_map)
    azimuth_deg = log_map.earth_rate.azimuth_deg if log_map.earth_rate else None
    rows = []
    for index, (window, log, cycle) in enumerate(zip(windows, origins, cycles, strict=True), 1):
        since_start_s = window.start_s + (0.0 if log_map.each_log_is_a_run else offsets[log])
        position = _position(window, log_map)
        earth = earth_rate_dph(position, log_map.earth_rate) if log_map.earth_rate else np.zeros(3)
        gyro_c, slope = _gyro_temperatures(window, log_map)
        rows.append(
            DwellRow(
                unit=log_map.unit,
                run=str(1 + log) if log_map.each_log_is_a_run else log_map.run,
                dwell=index,
                cycle=cycle,
                position=position,
                start_s=window.start_s + offsets[log],
                end_s=window.end_s + offsets[log],
                since_power_on_s=log_map.since_power_on_s + since_start_s,
                gyro_c=gyro_c,
                gyro_rate_c_per_h=slope,
                bias_dph=_triple(window.rate_dph - earth),
                sigma_dph=_triple(sigma_dph),
                azimuth_deg=np.nan if azimuth_deg is None else azimuth_deg,
                chamber_set_c=window.means.get("chamber_set_c", np.nan),
                chamber_c=window.means.get("chamber_c", np.nan),
                case_c=window.means.get("case_c", np.nan),
                board_c=_means(window, "board") if "board_x_c" in window.means else NOT_MEASURED,
            )
        )
    return rows


def _offsets_s(logs: Sequence[ReadLog], log_map: LogMap) -> list[float]:
    """Time of each log's first sample on the table's clock.

    Logs of one power-on share a clock; those of several are laid one behind the other. Raises
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
    windows: Sequence[Window], origins: Sequence[int], offsets: Sequence[float], log_map: LogMap
) -> list[int]:
    rule = log_map.cycle
    if rule.constant is not None:
        return [rule.constant] * len(windows)
    if rule.column is not None:
        return [round(window.means["cycle"]) for window in windows]
    if rule.each_log:
        return [1 + log for log in origins]
    if rule.block_s is not None:
        begins = [window.start_s + offsets[log] for window, log in zip(windows, origins, strict=True)]
        # Sums of window lengths may end a hair before the border of a block.
        blocks = [int((begin - begins[0]) / rule.block_s + 1e-9) for begin in begins]
        return [1 + (block % rule.alternate if rule.alternate else block) for block in blocks]
    temperatures = [float(np.mean(_gyro_temperatures(window, log_map)[0])) for window in windows]
    return cycle_numbers(temperatures, rule.turning_point_c or 0.0)


def _position(window: Window, log_map: LogMap) -> str:
    rule = log_map.averages.position
    if rule.constant is not None:
        return rule.constant
    if rule.column is not None:
        return list(POSITIONS)[int(window.means["position"])]
    return nearest_position(window.force)[0]


def _gyro_temperatures(window: Window, log_map: LogMap) -> tuple[Triple, Triple]:
    constant = log_map.averages.temperatures.constant_c
    if constant is not None:
        return (constant, constant, constant), (0.0, 0.0, 0.0)
    x, y, z = (window.slopes_per_h[f"gyro_{axis}_c"] for axis in AXES)
    return _means(window, "gyro"), (x, y, z)


def _means(window: Window, what: str) -> Triple:
    x, y, z = (window.means[f"{what}_{axis}_c"] for axis in AXES)
    return x, y, z


def _triple(values: FloatArray) -> Triple:
    x, y, z = (float(value) for value in values)
    return x, y, z
