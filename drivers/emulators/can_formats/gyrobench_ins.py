"""The frames of gyrobench_ins.dbc.

Each navigation epoch is three frames (velocity, roll and pitch, heading with the epoch counter);
each whole second starts with the time, status and temperature frames. They are encoded here without the
DBC, as an independent check of its layout.
"""

from __future__ import annotations

import math
import struct
from typing import Any

import can
import numba
import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.drivers.emulators.can_formats import FRAME_S, CanFormat, execute_command
from gyrobench.drivers.emulators.world.inertial_unit import SAMPLE_RATE_HZ, Epochs, Mode
from gyrobench.drivers.emulators.world.ins_compensation import COEFFICIENTS, checksum
from gyrobench.drivers.emulators.world.strapdown import euler_output
from gyrobench.drivers.frames import FRAME_DTYPE, FrameBlock

SYSTEM_TIME, VELOCITY_NE, HEIGHT_VELOCITY_D, ROLL_PITCH, HEADING = 0x001, 0x004, 0x005, 0x006, 0x007
INS_STATUS, INS_IDENTITY, OPTICS_TEMPERATURE, ELECTRONICS_TEMPERATURE = 0x010, 0x011, 0x020, 0x021
COMPENSATION_STATUS = 0x012
INS_COMMAND, COMPENSATION_NUMBER = 0x200, 0x201

_FIRMWARE, _HARDWARE = 103, 1
#: The frames of a whole second, in order of sending, and their data.
_SLOW_IDS = (
    SYSTEM_TIME, HEIGHT_VELOCITY_D, INS_STATUS, INS_IDENTITY, COMPENSATION_STATUS, OPTICS_TEMPERATURE,
    ELECTRONICS_TEMPERATURE,
)  # fmt: skip
_SLOW_DATA = struct.Struct("<II ii BBHBBH IHH II hhhH hhhh")
_SLOW_FRAMES, _FAST_FRAMES = len(_SLOW_IDS), 3
_VELOCITY_LSB_PER_MPS, _ANGLE_LSB_PER_RAD = 1e4, math.degrees(1e6)
_FULL_TURN = 360_000_000
_INT32_MIN, _INT32_MAX = -(2**31), 2**31 - 1


class GyrobenchFormat(CanFormat):
    """The frames described above."""

    @override
    def reset_counters(self) -> None:
        self._epoch_counter = self._status_counter = 0

    @override
    def skip_epochs(self, count: int) -> None:
        self._epoch_counter = (self._epoch_counter + count) & 0xFFFF

    @override
    def receive(self, message: can.Message) -> None:
        data = bytes(message.data)
        if message.arbitration_id == INS_COMMAND and len(data) >= 2:
            execute_command(self._world.unit, data[0], data[1])
        elif message.arbitration_id == COMPENSATION_NUMBER and len(data) == 8:
            axis, index, value = struct.unpack("<BBxxf", data)
            if axis < 3 and index < COEFFICIENTS and np.isfinite(value):
                self._world.unit.loaded_table[axis, index] = value

    @override
    def frames(self, epochs: Epochs) -> FrameBlock:
        first, last = int(epochs.sample[0]), int(epochs.sample[-1])
        seconds = range(-(-first // SAMPLE_RATE_HZ), last // SAMPLE_RATE_HZ + 1)
        slow = np.frombuffer(b"".join([self._slow_data(second, epochs) for second in seconds]), np.uint8)
        count = len(epochs.sample)
        rows = np.zeros(len(seconds) * _SLOW_FRAMES + count * _FAST_FRAMES, FRAME_DTYPE)
        valid = epochs.mode is Mode.NAVIGATE or epochs.alignment > 0
        _encode(
            rows, slow, epochs.sample, euler_output(epochs.states, self._world.unit.pitch_first),
            self._epoch_unix_s, self._epoch_counter, int(epochs.alignment), valid,
        )  # fmt: skip
        self.skip_epochs(count)
        return FrameBlock(rows)

    def _slow_data(self, second: int, epochs: Epochs) -> bytes:
        unit, file = self._world.unit, self._world.file
        case, *gyros = (_within_16_bits(100.0 * each_c) for each_c in self._world.temperatures_c().tolist())
        counter = self._status_counter
        self._status_counter = (counter + 1) & 0xFFFF
        applied = unit.compensation
        return _SLOW_DATA.pack(
            second & 0xFFFFFFFF, 0,
            max(_INT32_MIN, min(_INT32_MAX, round(file.height_m * 1e4))), 0,
            epochs.mode, unit.pitch_first, min(int(unit.align_time_s), 0xFFFF),
            applied is not None, 0, counter,
            file.ins.serial_number, _FIRMWARE, _HARDWARE,
            0 if applied is None else applied.checksum, checksum(unit.loaded_table),
            *gyros[:3], counter,
            *gyros[3:], case,
        )  # fmt: skip


def _within_16_bits(value: float) -> int:
    return max(-32768, min(32767, round(value)))


@numba.njit(cache=True)
def _encode(
    rows: Any, slow: NDArray[np.uint8], sample: IntArray, output: FloatArray,
    epoch_unix_s: float, counter: int, alignment: int, valid: bool,
) -> None:  # fmt: skip
    """Fill the frames of the epochs; ``slow``: data of the slow frames of all whole seconds among them."""
    row = used = 0
    for k in range(sample.size):
        time_s = epoch_unix_s + sample[k] / SAMPLE_RATE_HZ
        if sample[k] % SAMPLE_RATE_HZ == 0:
            for place in range(_SLOW_FRAMES):
                rows[row]["time_s"] = time_s + place * FRAME_S
                rows[row]["id"], rows[row]["length"] = _SLOW_IDS[place], 8
                for byte in range(8):
                    rows[row]["data"][byte] = slow[used + byte]
                row, used = row + 1, used + 8
            time_s += _SLOW_FRAMES * FRAME_S
        north, east = output[k, 0] * _VELOCITY_LSB_PER_MPS, output[k, 1] * _VELOCITY_LSB_PER_MPS
        roll, pitch = output[k, 2] * _ANGLE_LSB_PER_RAD, output[k, 3] * _ANGLE_LSB_PER_RAD
        heading = _within_32_bits(output[k, 4] * _ANGLE_LSB_PER_RAD) % _FULL_TURN
        _put_two(rows[row], time_s, VELOCITY_NE, _within_32_bits(north), _within_32_bits(east))
        _put_two(rows[row + 1], time_s + FRAME_S, ROLL_PITCH, _within_32_bits(roll), _within_32_bits(pitch))
        last = (counter + k & 0xFFFF) | alignment << 16 | int(valid) << 24
        _put_two(rows[row + 2], time_s + 2 * FRAME_S, HEADING, heading, last)
        row += _FAST_FRAMES


@numba.njit(cache=True)
def _within_32_bits(value: float) -> int:
    return int(min(max(np.rint(value), _INT32_MIN), _INT32_MAX))


@numba.njit(cache=True)
def _put_two(row: Any, time_s: float, identifier: int, first: int, second: int) -> None:
    """Make a frame of two 32-bit integers."""
    row["time_s"], row["id"], row["length"] = time_s, identifier, 8
    for byte in range(4):
        row["data"][byte] = first >> 8 * byte & 0xFF
        row["data"][4 + byte] = second >> 8 * byte & 0xFF
