"""Quantities of the INS at given moments: the last values that had arrived."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.attitude import (
    EulerSequence,
    QuaternionFrames,
    attitude_matrices,
    quaternion_matrices,
)
from gyrobench.drivers.ins.dbc_codec import DbcCodec, Payloads
from gyrobench.drivers.ins.signal_map import BoundSignal, EulerMap, SignalMap


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


class Reader(Protocol):
    """Source of the values of bound signals."""

    def held(self, bound: BoundSignal, rows: IntArray) -> FloatArray:
        """Last value that had arrived at each moment, NaN before the first."""


class Readout:
    """Quantities of a signal map at given moments.

    Each method takes the moments, shape (n,), in the reader's units (rows of a block). It returns values
    in SI or degrees Celsius; NaN or ``UNKNOWN`` before the first value, or where nothing is mapped.
    """

    def __init__(self, reader: Reader, signal_map: SignalMap, signals: Mapping[str, BoundSignal]) -> None:
        self.map = signal_map
        self.signals = signals
        self._reader = reader

    def value(self, path: str, rows: IntArray) -> FloatArray:
        """Read one quantity by its path, shape (n,)."""
        if path not in self.signals:
            return np.full(len(rows), np.nan)
        return self._reader.held(self.signals[path], rows)

    def values(self, paths: Sequence[str], rows: IntArray) -> FloatArray:
        """Read several quantities side by side, shape (n, number of paths)."""
        found = np.empty((len(rows), len(paths)))
        for place, path in enumerate(paths):
            found[:, place] = self.value(path, rows)
        return found

    def velocity_enu_mps(self, rows: IntArray) -> FloatArray:
        """Read the velocity, shape (n, 3)."""
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
        codes = {value: self.mode_of(value) for value in np.unique(values).tolist()}
        found = np.full(len(rows), InsMode.UNKNOWN, np.int8)
        for value, code in codes.items():
            found[values == value] = code
        return found

    def mode_of(self, value: float) -> InsMode:
        """The :class:`InsMode` for a value of its signal, which may be NaN."""
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
        return _coded(self.value("alignment", rows), codes, Alignment.NONE)

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
        """Read the index into ``list(EulerSequence)``; -1 where it is unknown or there is none."""
        euler = self.map.attitude.euler
        sequences = list(EulerSequence)
        if euler is not None and euler.sequence.fixed is not None:
            return np.full(len(rows), sequences.index(EulerSequence(euler.sequence.fixed)), np.int8)
        codes = (
            {index: [getattr(euler.sequence, name)] for index, name in enumerate(sequences)} if euler else {}
        )
        return _coded(self.value("attitude.euler.sequence", rows), codes, -1)

    def _from_euler(self, euler: EulerMap, rows: IntArray) -> FloatArray:
        roll, pitch, yaw = self.values([f"attitude.euler.{n}" for n in ("roll", "pitch", "yaw")], rows).T
        if euler.yaw_positive == "down":
            yaw = -yaw
        matrices = np.full((len(rows), 3, 3), np.nan)
        sequence = self.euler_sequence(rows)
        for index, name in enumerate(EulerSequence):
            chosen = sequence == index
            if chosen.all():
                return attitude_matrices(name, roll, pitch, yaw)
            if chosen.any():
                matrices[chosen] = attitude_matrices(name, roll[chosen], pitch[chosen], yaw[chosen])
        return matrices

    def _from_quaternion(self, rows: IntArray) -> FloatArray:
        assert self.map.attitude.quaternion is not None  # noqa: S101 - the map has one of the two
        frames = QuaternionFrames(self.map.attitude.quaternion.frames)
        return quaternion_matrices(frames, *self.values([f"attitude.quaternion.{n}" for n in "wxyz"], rows).T)


def _coded(values: FloatArray, meanings: Mapping[int, Sequence[int]], other: int) -> NDArray[np.int8]:
    if len(values) == 1:  # the present state, for which array operations are slow
        (value,) = values.tolist()
        found = [code for code, raw in meanings.items() if value in raw] or [other]
        return np.array([-1 if math.isnan(value) else found[-1]], np.int8)
    codes = np.full(len(values), other, np.int8)
    for code, raw in meanings.items():
        for each in raw:
            codes[values == each] = code
    codes[np.isnan(values)] = -1
    return codes


class BlockReader:
    """Values of bound signals in one block, each decoded when it is asked for."""

    def __init__(self, block: FrameBlock, codec: DbcCodec) -> None:
        self.block = block
        self.codec = codec
        self._messages: dict[str, tuple[IntArray, Payloads]] = {}
        #: By message, the rows last asked for and :func:`_newest` there: its signals are read together.
        self._places: dict[str, tuple[IntArray, IntArray | None]] = {}

    def rows(self, message: str) -> IntArray:
        """Rows of the block with frames of a message."""
        return self._message(message)[0]

    def held(self, bound: BoundSignal, rows: IntArray) -> FloatArray:
        """Last value that had arrived at each row of the block; NaN before the first."""
        frames, payloads = self._message(bound.message)
        values = bound.to_si(self.codec.values(payloads, bound.message, bound.signal.name))
        if rows is frames:
            return values
        asked, places = self._places.get(bound.message, (None, None))
        if asked is not rows:
            places = _newest(frames, rows)
            self._places[bound.message] = rows, places
        # Index -1, before the first value, is the NaN at the end.
        return values if places is None else np.append(values, np.nan)[places]

    def _message(self, message: str) -> tuple[IntArray, Payloads]:
        if message not in self._messages:
            rows = self.codec.rows(self.block, message)
            self._messages[message] = rows, self.codec.payloads(self.block, rows)
        return self._messages[message]


def _newest(frames: IntArray, rows: IntArray) -> IntArray | None:
    """Index of the newest frame at each row, -1 before the first; None where each row has its own."""
    if len(frames) == len(rows) and (frames <= rows).all() and (rows[:-1] < frames[1:]).all():
        return None
    return np.searchsorted(frames, rows, side="right") - 1
