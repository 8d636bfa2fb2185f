"""Columns of a log as quantities: body axes, deg/h, degC, seconds since the first sample."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrobench.bench.foundations.arrays import RADPS_TO_DPH, FloatArray
from gyrobench.bench.foundations.csv_tables import COLDEST_C, HOTTEST_C
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError
from gyrobench.bench.navigation.positions import AXES, POSITIONS
from gyrobench.bench.sensor_log.document import Column, LogMap, TextFormat
from gyrobench.bench.sensor_log.record_log import RecordLog
from gyrobench.bench.sensor_log.text_log import Batch, TextLog

#: Quantities of some samples by name, each of shape (n,): ``time_s``, ``rate_x_dph``, ``gyro_x_c``, ...,
#: ``force_x``, ``position`` (index in POSITIONS), ``cycle``; NaN where not measured.
Samples = dict[str, FloatArray]

RATES = tuple(f"rate_{axis}_dph" for axis in AXES)
FORCES = tuple(f"force_{axis}" for axis in AXES)

#: Beyond these nothing is measured, and no log is as long; what lies there counts as NaN does.
_LARGEST, _LONGEST_S = 1e15, 1e12

_TO_DPH = {"rad/s": RADPS_TO_DPH, "deg/s": 3600.0, "deg/h": 1.0}
_TO_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


class SampleReader:
    """Reads one log as its mapping says.

    Attributes
    ----------
    first_s : float
        Reading of the log's clock at its first sample, from the first batch on; 0 without a time column.
    bad_status, no_time : int
        Samples left out so far since their status is not good, or since they have no time.

    Raises
    ------
    DocumentError
        The file can't be read or has no sample.
    """

    def __init__(self, path: Path, log_map: LogMap) -> None:
        self._path = path
        self._map = log_map
        self._log = _open(path, log_map)
        self._quantities = _quantities(log_map)
        self.first_s = 0.0
        self.bad_status = 0
        self.no_time = 0
        self._read = 0

    @property
    def truncated(self) -> bool:
        """Whether the log's last line or record was cut off."""
        return self._log.truncated

    def batches(self) -> Iterator[Samples]:
        """Read the log in the order of time.

        A sample whose status is not good keeps its time and loses its rates.

        Raises
        ------
        DocumentError
            The mapping names a column that the log lacks, or a cell can't be read.
        MeasurementError
            Time goes back.
        """
        numbers = [column for column, _, _ in self._quantities.values()]
        time = self._map.time.column
        texts = [
            rule.column
            for rule in (self._map.status, self._map.position)
            if rule is not None and rule.column is not None
        ]
        origin, last_s = None, -np.inf
        for batch in self._log.batches(numbers if time is None else [*numbers, time], texts):
            samples = self._samples(batch)
            count = len(samples[RATES[0]])
            if time is None:
                time_s = (self._read + np.arange(count)) / (self._map.time.sample_rate_hz or 1.0)
            else:
                raw = batch[time]
                if origin is None and np.isfinite(raw).any():
                    origin = float(raw[np.isfinite(raw)][0])
                    self.first_s = origin * _TO_SECONDS[self._map.time.unit]
                with np.errstate(over="ignore"):
                    time_s = (raw - (origin or 0.0)) * _TO_SECONDS[self._map.time.unit]
            known = np.abs(time_s) <= _LONGEST_S
            self.no_time += int(count - known.sum())
            self._read += count
            samples = {name: values[known] for name, values in samples.items()}
            samples["time_s"] = time_s[known]
            self._check_order(samples["time_s"], last_s)
            if known.any():
                last_s = float(samples["time_s"][-1])
            yield samples

    def _samples(self, batch: Batch) -> Samples:
        samples = {
            name: _measured(name, batch[column], scale, offset)
            for name, (column, scale, offset) in self._quantities.items()
        }
        status, position = self._map.status, self._map.position
        if status is not None:
            good = np.isin(_words(batch[status.column]), [_word(str(each)) for each in status.good])
            self.bad_status += int((~good).sum())
            for name in RATES:
                samples[name] = np.where(good, samples[name], np.nan)
        if position.column is not None:
            samples["position"] = self._positions(batch[position.column])
        return samples

    def _positions(self, texts: NDArray[np.str_]) -> FloatArray:
        names, which = np.unique(_words(texts), return_inverse=True)
        values = {_word(text): name for text, name in self._map.position.values.items()}
        unknown = [name for name in names if name and name not in values]
        if unknown:
            raise DocumentError(
                f"{self._path}: column {self._map.position.column} holds '{unknown[0]}', which is none of "
                f"{', '.join(values)}. Add it to 'position.values' of the mapping"
            )
        order = list(POSITIONS)
        return np.array([float(order.index(values[name])) if name else np.nan for name in names])[which]

    def _check_order(self, time_s: FloatArray, last_s: float) -> None:
        steps = np.diff(time_s, prepend=last_s)
        back = np.flatnonzero(steps < 0.0)
        if back.size:
            raise MeasurementError(
                f"{self._path}: time goes back by {-steps[back[0]]:g} s at {time_s[back[0]]:.3f} s after the "
                "first sample. Cut the log there, or, where only its clock is wrong, give "
                "'time: {sample_rate_hz: ...}' in the mapping"
            )


def _open(path: Path, log_map: LogMap) -> TextLog | RecordLog:
    if log_map.records is not None:
        return RecordLog(path, log_map.records)
    return TextLog(path, log_map.text or TextFormat())


def _quantities(log_map: LogMap) -> dict[str, tuple[Column, float, float]]:
    """Column, scale and offset of each number that is read."""
    gyro, temperatures = log_map.gyro, log_map.temperatures
    to_dph = _TO_DPH[gyro.unit]
    quantities: dict[str, tuple[Column, float, float]] = {}
    for name, axis in zip(RATES, (gyro.x, gyro.y, gyro.z), strict=True):
        quantities[name] = (axis.column, axis.sign * to_dph, 0.0)
    for name, column in temperatures.by_quantity().items():
        quantities[name] = (column, temperatures.scale, temperatures.offset_c)
    if (force := log_map.position.accelerometers) is not None:
        for name, axis in zip(FORCES, (force.x, force.y, force.z), strict=True):
            quantities[name] = (axis.column, float(axis.sign), 0.0)
    if log_map.cycle.column is not None:
        quantities["cycle"] = (log_map.cycle.column, 1.0, 0.0)
    return quantities


def _measured(name: str, raw: FloatArray, scale: float, offset: float) -> FloatArray:
    """Values of a quantity; NaN where it can't have what the log says."""
    with np.errstate(over="ignore", invalid="ignore"):
        values = raw * scale + offset
    low, high = (COLDEST_C, HOTTEST_C) if name.endswith("_c") else (-_LARGEST, _LARGEST)
    return np.where((values >= low) & (values <= high), values, np.nan)


def full_scale_dph(log_map: LogMap) -> float:
    """Largest rate that the gyros can tell; infinite where not known."""
    return np.inf if log_map.gyro.full_scale is None else log_map.gyro.full_scale * _TO_DPH[log_map.gyro.unit]


def _words(texts: NDArray[Any]) -> NDArray[np.str_]:
    """Texts that compare equal where they mean the same."""
    unique, which = np.unique(texts.astype(str), return_inverse=True)
    return np.array([_word(text) for text in unique], dtype=str)[which]


def _word(text: str) -> str:
    """Text without blanks around it; a number as short as it goes: ``0.0`` becomes ``0``."""
    try:
        return f"{float(text):g}"
    except ValueError:
        return text.strip()
