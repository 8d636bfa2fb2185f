"""Present state of the INS, from the newest frame of each message."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.drivers.frames import FrameBlock, concatenate
from gyrobench.drivers.ins.attitude import EulerSequence
from gyrobench.drivers.ins.dbc_codec import DbcCodec
from gyrobench.drivers.ins.readout import Alignment, InsMode, Readout
from gyrobench.drivers.ins.signal_map import BoundSignal, SignalMap

#: Age from which values count as unknown.
STALE_S = 5.0
#: Time for which frames are kept: a status may be asked for its values that much later.
_KEPT_S = 30.0
#: Frames of a block in which all identifiers are looked up at once; in the others, one by one.
_LAST_FRAMES = 64

_NOW = np.zeros(1, np.int64)


class _Arrival:
    """Frames that arrived together, with those before them; a frame is searched for when first asked for."""

    def __init__(self, block: FrameBlock, received_s: float, before: _Arrival | None) -> None:
        self.block = block
        self.received_s = received_s
        self.before = before
        #: Newest row up to here by identifier, as a tuple of the fields; None for no such frame.
        self.found: dict[int, tuple[Any, ...] | None] = {}

    @cached_property
    def _last_rows(self) -> dict[int, int]:
        """Last row of each identifier among the last frames, which have most messages."""
        first = max(len(self.block) - _LAST_FRAMES, 0)
        last = self.block.arbitration_id[first:].tolist()
        return {each: index for index, each in enumerate(last, start=first)}

    def last_row(self, arbitration_id: int) -> int | None:
        """Last row of an identifier; None if it is not in the block."""
        row = self._last_rows.get(arbitration_id)
        if row is None and len(self.block) > _LAST_FRAMES:
            rows = np.flatnonzero(self.block.arbitration_id == arbitration_id)
            row = rows.item(-1) if len(rows) else None
        return row

    def newest(self, arbitration_id: int) -> tuple[Any, ...] | None:
        passed: list[_Arrival] = []
        arrival: _Arrival | None = self
        row = None
        while arrival is not None and arbitration_id not in arrival.found:
            passed.append(arrival)
            index = arrival.last_row(arbitration_id)
            if index is not None:
                row = arrival.block.rows[index].item()
                break
            arrival = arrival.before
        else:
            row = arrival.found[arbitration_id] if arrival is not None else None
        for each in passed:
            each.found[arbitration_id] = row
        return row


class NewestFrames:
    """The newest data frame of each identifier, with its age.

    Ages are by the clock of the run and, between frames, by the time stamps of the CAN interface,
    whose origin is arbitrary.
    """

    def __init__(self, codec: DbcCodec) -> None:
        self._codec = codec
        self._arrivals = deque([_Arrival(concatenate([]), -np.inf, None)])
        self._stamp_s = 0.0

    def take(self, frames: FrameBlock, now_s: float) -> None:
        """Store frames that have just arrived, in order; at least one."""
        self._stamp_s = frames.timestamp_s.item(-1)
        self._append(frames, now_s)
        while self._arrivals[0].received_s < now_s - _KEPT_S:
            self._arrivals.popleft()
            self._arrivals[0].before = None

    def _append(self, frames: FrameBlock, received_s: float) -> None:
        self._arrivals.append(_Arrival(frames, received_s, self._arrivals[-1]))

    def forget(self, message_name: str) -> None:
        """Drop the frames of a message."""
        self._append(concatenate([]), self._arrivals[-1].received_s)
        self._arrivals[-1].found[self._codec.arbitration_id(message_name)] = None

    def age_s(self, now_s: float) -> float:
        """Time since the last frame."""
        return float(now_s - self._arrivals[-1].received_s)

    def snapshot(self, now_s: float) -> Snapshot:
        """The frames that are not stale."""
        oldest_s = self._stamp_s + self.age_s(now_s) - STALE_S
        return Snapshot(self._arrivals[-1], oldest_s, self._codec)


class Snapshot:
    """Values of the newest frames at one moment, those stamped before ``oldest_s`` left out."""

    def __init__(self, arrival: _Arrival, oldest_s: float, codec: DbcCodec) -> None:
        self._arrival = arrival
        self._oldest_s = oldest_s
        self._codec = codec
        self._decoded: dict[str, Mapping[str, float]] = {}

    def value(self, bound: BoundSignal) -> float:
        """Value of a signal; NaN without its frame."""
        message = bound.message
        if message not in self._decoded:
            row = self._arrival.newest(self._codec.arbitration_id(message))
            is_known = row is not None and row[0] >= self._oldest_s
            data = bytes(row[4][: row[2]]) if row and is_known else b""
            self._decoded[message] = self._codec.decode_one(data, message)
        return float(bound.to_si(self._decoded[message].get(bound.signal.name, math.nan)))

    def held(self, bound: BoundSignal, rows: IntArray) -> FloatArray:  # noqa: ARG002 - only now
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
        return InsMode(int(self._readout.mode(_NOW)[0]))

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
    def ins_time_s(self) -> float:
        """Time on the clock of the INS."""
        return float(self._readout.time_s(_NOW)[0])

    @cached_property
    def velocity_enu_mps(self) -> FloatArray:
        """Velocity, shape (3,)."""
        return np.array([self._number(f"velocity_{axis}") for axis in ("east", "north", "up")])

    @cached_property
    def attitude(self) -> FloatArray:
        """``C_nb``, shape (3, 3)."""
        return np.asarray(self._readout.attitude(_NOW)[0])

    def keep_attitude(self) -> None:
        """Read what the attitude is computed from, so that it can be asked for at any later time."""
        for path in self._signals:
            if path.startswith("attitude."):
                self._number(path)

    @cached_property
    def optics_c(self) -> FloatArray:
        """Temperature of each gyro's optics by body axis, shape (3,)."""
        return self._axes("gyro_optics_temperature")

    @cached_property
    def electronics_c(self) -> FloatArray:
        """Temperature of each gyro's electronics by body axis, shape (3,)."""
        return self._axes("gyro_electronics_temperature")

    @cached_property
    def case_c(self) -> float:
        """Temperature of the case."""
        return self._number("case_temperature")

    @cached_property
    def identity(self) -> dict[str, int]:
        """Numbers of the signal map's ``identity`` that have arrived."""
        numbers = {name: self._number(f"identity.{name}") for name in self._readout.map.identity}
        return {name: int(number) for name, number in numbers.items() if math.isfinite(number)}

    def _whole_number(self, path: str) -> int | None:
        value = self._number(path)
        return None if math.isnan(value) else int(value)

    def _number(self, path: str) -> float:
        bound = self._signals.get(path)
        return math.nan if bound is None else self._snapshot.value(bound)

    def _axes(self, name: str) -> FloatArray:
        return np.array([self._number(f"{name}.{axis}") for axis in "xyz"])
