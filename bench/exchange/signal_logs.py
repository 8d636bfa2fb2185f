"""Logs of named signals, each with its times: Parquet, BLF and MF4, ArduPilot and PX4.

A log is read at the times of the first requested column; other columns have their last value at that time, or
the value logged with it if both belong to one sample.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrobench.bench.exchange.import_map import Column, SignalFormat
from gyrobench.bench.exchange.log_files import Batch
from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.foundations.errors import DocumentError, MissingPackageError
from gyrobench.bench.foundations.packages import require
from gyrobench.bench.foundations.text import did_you_mean
from gyrobench.bench.runs.can_log import read_blf
from gyrobench.drivers.frames import EXTENDED_ID, MAX_LENGTH, FrameBlock, concatenate
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc

#: Pseudo-column with the times of the samples, s.
_TIME_COLUMN = "time_s"
_S_PER_US = 1e-6
#: Name of data frames of a CAN bus in the ASAM standard.
_DATA_FRAMES = "CAN_DataFrame"
_MAX_STANDARD_ID = 0x7FF
_MAX_BYTES = 4_000_000_000

#: Columns belong to one sample if at least this share of their values can be paired.
_MIN_PAIRED = 0.9


@dataclass(frozen=True, eq=False)
class _Stamps:
    """Times and order in which the values of a signal were logged."""

    time_s: FloatArray
    #: Index of each value in the log; ``time_s`` if the log does not keep the order of its messages.
    order: FloatArray | IntArray


#: Stamps and values of a group of signals that are sampled together.
Group = tuple[_Stamps, Mapping[str, NDArray[Any]]]


class NoFramesError(DocumentError):
    """A CAN log has no frame of a message of the DBC file, as while the unit does not send it."""


class SignalLog:
    """A log of named signals; ``columns`` lists them, and ``truncated`` states whether its end was left out.

    ``one_sample`` are columns whose values belong to one sample although they are in separate messages.
    ``complete``: whether a sample without a value of one of them has NaN for it, as for increments, which
    must not be repeated; otherwise it has the last value.

    Raises DocumentError if the file can't be read or has no signal, and MissingPackageError if the package
    that reads it is not installed.
    """

    def __init__(
        self, path: Path, layout: SignalFormat, one_sample: Collection[Column] = (), complete: bool = False
    ) -> None:
        self._path = path
        self._one_sample, self._complete = one_sample, complete
        self.truncated = False
        readers: dict[str, Callable[[Path], Iterable[Group]]] = {
            "parquet": _parquet,
            "blf": partial(_can_signals, self._blf_frames, Path(layout.dbc or "")),
            "mf4": partial(_can_signals, _mf4_frames, Path(layout.dbc)) if layout.dbc else _mf4_channels,
            "ardupilot": _ardupilot,
            "px4": _px4,
        }
        try:
            if path.is_file() and path.stat().st_size > _MAX_BYTES:
                raise DocumentError(f"{path}: {path.stat().st_size} bytes; at most {_MAX_BYTES} are read")
            groups = list(readers[layout.format](path))
        except (DocumentError, MissingPackageError):
            raise
        except OSError as error:
            raise DocumentError(f"{path}: can't be read: {error.strerror or error}") from error
        except Exception as error:
            raise DocumentError(f"{path}: is no {layout.format} log, or damaged: {error}") from error
        #: Units by column, as far as the log or its DBC file states them.
        self.units: dict[Column, str] = _units(path, layout)
        signals = {name: (stamps, values) for stamps, group in groups for name, values in group.items()}
        self._without_frames = {name for name, each in signals.items() if layout.dbc and not len(each[1])}
        self._signals = {name: each for name, each in signals.items() if name not in self._without_frames}
        self.columns = [*self._signals]
        if not self.columns:
            raise DocumentError(f"{path}: holds no signal. Was the logger running?")

    def batches(self, numbers: Sequence[Column], texts: Sequence[Column]) -> Iterator[Batch]:
        """Read columns, all in one batch; :data:`_TIME_COLUMN` stands for the times of the first one.

        Raises DocumentError if there is no such signal, or one among ``numbers`` holds text.
        """
        base = next(self._signal(column)[0] for column in numbers if column != _TIME_COLUMN)
        batch: Batch = {}
        for column in (*numbers, *texts):
            if column == _TIME_COLUMN and column not in self._signals:
                batch[column] = base.time_s
                continue
            stamps, values = self._signal(column)
            indices = np.searchsorted(stamps.time_s, base.time_s, side="right") - 1
            if column in self._one_sample:
                indices = self._paired(base, stamps, indices)
            if column in texts:
                batch[column] = np.where(indices >= 0, values.astype(str)[indices], "")
            else:
                batch[column] = np.where(indices >= 0, self._as_numbers(column, values)[indices], np.nan)
        yield batch

    def _paired(self, base: _Stamps, stamps: _Stamps, latest: IntArray) -> IntArray:
        """Indices of the values for the samples of ``base``, -1 for none; ``latest`` if not paired."""
        pairs = _pair_messages(base, stamps)
        is_paired = pairs >= 0
        if is_paired.sum() < _MIN_PAIRED * max(len(base.order), len(stamps.order)):
            return latest
        return pairs if self._complete else np.where(is_paired, pairs, latest)

    def _as_numbers(self, column: Column, values: NDArray[Any]) -> FloatArray:
        try:
            return np.asarray(values.astype(np.float64))
        except (TypeError, ValueError) as error:
            raise DocumentError(
                f"{self._path}: signal '{column}' is no number throughout ({error}). Correct the import map"
            ) from error

    def _blf_frames(self, path: Path) -> FrameBlock:
        frames, is_whole = read_blf(path.read_bytes())
        self.truncated = not is_whole
        return frames

    def _signal(self, column: Column) -> tuple[_Stamps, NDArray[Any]]:
        """Stamps and values of a signal; raises DocumentError if the log lacks it."""
        name = self.columns[column - 1] if isinstance(column, int) and column <= len(self.columns) else column
        if name in self._without_frames:
            message = str(name).partition(".")[0]
            raise NoFramesError(
                f"{self._path}: has no frame of {message}. Choose a log in which the unit sends it"
            )
        if name not in self._signals:
            raise DocumentError(
                f"{self._path}: there is no signal '{column}'{did_you_mean(str(column), self.columns)}. "
                f"It has {', '.join(self.columns[:40])}. Correct the import map"
            )
        return self._signals[str(name)]


def _pair_messages(base: _Stamps, other: _Stamps) -> IntArray:
    """Index of the value of another message for each of ``base``; -1 if there is none before the next one.

    The other message follows or precedes in the log, whichever has the smaller median delay.
    """
    count = len(other.order)
    if np.array_equal(base.order, other.order):
        return np.arange(count)
    following = np.searchsorted(other.order, base.order, side="left")
    pairs, delays_s = [], []
    for indices, is_unique in (
        (following, np.append(following[1:] > following[:-1], True) & (following < count)),
        (following - 1, np.append(True, following[1:] > following[:-1]) & (following > 0)),
    ):
        delay_s = np.abs(other.time_s[np.clip(indices, 0, count - 1)] - base.time_s)
        pairs.append(np.where(is_unique, indices, -1))
        delays_s.append(float(np.median(delay_s[is_unique])) if is_unique.any() else np.inf)
    return pairs[int(delays_s[1] < delays_s[0])]


def _parquet(path: Path) -> Iterable[Group]:
    """Columns of a file, or of all parts in a folder; the time of a value is its row."""
    from pyarrow import parquet

    table = parquet.read_table(path)
    rows = np.arange(table.num_rows, dtype=np.float64)
    columns = {name: table.column(name).to_numpy() for name in table.column_names}
    return [(_Stamps(rows, rows), columns)]


def _units(path: Path, layout: SignalFormat) -> dict[Column, str]:
    """Units of signals by column; ``{}`` for formats without."""
    if layout.dbc:
        messages = load_dbc(Path(layout.dbc)).messages
        return {
            f"{each.name}.{signal.name}": signal.unit or "" for each in messages for signal in each.signals
        }
    if layout.format != "parquet" or path.is_dir():
        return {}
    from pyarrow import parquet

    fields = parquet.read_schema(path)
    return {each.name: (each.metadata or {}).get(b"unit", b"").decode(errors="replace") for each in fields}


def _can_signals(read_frames: Callable[[Path], FrameBlock], dbc: Path, path: Path) -> Iterable[Group]:
    """Signals of the DBC file in the frames of a CAN log, as MESSAGE.SIGNAL; also those without a frame."""
    codec, block = DbcCodec(load_dbc(dbc)), read_frames(path).data_frames()
    for message in codec.message_names:
        rows = codec.rows(block, message)
        frames = block.take(rows)
        payloads, stamps = codec.payloads(block, rows), _Stamps(frames.timestamp_s, rows)
        for name, values in codec.decode(frames, message).items():
            if codec.signal(message, name).multiplexer_ids is None:
                yield stamps, {f"{message}.{name}": values}
                continue
            is_sent = codec.selected(payloads, message, name)
            stamps_sent = _Stamps(frames.timestamp_s[is_sent], rows[is_sent])
            yield stamps_sent, {f"{message}.{name}": values[is_sent]}


def _mf4_frames(path: Path) -> FrameBlock:
    """Data frames of all groups, such as several buses, in the order of time, without CAN FD frames."""
    with require("asammdf").MDF(path) as log:
        blocks = [_mf4_block(log.get(group=group, index=index)) for group, index in log.whereis(_DATA_FRAMES)]
    return concatenate(blocks).in_order()


def _mf4_block(frames: Any) -> FrameBlock:
    """Frames of one group."""
    columns = {name.rpartition(".")[2]: frames.samples[name] for name in frames.samples.dtype.names}
    identifiers = columns["ID"].astype(np.uint32)
    is_extended = columns.get("IDE", identifiers > _MAX_STANDARD_ID).astype(np.bool_)
    length = columns.get("DataLength", columns["DLC"])
    size = min(columns["DataBytes"].shape[1], MAX_LENGTH)
    data = np.zeros((len(length), MAX_LENGTH), np.uint8)
    data[:, :size] = columns["DataBytes"][:, :size]
    identifiers |= np.where(is_extended, np.uint32(EXTENDED_ID), np.uint32(0))
    is_short = length <= MAX_LENGTH
    return FrameBlock.from_columns(frames.timestamps, identifiers, length, data).take(is_short)


def _mf4_channels(path: Path) -> Iterable[Group]:
    with require("asammdf").MDF(path) as log:
        return [
            (_Stamps(signal.timestamps, signal.timestamps), {signal.name: signal.samples})
            for signal in log.iter_channels()
        ]


def _ardupilot(path: Path) -> Iterable[Group]:
    """Messages of a DataFlash log, as MESSAGE.FIELD."""
    reader = require("pymavlink.DFReader").DFReader_binary(str(path))
    messages: dict[str, list[dict[str, Any]]] = {}
    while (message := reader.recv_msg()) is not None:
        fields = message.to_dict()
        if "TimeUS" in fields:
            kind, instance = message.get_type(), fields.get("I", fields.get("Instance", 0))
            messages.setdefault(kind if not instance else f"{kind}[{instance}]", []).append(fields)
    reader.close()
    groups: list[Group] = []
    for kind, rows in messages.items():
        columns = {f"{kind}.{name}": np.array([row[name] for row in rows]) for name in rows[0]}
        groups.append((_stamps_us(columns[f"{kind}.TimeUS"]), columns))
    return groups


def _px4(path: Path) -> Iterable[Group]:
    """Topics of a ULog file, as topic.field."""
    with path.open("rb") as stream:
        log = require("pyulog").ULog(stream)
    return [
        (
            _stamps_us(data.data["timestamp"]),
            {
                f"{data.name}{f'[{data.multi_id}]' if data.multi_id else ''}.{name}": values
                for name, values in data.data.items()
            },
        )
        for data in log.data_list
    ]


def _stamps_us(times_us: NDArray[Any]) -> _Stamps:
    times_s = times_us.astype(np.float64) * _S_PER_US
    return _Stamps(times_s, times_s)
