"""Columns of a log as quantities, and their means over windows.

Body axes, deg/h, degC, seconds since the first sample. The unit is at rest in each window.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

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
#: ``force_x``, ``position`` (index in POSITIONS), ``cycle``; NaN where not measured.
Samples = dict[str, FloatArray]

RATES = tuple(f"rate_{axis}" for axis in AXES)
FORCES = tuple(f"force_{axis}" for axis in AXES)

#: Larger values and times count as NaN: no sensor measures them, no log is as long.
_MAX_VALUE, _MAX_TIME_S = 1e15, 1e12

#: First bytes of logs of signals, by their format in an import map.
_SIGNATURES = {"blf": b"LOGG", "parquet": b"PAR1", "mf4": b"MDF ", "px4": b"ULog"}
#: How many are read to recognise a format.
_FIRST_BYTES = 1024
_TO_DPH = {"rad/s": RADPS_TO_DPH, "deg/s": 3600.0, "dps": 3600.0, "deg/h": 1.0, "arcsec/s": 1.0}
_PREFIXES = {"m": 1e-3, "u": 1e-6}
_TO_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "iso8601": 1.0}
#: A calendar time in float64 is rounded to less; a sample this close before a window belongs to it.
_TIME_RESOLUTION_S = 1e-6


def _check_kind(path: Path, expected: str) -> None:
    """Raise DocumentError for a log, by its first bytes, that the import map takes for one of signals.

    And for one of signals that the map takes for another. Logs that are not known by their first bytes pass.
    """
    try:
        with path.open("rb") as file:
            first = file.read(_FIRST_BYTES)
    except OSError:  # reading it says why
        return
    kind = next((name for name, begin in _SIGNATURES.items() if first.startswith(begin)), "")
    if not kind and expected and first and b"\0" not in first:  # headers of logs of signals have zeros
        kind = "text"
    if kind not in ("", expected):
        read_as = f"'signals: {{format: {expected}}}'" if expected else "text or records"
        raise DocumentError(
            f"{path}: is a log of format {kind}, which the import map reads as {read_as}. Choose the map of "
            "this log with --map"
        )


class SampleReader:
    """Reads one log by its import map, and counts samples left out for their status or without a time.

    ``quantities`` replaces those of the import map, in units of the caller, and leaves the position out; a
    sample has the values that were logged together. ``increments``: it is invalid without one of them.

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
        _check_kind(path, log_map.signals.format if log_map.signals else "")
        self._log: RecordLog | SignalLog | TextLog
        if log_map.records:
            self._log = RecordLog(path, log_map.records)
        elif log_map.signals:
            one_sample = {column for column, _, _ in (quantities or {}).values()}
            self._log = SignalLog(path, log_map.signals, one_sample, increments)
        else:
            self._log = TextLog(path, log_map.text or TextFormat())
        self._quantities = quantities or _quantities(log_map)
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
        is_calendar = self._map.time.unit == "iso8601"
        if time is not None:
            (texts if is_calendar else numbers).append(time)
        for batch in self._log.batches(numbers, texts):
            samples = self._samples(batch)
            count = len(samples[RATES[0]])
            if time is None:
                time_s = (self._read + np.arange(count)) / (self._map.time.sample_rate_hz or 1.0)
            else:
                raw = self._calendar_s(batch[time]) if is_calendar else batch[time]
                if origin is None and np.isfinite(raw).any():
                    origin = float(raw[np.isfinite(raw)][0])
                    self.first_s = origin * _TO_SECONDS[self._map.time.unit]
                with np.errstate(over="ignore"):
                    time_s = (raw - (origin or 0.0)) * _TO_SECONDS[self._map.time.unit]
            known = np.abs(time_s) <= _MAX_TIME_S
            self.no_time += int(count - known.sum())
            self._read += count
            samples = {name: values[known] for name, values in samples.items()}
            samples["time_s"] = time_s[known]
            self._check_order(samples["time_s"], last_s)
            if known.any():
                last_s = float(samples["time_s"][-1])
            yield samples

    def whole(self) -> Samples:
        """Read the whole log, see :meth:`batches`."""
        batches = list(self.batches())
        return {name: np.concatenate([each[name] for each in batches]) for name in batches[0]}

    def _calendar_s(self, texts: NDArray[Any]) -> FloatArray:
        """Times of ISO 8601 texts, s; NaN for an empty one. Those without an offset are in UTC."""
        times_s = np.full(len(texts), np.nan)
        for index, text in enumerate(texts.tolist()):
            if not text:
                continue
            try:
                moment = datetime.fromisoformat(text.strip())
            except ValueError as error:
                raise DocumentError(
                    f"{self._path}: column {self._map.time.column} holds '{text[:60]}', which is no time by "
                    "ISO 8601. Correct 'time.unit' in the import map"
                ) from error
            times_s[index] = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
        return times_s

    def _samples(self, batch: Batch) -> Samples:
        samples = {
            name: _measured(name, batch[column], scale, offset)
            for name, (column, scale, offset) in self._quantities.items()
        }
        status, position = self._map.status, self._position
        if status is not None:
            valid = np.isin(_words(batch[status.column]), [_word(str(each)) for each in status.good])
            self.bad_status += int((~valid).sum())
            for name in RATES:
                samples[name] = np.where(valid, samples[name], np.nan)
        if position is not None and position.column is not None:
            samples["position"] = self._positions(position, batch[position.column])
        return samples

    def _positions(self, rule: PositionRule, texts: NDArray[np.str_]) -> FloatArray:
        names, which = np.unique(_words(texts), return_inverse=True)
        values = {_word(text): name for text, name in rule.values.items()}
        unknown = [name for name in names if name and name not in values]
        if unknown:
            raise DocumentError(
                f"{self._path}: column {rule.column} holds '{unknown[0]}', which is none of "
                f"{', '.join(values)}. Add it to 'position.values' in the import map"
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
                "'time: {sample_rate_hz: ...}' in the import map"
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
    """Column, scale and offset of each number that is read."""
    gyro, (temperatures, position, _) = log_map.gyro, log_map.averages
    quantities = gyro.by_quantity(RATES, _rate_dph(gyro.unit)) | temperatures.by_quantity()
    if position.accelerometers is not None:
        quantities |= position.accelerometers.by_quantity(FORCES)
    if log_map.cycle.column is not None:
        quantities["cycle"] = (log_map.cycle.column, 1.0, 0.0)
    return quantities


def _measured(name: str, raw: FloatArray, scale: float, offset: float) -> FloatArray:
    """Values of a quantity; NaN for impossible values."""
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


def _words(texts: NDArray[Any]) -> NDArray[np.str_]:
    """Normalised texts, which compare equal if they mean the same."""
    unique, which = np.unique(texts.astype(str), return_inverse=True)
    return np.array([_word(text) for text in unique], dtype=str)[which]


def _word(text: str) -> str:
    """Text without blanks around it; a number in its shortest form: ``0.0`` becomes ``0``."""
    try:
        return f"{float(text):g}"
    except ValueError:
        return text.strip()


#: Into how many blocks a window may be cut, whose means show the noise; each half of the one before.
BLOCKS = (40, 20, 10, 5)
#: Samples that a window needs.
MIN_WINDOW_SAMPLES = 10
#: Smallest step that is no rounding error, relative to the largest value.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class Window:
    """Means of one window."""

    #: start_s, end_s: Since the first sample of the log.
    start_s: float
    end_s: float
    #: samples, dropped: Samples with all three rates, and those without.
    samples: int
    dropped: int
    max_step_s: float  #: Longest time between two samples, also to the last one before the window.
    covered_s: float  #: From the first to the last sample.
    rate_dph: FloatArray  #: Shape (3,). Mean rates.
    scatter_dph: FloatArray  #: Shape (3,). Standard deviation of the samples.
    #: Shape (blocks, 3). Mean rates of as many equal parts as :data:`BLOCKS` allows, in the order of time.
    blocks_dph: FloatArray
    #: Shape (3,). Smallest change from one sample to the next; infinite where there is none.
    rate_step_dph: FloatArray
    #: extreme_dph, max_samples_at_extreme: Shape (3,). Largest absolute rate, and longest series of samples
    #: with it.
    extreme_dph: FloatArray
    max_samples_at_extreme: NDArray[np.intp]
    max_samples_unchanged: NDArray[np.intp]  #: Shape (3,). Longest series of samples with a constant rate.
    #: means, slopes_per_h, steps, spans: Of temperatures, and of position and cycle: mean, slope, smallest
    #: change, and largest less smallest value. NaN where not measured.
    means: dict[str, float]
    slopes_per_h: dict[str, float]
    steps: dict[str, float]
    spans: dict[str, float]
    force: FloatArray  #: Shape (3,). Mean of the accelerometers; NaN if the import map names none.


def cut_windows(batches: Iterable[Samples], window_s: float, skip_s: float) -> Iterator[Window]:
    """Cut a log into windows; those with too few valid samples have NaN for all means.

    Too few are less than :data:`MIN_WINDOW_SAMPLES`. No more than a batch and a window are held at a time.
    """
    rest: Samples = {}
    before_s = np.nan
    for batch in batches:
        late = batch["time_s"] >= skip_s - _TIME_RESOLUTION_S
        kept = {name: values[late] for name, values in batch.items()}
        rest = {name: np.concatenate([rest[name], kept[name]]) for name in kept} if rest else kept
        index = _window_index(rest["time_s"], window_s, skip_s)
        if index.size == 0 or index[0] == index[-1]:
            continue
        begin_of_last = int(np.searchsorted(index, index[-1]))
        for part in _parts(rest, index, 0, begin_of_last):
            yield _window(part, window_s, skip_s, before_s)
            before_s = float(part["time_s"][-1])
        rest = {name: values[begin_of_last:] for name, values in rest.items()}
    if rest and rest["time_s"].size:
        yield _window(rest, window_s, skip_s, before_s)


def max_consecutive(same: BoolArray) -> int:
    """Longest series of true values."""
    return int(np.diff(true_spans(same)).max(initial=0))


def _window_index(time_s: FloatArray, window_s: float, skip_s: float) -> NDArray[np.intp]:
    return np.asarray((time_s - skip_s + _TIME_RESOLUTION_S) // window_s, dtype=np.intp)


def _parts(samples: Samples, index: NDArray[np.intp], begin: int, end: int) -> Iterator[Samples]:
    borders = np.flatnonzero(np.diff(index[begin:end])) + 1 + begin
    for first, last in zip([begin, *borders], [*borders, end], strict=True):
        yield {name: values[first:last] for name, values in samples.items()}


def _window(samples: Samples, window_s: float, skip_s: float, before_s: float) -> Window:
    time_s = samples["time_s"]
    number = int(_window_index(time_s[:1], window_s, skip_s)[0])
    rates = np.column_stack([samples[name] for name in RATES])
    valid = np.isfinite(rates).all(axis=1)
    rates = rates[valid]
    steps = np.diff(time_s, prepend=time_s[0] if np.isnan(before_s) else before_s)
    means, slopes, smallest, spans = {}, {}, {}, {}
    for name, values in samples.items():
        if name.endswith("_c") or name in ("position", "cycle"):
            means[name], slopes[name], smallest[name], spans[name] = _trend(time_s, values)
    enough = len(rates) >= MIN_WINDOW_SAMPLES
    nothing = np.full(3, np.nan)
    return Window(
        start_s=skip_s + number * window_s,
        end_s=skip_s + (number + 1) * window_s,
        samples=len(rates),
        dropped=int(valid.size - len(rates)),
        max_step_s=float(steps.max()),
        covered_s=float(time_s[-1] - time_s[0]),
        rate_dph=rates.mean(axis=0) if enough else nothing,
        scatter_dph=rates.std(axis=0, ddof=1) if enough else nothing,
        blocks_dph=_blocks(rates) if enough else np.empty((0, 3)),
        rate_step_dph=np.array([_smallest_step(rate) for rate in rates.T]),
        extreme_dph=np.abs(rates).max(axis=0, initial=0.0),
        max_samples_at_extreme=np.array([_longest_at_extreme(rate) for rate in rates.T]),
        max_samples_unchanged=np.array([1 + max_consecutive(np.diff(rate) == 0.0) for rate in rates.T]),
        means=means,
        slopes_per_h=slopes,
        steps=smallest,
        spans=spans,
        force=np.array([_mean(samples[name]) if name in samples else np.nan for name in FORCES]),
    )


def _blocks(rates: FloatArray) -> FloatArray:
    count = next(count for count in BLOCKS if 2 * count <= len(rates))
    return np.array([block.mean(axis=0) for block in np.array_split(rates, count)])


def _trend(time_s: FloatArray, values: FloatArray) -> tuple[float, float, float, float]:
    """Mean, slope per hour, smallest step and span; NaN, NaN, infinite and NaN without values."""
    known = np.isfinite(values)
    if not known.any():
        return np.nan, np.nan, np.inf, np.nan
    time_h, known_values = (time_s[known] - time_s[known].mean()) / 3600.0, values[known]
    mean = float(known_values.mean())
    square = float(time_h @ time_h)
    slope = float(time_h @ (known_values - mean)) / square if square > 0.0 else np.nan
    return mean, slope, _smallest_step(known_values), float(np.ptp(known_values))


def _smallest_step(values: FloatArray) -> float:
    steps = np.abs(np.diff(values))
    steps = steps[steps > _ROUNDING * np.abs(values).max(initial=0.0)]
    return float(steps.min(initial=np.inf))


def _longest_at_extreme(rate: FloatArray) -> int:
    sizes = np.abs(rate)
    return max_consecutive(sizes == sizes.max(initial=0.0))


def _mean(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else np.nan
