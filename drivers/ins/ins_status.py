"""Present state of the INS, from the newest frame of each message."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import can
import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.drivers.frames import EXTENDED_ID
from gyrobench.drivers.ins.attitude import EulerSequence
from gyrobench.drivers.ins.dbc_codec import DbcCodec
from gyrobench.drivers.ins.readout import Alignment, InsMode, Readout
from gyrobench.drivers.ins.signal_map import BoundSignal, SignalMap

#: Age from which values count as unknown.
STALE_S = 5.0

_NOW = np.zeros(1, np.int64)


class NewestFrames:
    """The newest data frame of each identifier, with its age.

    Ages are by the clock of the run and, between frames, by the time stamps of the CAN interface,
    whose origin is arbitrary.
    """

    def __init__(self, codec: DbcCodec) -> None:
        self._codec = codec
        self._frames: dict[int, can.Message] = {}
        self._received_s = -np.inf
        self._stamp_s = 0.0

    def take(self, frames: Sequence[can.Message], now_s: float) -> None:
        """Store frames that have just arrived, in order; at least one."""
        self._received_s, self._stamp_s = now_s, frames[-1].timestamp
        # A 29-bit identifier is stored as its complement: the cheapest way to distinguish the two kinds.
        self._frames.update(
            {(~m.arbitration_id if m.is_extended_id else m.arbitration_id): m for m in frames}
        )

    def forget(self, message_name: str) -> None:
        """Drop the frame of a message."""
        self._frames.pop(_key(self._codec.arbitration_id(message_name)), None)

    def age_s(self, now_s: float) -> float:
        """Time since the last frame."""
        return float(now_s - self._received_s)

    def snapshot(self, now_s: float) -> Snapshot:
        """The frames that are not stale."""
        oldest_s = self._stamp_s + self.age_s(now_s) - STALE_S
        fresh = {key: frame for key, frame in self._frames.items() if frame.timestamp >= oldest_s}
        return Snapshot(fresh, self._codec)


class Snapshot:
    """Values of the newest frames at one moment; each frame is decoded when first used."""

    def __init__(self, frames: Mapping[int, can.Message], codec: DbcCodec) -> None:
        self._frames = frames
        self._codec = codec
        self._decoded: dict[str, dict[str, float]] = {}

    def held(self, bound: BoundSignal, rows: IntArray) -> FloatArray:  # noqa: ARG002 - only now
        """Value of a signal, shape (1,); NaN without its frame."""
        if bound.message not in self._decoded:
            frame = self._frames.get(_key(self._codec.arbitration_id(bound.message)))
            self._decoded[bound.message] = (
                {} if frame is None else self._codec.decode_one(frame.data, bound.message)
            )
        value = self._decoded[bound.message].get(bound.signal.name, np.nan)
        return bound.to_si(np.array([value]))


def _key(arbitration_id: int) -> int:
    return ~(arbitration_id & ~EXTENDED_ID) if arbitration_id & EXTENDED_ID else arbitration_id


class InsStatus:
    """State of the INS at one moment; quantities not mapped or stale are NaN, None or ``UNKNOWN``."""

    def __init__(
        self, snapshot: Snapshot, age_s: float, signal_map: SignalMap, signals: Mapping[str, BoundSignal]
    ) -> None:
        self.age_s = age_s  #: Time since the last frame; infinite before the first.
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
        return None if np.isnan(value) else value != 0.0

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
        return np.asarray(self._readout.velocity_enu_mps(_NOW)[0])

    @cached_property
    def attitude(self) -> FloatArray:
        """``C_nb``, shape (3, 3)."""
        return np.asarray(self._readout.attitude(_NOW)[0])

    @cached_property
    def optics_c(self) -> FloatArray:
        """Temperature of each gyro's optics by body axis, shape (3,)."""
        return np.asarray(self._readout.axes("gyro_optics_temperature", _NOW)[0])

    @cached_property
    def electronics_c(self) -> FloatArray:
        """Temperature of each gyro's electronics by body axis, shape (3,)."""
        return np.asarray(self._readout.axes("gyro_electronics_temperature", _NOW)[0])

    @cached_property
    def case_c(self) -> float:
        """Temperature of the case."""
        return self._number("case_temperature")

    @cached_property
    def identity(self) -> dict[str, int]:
        """Numbers of the signal map's ``identity`` that have arrived."""
        numbers = {name: self._number(f"identity.{name}") for name in self._readout.map.identity}
        return {name: int(number) for name, number in numbers.items() if np.isfinite(number)}

    def _whole_number(self, path: str) -> int | None:
        value = self._number(path)
        return None if np.isnan(value) else int(value)

    def _number(self, path: str) -> float:
        return float(self._readout.value(path, _NOW)[0])
