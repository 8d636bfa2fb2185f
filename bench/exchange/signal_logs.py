"""Logs whose signals have names and times of their own: Parquet, BLF and MF4, ArduPilot and PX4.

A log is read at the times of the first column that is asked for; of the others the last value counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyrobench.bench.exchange.import_map import Column, SignalFormat
from gyrobench.bench.exchange.log_files import Batch
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import DocumentError, MissingPackageError
from gyrobench.bench.foundations.packages import require
from gyrobench.bench.foundations.text import did_you_mean
from gyrobench.bench.runs.can_log import read_blf
from gyrobench.drivers.frames import EXTENDED_ID, MAX_LENGTH, FrameBlock, concatenate
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc

#: In place of a column: the times of the samples, s.
TIME_COLUMN = "time_s"
_S_PER_US = 1e-6
#: Name that the standard of ASAM gives data frames of a CAN bus.
_FRAMES = "CAN_DataFrame"
_MAX_STANDARD_ID = 0x7FF
_MAX_BYTES = 4_000_000_000

#: Times and values of a group of signals that are sampled together.
Group = tuple[FloatArray, Mapping[str, NDArray[Any]]]


class SignalLog:
    """A log of named signals; ``columns`` lists them, and ``truncated`` states whether its end was left out.

    Raises DocumentError if the file can't be read or has no signal, and MissingPackageError if the package
    that reads it is not installed.
    """

    def __init__(self, path: Path, layout: SignalFormat) -> None:
        self._path = path
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
        self._signals = {name: (times, values) for times, group in groups for name, values in group.items()}
        self.columns = [*self._signals]
        if not self.columns:
            raise DocumentError(f"{path}: holds no signal. Was the logger running?")

    def batches(self, numbers: Sequence[Column], texts: Sequence[Column]) -> Iterator[Batch]:
        """Read columns, all in one batch; :data:`TIME_COLUMN` stands for the times of the first one.

        Raises DocumentError if there is no such signal, or one among ``numbers`` holds text.
        """
        base_s = next(self._signal(column)[0] for column in numbers if column != TIME_COLUMN)
        batch: Batch = {}
        for column in (*numbers, *texts):
            if column == TIME_COLUMN and column not in self._signals:
                batch[column] = base_s
                continue
            times_s, values = self._signal(column)
            places = np.searchsorted(times_s, base_s, side="right") - 1
            if column in texts:
                batch[column] = np.where(places >= 0, values.astype(str)[places], "")
            else:
                batch[column] = np.where(places >= 0, self._numbers(column, values)[places], np.nan)
        yield batch

    def _numbers(self, column: Column, values: NDArray[Any]) -> FloatArray:
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

    def _signal(self, column: Column) -> tuple[FloatArray, NDArray[Any]]:
        name = self.columns[column - 1] if isinstance(column, int) and column <= len(self.columns) else column
        if name not in self._signals:
            raise DocumentError(
                f"{self._path}: there is no signal '{column}'{did_you_mean(str(column), self.columns)}. "
                f"It has {', '.join(self.columns[:40])}. Correct the import map"
            )
        return self._signals[str(name)]


def _parquet(path: Path) -> Iterable[Group]:
    """Columns of a file, or of all parts in a folder, by rows."""
    from pyarrow import parquet

    table = parquet.read_table(path)
    rows = np.arange(table.num_rows, dtype=np.float64)
    columns = {name: table.column(name).to_numpy() for name in table.column_names}
    return [(rows, columns)]


def _can_signals(read_frames: Callable[[Path], FrameBlock], dbc: Path, path: Path) -> Iterable[Group]:
    """Signals of the DBC file in the frames of a CAN log, as MESSAGE.SIGNAL."""
    codec, block = DbcCodec(load_dbc(dbc)), read_frames(path).data_frames()
    for message in codec.message_names:
        frames = block.take(codec.rows(block, message))
        if len(frames):
            decoded = codec.decode(frames, message)
            yield frames.timestamp_s, {f"{message}.{name}": values for name, values in decoded.items()}


def _mf4_frames(path: Path) -> FrameBlock:
    """Data frames of all groups, as of several buses, in the order of time; those of FD are left out."""
    with require("asammdf").MDF(path) as log:
        blocks = [_mf4_block(log.get(group=group, index=index)) for group, index in log.whereis(_FRAMES)]
    frames = concatenate(blocks)
    return frames.take(np.argsort(frames.timestamp_s, kind="stable"))


def _mf4_block(frames: Any) -> FrameBlock:
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
        return [(signal.timestamps, {signal.name: signal.samples}) for signal in log.iter_channels()]


def _ardupilot(path: Path) -> Iterable[Group]:
    """Messages of a DataFlash log, as MESSAGE.FIELD."""
    reader = require("pymavlink.DFReader").DFReader_binary(str(path))
    found: dict[str, list[dict[str, Any]]] = {}
    while (message := reader.recv_msg()) is not None:
        fields = message.to_dict()
        if "TimeUS" in fields:
            kind, instance = message.get_type(), fields.get("I", fields.get("Instance", 0))
            found.setdefault(kind if not instance else f"{kind}[{instance}]", []).append(fields)
    reader.close()
    groups: list[Group] = []
    for kind, rows in found.items():
        columns = {f"{kind}.{name}": np.array([row[name] for row in rows]) for name in rows[0]}
        groups.append((columns[f"{kind}.TimeUS"].astype(np.float64) * _S_PER_US, columns))
    return groups


def _px4(path: Path) -> Iterable[Group]:
    """Topics of a ULog file, as topic.field."""
    with path.open("rb") as stream:
        log = require("pyulog").ULog(stream)
    return [
        (
            data.data["timestamp"].astype(np.float64) * _S_PER_US,
            {
                f"{data.name}{f'[{data.multi_id}]' if data.multi_id else ''}.{name}": values
                for name, values in data.data.items()
            },
        )
        for data in log.data_list
    ]
