"""Quantities of the INS at given moments: the last values received before each moment."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.attitude import (
    EulerSequence,
    QuaternionFrames,
    attitude_matrices,
    quaternion_matrices,
)
from gyrobench.drivers.ins.dbc_codec import DbcCodec, Payloads
from gyrobench.drivers.ins.signal_map import BoundSignal, EulerMap, SignalMap, bind_signals


class InsMode(IntEnum):
    """Mode of the INS."""

    UNKNOWN = -1
    BOOT = 0
    STANDBY = 1
    ALIGN = 2
    NAVIGATE = 3
    FAULT = 4


class Alignment(IntEnum):
    """Progress of self-alignment."""

    UNKNOWN = -1
    NONE = 0
    COARSE = 1
    FINE = 2


class Readout(ABC):
    """Reads the quantities of a signal map at given moments.

    Each method takes the moments, shape (n,), as rows of a block of frames. It returns values in SI or
    degrees Celsius; NaN or ``UNKNOWN`` before the first value, or if the quantity is not mapped.
    """

    def __init__(self, signal_map: SignalMap, signals: Mapping[str, BoundSignal]) -> None:
        self.map = signal_map
        self.signals = signals

    @abstractmethod
    def _last_values(self, path: str, rows: IntArray) -> FloatArray:
        """Last value received of a mapped quantity at each moment, shape (n,); NaN before the first."""

    def value(self, path: str, rows: IntArray) -> FloatArray:
        """Read one quantity by its path, shape (n,)."""
        if path not in self.signals:
            return np.full(len(rows), np.nan)
        return self._last_values(path, rows)

    def values(self, paths: Sequence[str], rows: IntArray) -> FloatArray:
        """Read several quantities, shape (n, number of paths)."""
        values = np.empty((len(rows), len(paths)))
        for column, path in enumerate(paths):
            values[:, column] = self.value(path, rows)
        return values

    def velocity_enu_mps(self, rows: IntArray) -> FloatArray:
        """Read the velocity East, North, Up, shape (n, 3)."""
        return self.values(("velocity_east", "velocity_north", "velocity_up"), rows)

    def axes(self, name: str, rows: IntArray) -> FloatArray:
        """Read a quantity of the three body axes, shape (n, 3)."""
        return self.values([f"{name}.{axis}" for axis in "xyz"], rows)

    def time_s(self, rows: IntArray) -> FloatArray:
        """Read the clock of the INS, shape (n,)."""
        seconds = self.value("time_s", rows)
        return seconds + self.value("time_ns", rows) if "time_ns" in self.signals else seconds

    def mode(self, rows: IntArray) -> NDArray[np.int8]:
        """Read the :class:`InsMode`, shape (n,)."""
        values = self.value("mode", rows)
        codes = {value: self.mode_from_value(value) for value in np.unique(values).tolist()}
        modes = np.full(len(rows), InsMode.UNKNOWN, np.int8)
        for value, code in codes.items():
            modes[values == value] = code
        return modes

    def mode_from_value(self, value: float) -> InsMode:
        """Convert a value of the mode signal to :class:`InsMode`; ``UNKNOWN`` for NaN."""
        mapped = self.map.mode
        if mapped is None or math.isnan(value):
            return InsMode.UNKNOWN
        if value in mapped.fault:
            return InsMode.FAULT
        if value in mapped.navigate:
            return InsMode.NAVIGATE
        if value in mapped.align:
            return InsMode.ALIGN
        return InsMode.STANDBY if value in mapped.standby else InsMode.BOOT

    def alignment(self, rows: IntArray) -> NDArray[np.int8]:
        """Read the :class:`Alignment`, shape (n,)."""
        if self.map.alignment is None:
            return np.full(len(rows), Alignment.UNKNOWN, np.int8)
        codes: dict[int, list[int]] = {
            Alignment.COARSE: self.map.alignment.coarse,
            Alignment.FINE: self.map.alignment.fine,
        }
        return _decode_states(self.value("alignment", rows), codes, Alignment.NONE)

    def attitude(self, rows: IntArray) -> FloatArray:
        """Read ``C_nb``, shape (n, 3, 3)."""
        if self.map.attitude.euler is not None:
            matrices = self._from_euler(self.map.attitude.euler, rows)
        else:
            matrices = self._from_quaternion(rows)
        if "attitude.valid" in self.signals:
            matrices[self.value("attitude.valid", rows) == 0.0] = np.nan
        return matrices

    def euler_sequence(self, rows: IntArray) -> NDArray[np.int8]:
        """Read the index into ``list(EulerSequence)``, shape (n,); -1 if it is unknown or not mapped."""
        euler = self.map.attitude.euler
        sequences = list(EulerSequence)
        if euler is not None and euler.sequence.fixed is not None:
            return np.full(len(rows), sequences.index(EulerSequence(euler.sequence.fixed)), np.int8)
        codes = (
            {index: [getattr(euler.sequence, name)] for index, name in enumerate(sequences)} if euler else {}
        )
        return _decode_states(self.value("attitude.euler.sequence", rows), codes, -1)

    def _from_euler(self, euler: EulerMap, rows: IntArray) -> FloatArray:
        roll, pitch, yaw = self.values([f"attitude.euler.{n}" for n in ("roll", "pitch", "yaw")], rows).T
        if euler.yaw_positive == "down":
            yaw = -yaw
        matrices = np.full((len(rows), 3, 3), np.nan)
        sequence = self.euler_sequence(rows)
        for index, name in enumerate(EulerSequence):
            has_sequence = sequence == index
            if has_sequence.all():
                return attitude_matrices(name, roll, pitch, yaw)
            if has_sequence.any():
                matrices[has_sequence] = attitude_matrices(
                    name, roll[has_sequence], pitch[has_sequence], yaw[has_sequence]
                )
        return matrices

    def _from_quaternion(self, rows: IntArray) -> FloatArray:
        assert self.map.attitude.quaternion is not None  # noqa: S101 - the map has one of the two
        frames = QuaternionFrames(self.map.attitude.quaternion.frames)
        return quaternion_matrices(frames, *self.values([f"attitude.quaternion.{n}" for n in "wxyz"], rows).T)


def _decode_states(
    values: FloatArray, raw_values: Mapping[int, Sequence[int]], default: int
) -> NDArray[np.int8]:
    """Code of each value, by the raw values of each code; ``default`` for other values, -1 for NaN."""
    if len(values) == 1:  # the present state, for which array operations are slow
        (value,) = values.tolist()
        matches = [code for code, raw in raw_values.items() if value in raw] or [default]
        return np.array([-1 if math.isnan(value) else matches[-1]], np.int8)
    codes = np.full(len(values), default, np.int8)
    for code, raw in raw_values.items():
        for each in raw:
            codes[values == each] = code
    codes[np.isnan(values)] = -1
    return codes


class BlockReadout(Readout):
    """Reads the quantities in one block; a signal is decoded when it is first read.

    Raises DocumentError if the signal map does not fit the DBC.
    """

    def __init__(self, block: FrameBlock, signal_map: SignalMap, codec: DbcCodec) -> None:
        super().__init__(signal_map, bind_signals(signal_map, codec))
        self.block = block
        self.codec = codec
        self._messages: dict[str, tuple[IntArray, Payloads]] = {}
        #: By message: the rows last read, and the result of :func:`_newest` for them. The signals of a
        #: message are mostly read one after the other, at the same rows.
        self._newest_by_message: dict[str, tuple[IntArray, IntArray | None]] = {}

    def rows(self, message: str) -> IntArray:
        """Row indices of the frames of a message in the block."""
        return self._message(message)[0]

    def rows_with(self, bound: BoundSignal) -> IntArray:
        """Row indices of the frames that have a signal."""
        rows, payloads = self._message(bound.message)
        if bound.signal.multiplexer_ids is None:
            return rows
        return rows[self.codec.selected(payloads, bound.message, bound.signal.name)]

    def message_of(self, path: str) -> str | None:
        """Message with a quantity; None if it is not mapped."""
        return self.signals[path].message if path in self.signals else None

    def last_rows(self, prefixes: str | tuple[str, ...]) -> IntArray:
        """Rows of the page sent last with the quantities whose paths begin so; empty if none is mapped."""
        signals = [bound for path, bound in self.signals.items() if path.startswith(prefixes)]
        if not signals:
            return np.zeros(0, np.int64)
        by_page = [(bound.arbitration_id, bound.signal.multiplexer_ids or []) for bound in signals]
        return self.rows_with(signals[by_page.index(max(by_page))])

    def modulus(self, path: str) -> float:
        """Value at which a quantity wraps; infinite if it does not."""
        return self.signals[path].modulus if path in self.signals else np.inf

    @override
    def _last_values(self, path: str, rows: IntArray) -> FloatArray:
        bound = self.signals[path]
        frames, payloads = self._message(bound.message)
        values = bound.to_si(self.codec.values(payloads, bound.message, bound.signal.name))
        if bound.signal.multiplexer_ids is not None:
            has_signal = self.codec.selected(payloads, bound.message, bound.signal.name)
            return np.append(values[has_signal], np.nan)[_newest_index(frames[has_signal], rows)]
        if rows is frames:
            return values
        cached_rows, newest = self._newest_by_message.get(bound.message, (None, None))
        if cached_rows is not rows:
            newest = _newest(frames, rows)
            self._newest_by_message[bound.message] = rows, newest
        # Index -1, before the first value, selects the NaN appended at the end.
        return values if newest is None else np.append(values, np.nan)[newest]

    def _message(self, message: str) -> tuple[IntArray, Payloads]:
        if message not in self._messages:
            rows = self.codec.rows(self.block, message)
            self._messages[message] = rows, self.codec.payloads(self.block, rows)
        return self._messages[message]


def _newest(frames: IntArray, rows: IntArray) -> IntArray | None:
    """Index of the newest frame at each row, -1 before the first; None if each row has a separate frame."""
    if len(frames) == len(rows) and (frames <= rows).all() and (rows[:-1] < frames[1:]).all():
        return None
    return _newest_index(frames, rows)


def _newest_index(frames: IntArray, rows: IntArray) -> IntArray:
    """Index of the newest frame at each row, -1 before the first."""
    return np.searchsorted(frames, rows, side="right") - 1
