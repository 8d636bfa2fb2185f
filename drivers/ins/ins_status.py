"""Present state of the INS, from the newest frame of each message, of a multiplexed one of each page."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

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
        #: Time stamp and data by identifier; replaced, not changed, as snapshots refer to it.
        self._newest: dict[int, tuple[float, bytes]] = {}
        #: The same of multiplexed messages, by identifier and page, the newest one last.
        self._pages: Mapping[int, Mapping[int, tuple[float, bytes]]] = {}
        self._received_s, self._stamp_s = -math.inf, 0.0

    def take(self, frames: FrameBlock, now_s: float) -> None:
        """Store frames that have just arrived, in order; at least one."""
        self._received_s, self._stamp_s = now_s, frames.timestamp_s.item(-1)
        newest = _by_identifier(frames.take(_newest_rows(frames.arbitration_id)))
        self._newest = self._newest | newest
        for identifier, mask in self._codec.page_masks.items():
            if identifier in newest:
                self._pages = {**self._pages, identifier: self._newest_pages(frames, identifier, mask)}

    def _newest_pages(
        self, frames: FrameBlock, identifier: int, mask: np.uint64
    ) -> dict[int, tuple[float, bytes]]:
        """Newest frames of a multiplexed message by page, with those that have just arrived."""
        pages = dict(self._pages.get(identifier, {}))
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
        self._newest = {each: row for each, row in self._newest.items() if each != dropped_id}
        self._pages = {each: pages for each, pages in self._pages.items() if each != dropped_id}

    def age_s(self, now_s: float) -> float:
        """Time since the last frame; infinite before the first."""
        return now_s - self._received_s

    def snapshot(self, now_s: float) -> Snapshot:
        """Return the values of the frames that are not stale."""
        return Snapshot(self._newest, self._pages, self._stamp_s + self.age_s(now_s) - STALE_S)


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


class Snapshot:
    """Values of the newest frames at one moment, without frames stamped before ``oldest_s``."""

    def __init__(
        self,
        newest: Mapping[int, tuple[float, bytes]],
        pages: Mapping[int, Mapping[int, tuple[float, bytes]]],
        oldest_s: float,
    ) -> None:
        self._newest = newest
        self._pages = pages
        self._oldest_s = oldest_s

    def value(self, bound: BoundSignal) -> float:
        """Value of a signal; NaN if its frame is missing or stale."""
        if self._pages and bound.arbitration_id in self._pages:
            frames = [*self._pages[bound.arbitration_id].values()][::-1]
            values = (bound.decode_si(data) for stamp_s, data in frames if stamp_s >= self._oldest_s)
            return next((value for value in values if not math.isnan(value)), math.nan)
        stamp_s, data = self._newest.get(bound.arbitration_id, _NEVER)
        return math.nan if stamp_s < self._oldest_s else bound.decode_si(data)

    def last_values(self, bound: BoundSignal, rows: IntArray) -> FloatArray:  # noqa: ARG002 - there is only the present
        """Value of a signal, shape (1,)."""
        return np.array([self.value(bound)])


class InsStatus:
    """State of the INS at one moment; quantities not mapped or stale are NaN, None or ``UNKNOWN``."""

    def __init__(
        self, snapshot: Snapshot, age_s: float, signal_map: SignalMap, signals: Mapping[str, BoundSignal]
    ) -> None:
        self.age_s = age_s  #: Time since the last frame; infinite before the first.
        self._snapshot = snapshot
        self._signals = signals
        self._readout = Readout(snapshot, signal_map, signals)

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

    def _number(self, path: str) -> float:
        bound = self._signals.get(path)
        return math.nan if bound is None else self._snapshot.value(bound)

    def _axes(self, name: str) -> Triple:
        return self._number(f"{name}.x"), self._number(f"{name}.y"), self._number(f"{name}.z")
