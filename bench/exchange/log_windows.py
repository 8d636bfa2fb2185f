"""Columns of a log as quantities, and their means over windows.

Body axes, deg/h, degC, seconds since the first sample. The unit is at rest in each window.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyrobench.bench.bias.raw_rate import RateRecording
from gyrobench.bench.exchange.import_map import LogMap, PositionRule, ScaledColumn, TextFormat
from gyrobench.bench.exchange.log_files import Batch, RecordLog, TextLog
from gyrobench.bench.exchange.signal_logs import SignalLog
from gyrobench.bench.foundations.arrays import (
    DPH_TO_RADPS,
    RADPS_TO_DPH,
    STANDARD_GRAVITY,
    BoolArray,
    FloatArray,
    true_spans,
)
from gyrobench.bench.foundations.csv_tables import COLDEST_C, HOTTEST_C
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError
from gyrobench.bench.navigation.positions import AXES, POSITIONS

#: Quantities of some samples by name, each of shape (n,): ``time_s``, ``rate_x`` (deg/h), ``gyro_x_c``, ...,
#: ``force_x``, ``position`` (index in POSITIONS), ``cycle``; NaN if not measured.
Samples = dict[str, FloatArray]

RATES = tuple(f"rate_{axis}" for axis in AXES)
FORCES = tuple(f"force_{axis}" for axis in AXES)

#: Larger values and times count as NaN: no sensor measures them, no log is as long.
_MAX_VALUE, _MAX_TIME_S = 1e15, 1e12

#: First bytes of logs of signals, by their format in an import map.
_SIGNATURES = {"blf": b"LOGG", "parquet": b"PAR1", "mf4": b"MDF ", "px4": b"ULog"}
#: Number of bytes that are read to recognise a format.
_SIGNATURE_BYTES = 1024
_TO_DPH = {"rad/s": RADPS_TO_DPH, "deg/s": 3600.0, "deg/h": 1.0, "arcsec/s": 1.0}
_PREFIXES = {"m": 1e-3, "u": 1e-6}
_TO_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
#: Times after which the clocks of loggers and of GPS restart.
_CLOCK_PERIODS = ((86400.0, "day"), (604800.0, "week"))
#: Exceeds the rounding of a calendar time in float64; a sample this close before a window belongs to it.
_TIME_RESOLUTION_S = 1e-6


def _check_format(path: Path, expected: str) -> None:
    """Raise DocumentError if the first bytes of a log show another format than that of the import map.

    Only formats of signal logs are recognised, and text in place of them; other logs pass.
    """
    try:
        with path.open("rb") as file:
            first = file.read(_SIGNATURE_BYTES)
    except OSError:  # reported when the log is read
        return
    kind = next((name for name, begin in _SIGNATURES.items() if first.startswith(begin)), "")
    if not kind and expected and first and b"\0" not in first:  # headers of signal logs contain zeros
        kind = "text"
    if kind not in ("", expected):
        read_as = f"'signals: {{format: {expected}}}'" if expected else "text or records"
        raise DocumentError(
            f"{path}: is a log of format {kind}, which the import map reads as {read_as}. Choose the map of "
            "this log with --map"
        )


class SampleReader:
    """Reads one log by its import map, and counts samples left out for their status or without a time.

    ``quantities`` replaces those of the import map, in units of the caller, without the position; a sample
    then has the values that were logged together. ``increments``: whether a sample that lacks one is invalid.

    ``first_s`` is the reading of the log's clock at its first sample, from the first batch on; 0 without a
    time column.

    Raises DocumentError if the file can't be read or has no sample.
    """

    def __init__(
        self,
        path: Path,
        log_map: LogMap,
        quantities: Mapping[str, ScaledColumn] | None = None,
        increments: bool = False,
    ) -> None:
        self._path = path
        self._map = log_map
        self._position = None if quantities else log_map.averages.position
        _check_format(path, log_map.signals.format if log_map.signals else "")
        self._log: RecordLog | SignalLog | TextLog
        if log_map.records:
            self._log = RecordLog(path, log_map.records)
        elif log_map.signals:
            paired_columns = {column for column, _, _ in (quantities or {}).values()}
            self._log = SignalLog(path, log_map.signals, paired_columns, increments)
            try:
                log_map.gyro.check_units(self._log.units)
                if quantities:
                    log_map.calibrated.accelerometers.check_units(self._log.units)
            except ValueError as error:
                raise DocumentError(f"{path}: {error}") from error
        else:
            self._log = TextLog(path, log_map.text or TextFormat())
        self._quantities = quantities or _quantities(log_map)
        self.first_s = 0.0
        self.bad_status = 0
        self.no_time = 0
        self._sample_count = 0

    @property
    def truncated(self) -> bool:
        """Whether the log's last line or record was cut off."""
        return self._log.truncated

    def batches(self) -> Iterator[Samples]:
        """Read the log in the order of time.

        A sample with an invalid status keeps its time; its rates become NaN. Raises DocumentError if the
        import map names a column that the log lacks, or a cell can't be read. Raises MeasurementError if time
        goes back.
        """
        numbers = [column for column, _, _ in self._quantities.values()]
        time = self._map.time.column
        texts = [
            rule.column
            for rule in (self._map.status, self._position)
            if rule is not None and rule.column is not None
        ]
        origin, last_s = None, -np.inf
        is_calendar = self._map.time.format is not None or self._map.time.unit == "iso8601"
        second = 1.0 if is_calendar else _TO_SECONDS[self._map.time.unit]
        if time is not None:
            (texts if is_calendar else numbers).append(time)
        for batch in self._log.batches(numbers, texts):
            samples = self._samples(batch)
            count = len(samples[RATES[0]])
            if time is None:
                time_s = (self._sample_count + np.arange(count)) / (self._map.time.sample_rate_hz or 1.0)
            else:
                clock = self._calendar_s(batch[time]) if is_calendar else batch[time]
                if origin is None and np.isfinite(clock).any():
                    origin = float(clock[np.isfinite(clock)][0])
                    self.first_s = origin * second
                with np.errstate(over="ignore"):
                    time_s = (clock - (origin or 0.0)) * second
            is_valid = np.abs(time_s) <= _MAX_TIME_S
            self.no_time += int(count - is_valid.sum())
            self._sample_count += count
            samples = {name: values[is_valid] for name, values in samples.items()}
            samples["time_s"] = time_s[is_valid]
            self._check_order(samples["time_s"], last_s)
            if is_valid.any():
                last_s = float(samples["time_s"][-1])
            yield samples

    def whole(self) -> Samples:
        """Read the whole log as one batch, as :meth:`batches`."""
        batches = list(self.batches())
        return {name: np.concatenate([each[name] for each in batches]) for name in batches[0]}

    def _calendar_s(self, texts: NDArray[Any]) -> FloatArray:
        """Calendar times as s; NaN for an empty text. Those without an offset are in UTC."""
        times_s, layout = np.full(len(texts), np.nan), self._map.time.format
        for index, text in enumerate(texts.tolist()):
            if not (stripped := text.strip()):
                continue
            try:
                time = datetime.strptime(stripped, layout) if layout else datetime.fromisoformat(stripped)
            except ValueError as error:
                raise DocumentError(
                    f"{self._path}: column {self._map.time.column} holds '{text[:60]}', which is no time "
                    + (f"of the form '{layout}'" if layout else "by ISO 8601")
                    + ". Give its form in 'time.format' of the import map, such as '%d.%m.%Y %H:%M:%S'"
                ) from error
            times_s[index] = (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()
        return times_s

    def _samples(self, batch: Batch) -> Samples:
        """Quantities of a batch; rates with an invalid status are NaN."""
        samples = {
            name: _converted(name, batch[column], scale, offset)
            for name, (column, scale, offset) in self._quantities.items()
        }
        status, position = self._map.status, self._position
        if status is not None:
            valid = np.isin(
                _normalised(batch[status.column]), [_normalised_text(str(each)) for each in status.good]
            )
            self.bad_status += int((~valid).sum())
            for name in RATES:
                samples[name] = np.where(valid, samples[name], np.nan)
        if position is not None and position.column is not None:
            samples["position"] = self._positions(position, batch[position.column])
        return samples

    def _positions(self, rule: PositionRule, texts: NDArray[np.str_]) -> FloatArray:
        """Indices of positions, from the texts of their column."""
        names, indices = np.unique(_normalised(texts), return_inverse=True)
        values = {_normalised_text(text): name for text, name in rule.values.items()}
        unknown = [name for name in names if name and name not in values]
        if unknown:
            raise DocumentError(
                f"{self._path}: column {rule.column} holds '{unknown[0]}', which is none of "
                f"{', '.join(values)}. Add it to 'position.values' in the import map"
            )
        positions = list(POSITIONS)
        return np.array([float(positions.index(values[name])) if name else np.nan for name in names])[indices]

    def _check_order(self, time_s: FloatArray, last_s: float) -> None:
        """Raise MeasurementError if a time is earlier than the previous one."""
        steps = np.diff(time_s, prepend=last_s)
        backward = np.flatnonzero(steps < 0.0)
        if backward.size:
            back_s, end_s = -float(steps[backward[0]]), float(time_s[backward[0]])
            period = next((name for length_s, name in _CLOCK_PERIODS if abs(back_s - length_s) < 10.0), "")
            raise MeasurementError(
                f"{self._path}: time goes back by {back_s:g} s, from {end_s + back_s:.3f} to {end_s:.3f} s "
                f"after the first sample{period and f', as of a clock that restarts each {period}'}. Cut the "
                "log there, or, if only its clock is wrong, give 'time: {sample_rate_hz: ...}' in the import "
                "map"
            )


def read_rate_recording(path: Path, log_map: LogMap) -> RateRecording:
    """Read a whole log at rest as one recording; the specific force is scaled to standard gravity.

    Raises DocumentError if the log can't be read, or does not fit the map. Raises MeasurementError if the
    unit was not at rest, or samples are missing or wrong.
    """
    samples = SampleReader(path, log_map).whole()
    force = None
    if FORCES[0] in samples:
        force = np.column_stack([samples[name] for name in FORCES])
        force *= STANDARD_GRAVITY / np.linalg.norm(force.mean(axis=0))
    rates = np.column_stack([samples[name] for name in RATES]) * DPH_TO_RADPS
    try:
        return RateRecording(samples["time_s"], rates, force)
    except MeasurementError as error:
        raise MeasurementError(f"{path}: {error}") from error


def _quantities(log_map: LogMap) -> dict[str, ScaledColumn]:
    """Column, scale and offset of each numeric quantity of an import."""
    gyro, (temperatures, position, _) = log_map.gyro, log_map.averages
    quantities = gyro.by_quantity(RATES, _rate_dph(gyro.unit)) | temperatures.by_quantity()
    if position.accelerometers is not None:
        quantities |= position.accelerometers.by_quantity(FORCES)
    if log_map.cycle.column is not None:
        quantities["cycle"] = (log_map.cycle.column, 1.0, 0.0)
    return quantities


def _converted(name: str, raw: FloatArray, scale: float, offset: float) -> FloatArray:
    """Converted values of a quantity; NaN for impossible values."""
    with np.errstate(over="ignore", invalid="ignore"):
        values = raw * scale + offset
    low, high = (COLDEST_C, HOTTEST_C) if name.endswith("_c") else (-_MAX_VALUE, _MAX_VALUE)
    return np.where((values >= low) & (values <= high), values, np.nan)


def full_scale_dph(log_map: LogMap) -> float:
    """Measuring range of the gyros; infinite if unknown."""
    gyro = log_map.gyro
    return np.inf if gyro.full_scale is None else gyro.full_scale * _rate_dph(gyro.unit)


def _rate_dph(unit: str) -> float:
    """Deg/h in a unit of rate, with or without prefix."""
    return _TO_DPH[unit] if unit in _TO_DPH else _PREFIXES[unit[0]] * _TO_DPH[unit[1:]]


def _normalised(texts: NDArray[Any]) -> NDArray[np.str_]:
    """Normalised texts, which compare equal if they mean the same."""
    unique, indices = np.unique(texts.astype(str), return_inverse=True)
    return np.array([_normalised_text(text) for text in unique], dtype=str)[indices]


def _normalised_text(text: str) -> str:
    """Text without surrounding blanks; a number in its shortest form: ``0.0`` becomes ``0``."""
    try:
        return f"{float(text):g}"
    except ValueError:
        return text.strip()


#: Possible numbers of blocks of a window, whose means give the noise; each is half of the previous one.
BLOCKS = (40, 20, 10, 5)
#: Smallest number of samples of a window.
MIN_WINDOW_SAMPLES = 10
#: Largest rounding error of a step, relative to the largest value.
_ROUNDING = 1e-9


class Trend(NamedTuple):
    """A quantity in a window; NaN if not measured."""

    mean: float = np.nan
    slope_per_h: float = np.nan
    step: float = np.inf  #: Smallest change; infinite if there is none.
    span: float = np.nan  #: Difference of largest and smallest value.


@dataclass(frozen=True, eq=False)
class Window:
    """Means of one window."""

    #: start_s, end_s: Times since the first sample of the log.
    start_s: float
    end_s: float
    #: samples, dropped: Numbers of samples with all three rates, and of other samples.
    samples: int
    dropped: int
    max_step_s: float  #: Longest time between two samples, including the last one before the window.
    covered_s: float  #: From the first to the last sample.
    rate_dph: FloatArray  #: Shape (3,). Mean rates.
    scatter_dph: FloatArray  #: Shape (3,). Standard deviation of the samples.
    #: Shape (blocks, 3). Mean rates of equal parts in the order of time; the largest possible number of
    #: :data:`BLOCKS`.
    blocks_dph: FloatArray
    #: Shape (3,). Smallest change from one sample to the next; infinite if there is none.
    rate_step_dph: FloatArray
    #: extreme_dph, max_samples_at_extreme: Shape (3,). Largest absolute rate, and longest series of samples
    #: with it.
    extreme_dph: FloatArray
    max_samples_at_extreme: NDArray[np.intp]
    max_samples_unchanged: NDArray[np.intp]  #: Shape (3,). Longest series of samples with a constant rate.
    trends: dict[str, Trend]  #: Of temperatures, position and cycle.
    force: FloatArray  #: Shape (3,). Mean of the accelerometers; NaN if the import map names none.


def cut_windows(batches: Iterable[Samples], window_s: float, skip_s: float) -> Iterator[Window]:
    """Divide a log into windows; the mean rates of a window with too few valid samples are NaN.

    Too few are less than :data:`MIN_WINDOW_SAMPLES`. At most a batch and a window are in memory at a time.
    """
    pending: Samples = {}
    before_s = np.nan
    for batch in batches:
        is_used = batch["time_s"] >= skip_s - _TIME_RESOLUTION_S
        used = {name: values[is_used] for name, values in batch.items()}
        pending = {name: np.concatenate([pending[name], used[name]]) for name in used} if pending else used
        index = _window_index(pending["time_s"], window_s, skip_s)
        if index.size == 0 or index[0] == index[-1]:
            continue
        borders = np.flatnonzero(np.diff(index, prepend=index[0] - 1))
        for first, last in itertools.pairwise(borders):
            samples = {name: values[first:last] for name, values in pending.items()}
            yield _window(samples, window_s, skip_s, before_s)
            before_s = float(samples["time_s"][-1])
        pending = {name: values[borders[-1] :] for name, values in pending.items()}
    if pending and pending["time_s"].size:
        yield _window(pending, window_s, skip_s, before_s)


def max_consecutive(flags: BoolArray) -> int:
    """Length of the longest series of true values."""
    return int(np.diff(true_spans(flags)).max(initial=0))


def _window_index(time_s: FloatArray, window_s: float, skip_s: float) -> NDArray[np.intp]:
    return np.asarray((time_s - skip_s + _TIME_RESOLUTION_S) // window_s, dtype=np.intp)


def _window(samples: Samples, window_s: float, skip_s: float, before_s: float) -> Window:
    """Means of the samples of one window; ``before_s``: time of the previous sample."""
    time_s = samples["time_s"]
    index = int(_window_index(time_s[:1], window_s, skip_s)[0])
    rates = np.column_stack([samples[name] for name in RATES])
    valid = np.isfinite(rates).all(axis=1)
    rates = rates[valid]
    abs_rates = np.abs(rates)
    steps = np.diff(time_s, prepend=time_s[0] if np.isnan(before_s) else before_s)
    names = [name for name in samples if name.endswith("_c") or name in ("position", "cycle")]
    is_sufficient = len(rates) >= MIN_WINDOW_SAMPLES
    unknown = np.full(3, np.nan)
    block_count = next((count for count in BLOCKS if 2 * count <= len(rates)), 0)
    blocks = np.array_split(rates, block_count) if block_count else []
    return Window(
        start_s=skip_s + index * window_s,
        end_s=skip_s + (index + 1) * window_s,
        samples=len(rates),
        dropped=int(valid.size - len(rates)),
        max_step_s=float(steps.max()),
        covered_s=float(time_s[-1] - time_s[0]),
        rate_dph=rates.mean(axis=0) if is_sufficient else unknown,
        scatter_dph=rates.std(axis=0, ddof=1) if is_sufficient else unknown,
        blocks_dph=np.reshape([block.mean(axis=0) for block in blocks], (-1, 3)),
        rate_step_dph=np.array([_smallest_step(rate) for rate in rates.T]),
        extreme_dph=abs_rates.max(axis=0, initial=0.0),
        max_samples_at_extreme=np.array(
            [max_consecutive(each == each.max(initial=0.0)) for each in abs_rates.T]
        ),
        max_samples_unchanged=np.array([1 + max_consecutive(np.diff(rate) == 0.0) for rate in rates.T]),
        trends={name: _trend(time_s, samples[name]) for name in names},
        force=np.array(
            [_trend(time_s, samples[name]).mean if name in samples else np.nan for name in FORCES]
        ),
    )


def _trend(time_s: FloatArray, values: FloatArray) -> Trend:
    is_known = np.isfinite(values)
    if not is_known.any():
        return Trend()
    time_h, known_values = (time_s[is_known] - time_s[is_known].mean()) / 3600.0, values[is_known]
    mean = float(known_values.mean())
    squares = float(time_h @ time_h)
    slope = float(time_h @ (known_values - mean)) / squares if squares > 0.0 else np.nan
    return Trend(mean, slope, _smallest_step(known_values), float(np.ptp(known_values)))


def _smallest_step(values: FloatArray) -> float:
    steps = np.abs(np.diff(values))
    steps = steps[steps > _ROUNDING * np.abs(values).max(initial=0.0)]
    return float(steps.min(initial=np.inf))
