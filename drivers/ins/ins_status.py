"""Present state of the INS, from the newest frame of each message, of a multiplexed one of each page."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from gyrobench.bench.foundations.arrays import FloatArray, IntArray, Triple
from gyrobench.bench.foundations.kernels import compiled
from gyrobench.drivers.frames import FrameBlock
from gyrobench.drivers.ins.attitude import EulerSequence
from gyrobench.drivers.ins.dbc_codec import DbcCodec
from gyrobench.drivers.ins.readout import Alignment, InsMode, Readout
from gyrobench.drivers.ins.signal_map import BoundSignal, SignalMap

#: Age from which values count as unknown, s.
STALE_S = 5.0
#: Time stamp, identifier, length and data of a row of :data:`~gyrobench.drivers.frames.FRAME_DTYPE`.
_ROW = struct.Struct("=dIB3x8s")
_NOW = np.zeros(1, np.int64)
_NEVER = -math.inf, b""


class NewestFrames:
    """The newest data frame of each identifier, of a multiplexed message of each page, with its age.

    The age of the last frame is measured on the clock of the run. The ages of the others follow from the
    time stamps of the CAN interface, whose origin is arbitrary.
    """

    def __init__(self, codec: DbcCodec) -> None:
        self._codec = codec
        #: Time stamp and data by identifier; replaced, not changed, as a status refers to it.
        self.rows: dict[int, tuple[float, bytes]] = {}
        #: The same of multiplexed messages, by identifier and page, the newest one last.
        self.pages: Mapping[int, Mapping[int, tuple[float, bytes]]] = {}
        self.received_s, self.stamp_s = -math.inf, 0.0

    def take(self, frames: FrameBlock, now_s: float) -> None:
        """Store frames that have just arrived, in order; at least one."""
        self.received_s, self.stamp_s = now_s, frames.timestamp_s.item(-1)
        newest = _by_identifier(frames.take(_newest_rows(frames.arbitration_id)))
        self.rows = self.rows | newest
        for identifier, mask in self._codec.page_masks.items():
            if identifier in newest:
                self.pages = {**self.pages, identifier: self._newest_pages(frames, identifier, mask)}

    def _newest_pages(
        self, frames: FrameBlock, identifier: int, mask: np.uint64
    ) -> dict[int, tuple[float, bytes]]:
        """Newest frames of a multiplexed message by page, with those that have just arrived."""
        # Without stale ones: data at the bits of a multiplexer that a page lacks look like many pages.
        oldest_s, previous = self.stamp_s - STALE_S, self.pages.get(identifier, {})
        pages = {page: row for page, row in previous.items() if row[0] >= oldest_s}
        of_message = frames.take(frames.rows_with_id(identifier))
        selected = of_message.data.view(np.uint64)[:, 0] & mask
        for page in reversed(dict.fromkeys(selected[::-1].tolist())):  # in the order of their last frames
            last = int(np.flatnonzero(selected == page)[-1])
            pages.pop(page, None)
            pages |= {page: _by_identifier(of_message.take(slice(last, last + 1)))[identifier]}
        return pages

    def forget(self, message_name: str) -> None:
        """Drop the frames of a message."""
        dropped_id = self._codec.arbitration_id(message_name)
        self.rows = {each: row for each, row in self.rows.items() if each != dropped_id}
        self.pages = {each: pages for each, pages in self.pages.items() if each != dropped_id}


def _by_identifier(frames: FrameBlock) -> dict[int, tuple[float, bytes]]:
    """Time stamp and data of frames with different identifiers."""
    return {
        identifier: (time_s, data[:length])
        # Unpacked from bytes: numpy is slow at converting rows with array fields to objects.
        for time_s, identifier, length, data in _ROW.iter_unpack(frames.rows.tobytes())
    }


@compiled
def _newest_rows(identifiers: NDArray[np.uint32]) -> IntArray:
    """Index of the last frame of each identifier."""
    last_rows = np.empty(identifiers.size, np.int64)
    count = 0
    for row in range(identifiers.size - 1, -1, -1):
        for index in range(count):
            if identifiers[last_rows[index]] == identifiers[row]:
                break
        else:
            last_rows[count] = row
            count += 1
    return last_rows[:count]


class _PresentReadout(Readout):
    """Reads the newest frames that are not stale."""

    def __init__(
        self, frames: NewestFrames, now_s: float, signal_map: SignalMap, signals: Mapping[str, BoundSignal]
    ) -> None:
        super().__init__(signal_map, signals)
        self.age_s = now_s - frames.received_s
        self._rows, self._pages = frames.rows, frames.pages
        self._oldest_s = frames.stamp_s + self.age_s - STALE_S

    def number(self, path: str) -> float:
        """Present value of a quantity; NaN if it is not mapped, or its frame is missing or stale."""
        if (bound := self.signals.get(path)) is None:
            return math.nan
        if self._pages and bound.arbitration_id in self._pages:
            frames = [*self._pages[bound.arbitration_id].values()][::-1]
            values = (bound.decode_si(data) for stamp_s, data in frames if stamp_s >= self._oldest_s)
            return next((value for value in values if not math.isnan(value)), math.nan)
        stamp_s, data = self._rows.get(bound.arbitration_id, _NEVER)
        return math.nan if stamp_s < self._oldest_s else bound.decode_si(data)

    @override
    def _last_values(self, path: str, rows: IntArray) -> FloatArray:
        return np.array([self.number(path)])


class InsStatus:
    """State of the INS at one moment; quantities not mapped or stale are NaN, None or ``UNKNOWN``."""

    def __init__(
        self, frames: NewestFrames, now_s: float, signal_map: SignalMap, signals: Mapping[str, BoundSignal]
    ) -> None:
        self._readout = _PresentReadout(frames, now_s, signal_map, signals)
        self._number = self._readout.number
        self.age_s = self._readout.age_s  #: Time since the last frame; infinite before the first.

    @cached_property
    def mode(self) -> InsMode:
        """Mode of the INS."""
        return self._readout.mode_from_value(self._number("mode"))

    @property
    def mode_text(self) -> str:
        """Name of the mode, with the value of its signal if the map does not define that value."""
        name = self.mode.name.lower()
        if self.mode is not InsMode.BOOT or (mapped := self._readout.map.mode) is None:
            return name
        return f"{name} ({mapped.signal} is {self._number('mode'):g}, no value of ins.signals.mode)"

    @cached_property
    def alignment(self) -> Alignment:
        """Progress of self-alignment."""
        return Alignment(int(self._readout.alignment(_NOW)[0]))

    @cached_property
    def euler_sequence(self) -> EulerSequence | None:
        """Sequence of the Euler angles in the output."""
        index = int(self._readout.euler_sequence(_NOW)[0])
        return list(EulerSequence)[index] if index >= 0 else None

    @cached_property
    def compensation(self) -> bool | None:
        """Whether a compensation is in use."""
        value = self._number("compensation")
        return None if math.isnan(value) else value != 0.0

    @cached_property
    def compensation_in_use(self) -> int | None:
        """Checksum of the compensation in use, 0 for none."""
        return self._whole_number("compensation_in_use")

    @cached_property
    def compensation_loaded(self) -> int | None:
        """Checksum of the loaded compensation."""
        return self._whole_number("compensation_loaded")

    @cached_property
    def epochs(self) -> int | None:
        """Count of epochs; None without a counter, or before its first frame."""
        return self._whole_number("epoch_counter")

    @property
    def epoch_modulus(self) -> float:
        """Value at which the count of epochs wraps."""
        return self._readout.signals["epoch_counter"].modulus

    @property
    def epoch_period_s(self) -> float:
        """Time from one epoch to the next."""
        return self._readout.map.epoch_period_s

    @cached_property
    def velocity_enu_mps(self) -> Triple:
        """Velocity East, North, Up."""
        return self._number("velocity_east"), self._number("velocity_north"), self._number("velocity_up")

    @cached_property
    def latitude(self) -> float:
        """Latitude that the INS uses, rad."""
        return self._number("latitude")

    @cached_property
    def attitude(self) -> FloatArray:
        """``C_nb``, shape (3, 3)."""
        return np.asarray(self._readout.attitude(_NOW)[0])

    @cached_property
    def optics_c(self) -> Triple:
        """Temperature of each gyro's optics by body axis."""
        return self._axes("gyro_optics_temperature")

    @cached_property
    def electronics_c(self) -> Triple:
        """Temperature of each gyro's electronics by body axis."""
        return self._axes("gyro_electronics_temperature")

    @cached_property
    def case_c(self) -> float:
        """Temperature of the case."""
        return self._number("case_temperature")

    @cached_property
    def identity(self) -> dict[str, int]:
        """Numbers of the signal map's ``identity`` that have been received, by name."""
        numbers = {name: self._number(f"identity.{name}") for name in self._readout.map.identity}
        return {name: int(number) for name, number in numbers.items() if math.isfinite(number)}

    def _whole_number(self, path: str) -> int | None:
        value = self._number(path)
        return None if math.isnan(value) else int(value)

    def _axes(self, name: str) -> Triple:
        return self._number(f"{name}.x"), self._number(f"{name}.y"), self._number(f"{name}.z")
