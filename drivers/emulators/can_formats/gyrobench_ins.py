"""The frames of gyrobench_ins.dbc.

Each navigation epoch consists of three frames (velocity; roll and pitch; heading with the epoch counter).
Each whole second starts with the time, status and temperature frames. On command, each sample of the inertial
sensors is sent in two further frames. The frames are encoded here without the DBC, as an independent check of
its layout.
"""

from __future__ import annotations

import math
import struct

import can
import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.foundations.kernels import compiled
from gyrobench.drivers.emulators.can_formats import FRAME_S, CanFormat, execute_command
from gyrobench.drivers.emulators.world.inertial_unit import SAMPLE_RATE_HZ, Epochs, Mode
from gyrobench.drivers.emulators.world.ins_compensation import COEFFICIENT_COUNT, table_checksum
from gyrobench.drivers.emulators.world.strapdown import euler_output
from gyrobench.drivers.frames import FRAME_DTYPE, FrameBlock

SYSTEM_TIME, POSITION, VELOCITY_NE, HEIGHT_VELOCITY_D = 0x001, 0x003, 0x004, 0x005
ROLL_PITCH, HEADING = 0x006, 0x007
INS_STATUS, INS_IDENTITY, OPTICS_TEMPERATURE, ELECTRONICS_TEMPERATURE = 0x010, 0x011, 0x020, 0x021
COMPENSATION_STATUS = 0x012
INS_COMMAND, COMPENSATION_NUMBER = 0x200, 0x201
ANGLE_INCREMENT, VELOCITY_INCREMENT = 0x008, 0x009

_FIRMWARE, _HARDWARE = 103, 1
#: Frames that are sent at whole seconds, in order, and the layout of their data.
_SLOW_IDS = (
    SYSTEM_TIME, HEIGHT_VELOCITY_D, INS_STATUS, INS_IDENTITY, COMPENSATION_STATUS, POSITION,
    OPTICS_TEMPERATURE, ELECTRONICS_TEMPERATURE,
)  # fmt: skip
_SLOW_DATA = struct.Struct("<II ii BBHBBH IHH II ii hhhH hhhh")
_FAST_IDS = VELOCITY_NE, ROLL_PITCH, HEADING
_INCREMENT_IDS = ANGLE_INCREMENT, VELOCITY_INCREMENT
_NO_INCREMENTS = np.zeros((0, 3))
_SLOW_FRAMES, _FAST_FRAMES = len(_SLOW_IDS), len(_FAST_IDS)
_VELOCITY_LSB_PER_MPS, _ANGLE_LSB_PER_RAD = 1e4, math.degrees(1e6)
#: Resolution of angle and velocity increments, and largest number in their 20 bits.
_INCREMENT_LSB, _MAX_INCREMENT = (math.radians(0.004 / 3600.0), 5e-7), 2**19 - 1
_FULL_TURN = 360_000_000
_INT32_MIN, _INT32_MAX = -(2**31), 2**31 - 1


class GyrobenchFormat(CanFormat):
    """The frames described above."""

    _table, _checksum = b"", 0

    @override
    def reset_counters(self) -> None:
        self._epoch_counter = self._status_counter = self._increment_counter = 0
        self._rounding_remainder = np.zeros((2, 3))

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
            if axis < 3 and index < COEFFICIENT_COUNT and np.isfinite(value):
                self._world.unit.loaded_table[axis, index] = value

    @override
    def frames(self, epochs: Epochs) -> FrameBlock:
        seconds, count = len(epochs.align_time_s), len(epochs.sample)
        first, rotation, velocity = epochs.increments or (0, _NO_INCREMENTS, _NO_INCREMENTS)
        sent = len(rotation)
        rows = np.zeros(seconds * _SLOW_FRAMES + count * _FAST_FRAMES + 2 * sent, FRAME_DTYPE)
        frames = FrameBlock(rows, only_data=True)
        valid = epochs.mode is Mode.NAVIGATE or epochs.alignment > 0
        _encode(
            frames.timestamp_s, frames.arbitration_id, frames.length, frames.data, self._slow_data(epochs),
            epochs.read_c, epochs.align_time_s, epochs.sample,
            euler_output(epochs.states, self._world.unit.pitch_first), self._epoch_unix_s,
            self._epoch_counter, self._status_counter, int(epochs.alignment), valid,
            first, rotation, velocity, self._increment_counter, self._rounding_remainder,
        )  # fmt: skip
        self._status_counter = (self._status_counter + seconds) & 0xFFFF
        self._increment_counter = (self._increment_counter + sent) & 0xF
        self.skip_epochs(count)
        return frames

    def _slow_data(self, epochs: Epochs) -> NDArray[np.uint8]:
        """Data of the slow frames, shape (64,); times, counters and temperatures are zero."""
        unit, file = self._world.unit, self._world.file
        applied, table = unit.compensation, unit.loaded_table.tobytes()
        if table != self._table:
            self._table, self._checksum = table, table_checksum(unit.loaded_table)
        data = _SLOW_DATA.pack(
            0, 0,
            max(_INT32_MIN, min(_INT32_MAX, round(file.height_m * 1e4))), 0,
            epochs.mode, unit.pitch_first, 0, applied is not None, 0, 0,
            file.ins.serial_number, _FIRMWARE, _HARDWARE,
            0 if applied is None else applied.checksum, self._checksum,
            round(1e7 * (file.latitude_deg + file.ins.latitude_error_arcmin / 60.0)), 0,
            *[0] * 8,
        )  # fmt: skip
        return np.frombuffer(data, np.uint8)


@compiled
def _encode(
    frame_s: FloatArray, identifier: NDArray[np.uint32], length: NDArray[np.uint8], data: NDArray[np.uint8],
    slow: NDArray[np.uint8], temperatures_c: FloatArray, align_time_s: FloatArray, sample: IntArray,
    output: FloatArray, epoch_unix_s: float, counter: int, status_counter: int, alignment: int, valid: bool,
    first: int, rotation: FloatArray, velocity: FloatArray, increment_counter: int,
    rounding_remainder: FloatArray,
) -> None:  # fmt: skip
    """Fill the columns of the frames of some epochs and increments, in order of sending.

    ``slow`` is the data of the slow frames; at each of the k whole seconds the time, the status counter,
    ``temperatures_c``, shape (k, 7), and ``align_time_s``, shape (k,), are added to them. ``rotation`` and
    ``velocity``, shape (m, 3), are the increments of the samples from ``first`` on; their frames follow those
    of an epoch at the same time. ``rounding_remainder``, shape (2, 3), is carried over to the next increment.
    """
    row = second = sent = 0
    for k in range(sample.size + 1):
        while sent < rotation.shape[0] and (k == sample.size or first + 1 + sent < sample[k]):
            time_s = epoch_unix_s + (first + 1 + sent) / SAMPLE_RATE_HZ
            time_s += (_SLOW_FRAMES + _FAST_FRAMES) * FRAME_S
            _address(frame_s, identifier, length, row, time_s, _INCREMENT_IDS)
            number = increment_counter + sent
            _put_increment(data[row], rotation[sent], number, _INCREMENT_LSB[0], rounding_remainder[0])
            _put_increment(data[row + 1], velocity[sent], number, _INCREMENT_LSB[1], rounding_remainder[1])
            row += 2
            sent += 1
        if k == sample.size:
            break
        time_s = epoch_unix_s + sample[k] / SAMPLE_RATE_HZ
        if sample[k] % SAMPLE_RATE_HZ == 0:
            _address(frame_s, identifier, length, row, time_s, _SLOW_IDS)
            for index in range(_SLOW_FRAMES):
                for byte in range(8):
                    data[row + index, byte] = slow[8 * index + byte]
            _put_bits(data[row], 0, 4, sample[k] // SAMPLE_RATE_HZ)
            _put_bits(data[row + 2], 2, 2, int(min(align_time_s[second], 0xFFFF)))
            _put_bits(data[row + 2], 6, 2, status_counter + second)
            _put_bits(data[row + 6], 6, 2, status_counter + second)
            row += _SLOW_FRAMES
            for i in range(3):
                _put(data[row - 2], 2 * i, 2, 100.0 * temperatures_c[second, 1 + i])
                _put(data[row - 1], 2 * i, 2, 100.0 * temperatures_c[second, 4 + i])
            _put(data[row - 1], 6, 2, 100.0 * temperatures_c[second, 0])
            second += 1
            time_s += _SLOW_FRAMES * FRAME_S
        _address(frame_s, identifier, length, row, time_s, _FAST_IDS)
        _put(data[row], 0, 4, output[k, 0] * _VELOCITY_LSB_PER_MPS)
        _put(data[row], 4, 4, output[k, 1] * _VELOCITY_LSB_PER_MPS)
        _put(data[row + 1], 0, 4, output[k, 2] * _ANGLE_LSB_PER_RAD)
        _put(data[row + 1], 4, 4, output[k, 3] * _ANGLE_LSB_PER_RAD)
        _put(data[row + 2], 0, 4, np.rint(output[k, 4] * _ANGLE_LSB_PER_RAD) % _FULL_TURN)
        _put_bits(data[row + 2], 4, 2, counter + k)
        data[row + 2, 6], data[row + 2, 7] = alignment, valid
        row += _FAST_FRAMES


@compiled
def _address(
    frame_s: FloatArray, identifier: NDArray[np.uint32], length: NDArray[np.uint8], row: int, time_s: float,
    ids: tuple[int, ...],
) -> None:  # fmt: skip
    """Set times, identifiers and lengths of successive frames from ``row`` on."""
    for index in range(len(ids)):
        frame_s[row + index] = time_s + index * FRAME_S
        identifier[row + index] = ids[index]
        length[row + index] = 8


@compiled
def _put_increment(
    data: NDArray[np.uint8], increment: FloatArray, counter: int, lsb: float, remainder: FloatArray
) -> None:
    """Put an increment (3,), 20 bits for each axis, and the counter into the data of a frame."""
    number = (counter & 0xF) << 60
    for i in range(3):
        value = increment[i] / lsb + remainder[i]
        rounded = np.rint(value)
        remainder[i] = value - rounded
        number |= (int(min(max(rounded, -_MAX_INCREMENT), _MAX_INCREMENT)) & 0xFFFFF) << 20 * i
    _put_bits(data, 0, 8, number)


@compiled
def _put(data: NDArray[np.uint8], first_byte: int, size: int, value: float) -> None:
    """Put a signed integer of ``size`` bytes, rounded and within its range, into the data of a frame."""
    limit = 2.0 ** (8 * size - 1)
    _put_bits(data, first_byte, size, int(min(max(np.rint(value), -limit), limit - 1.0)))


@compiled
def _put_bits(data: NDArray[np.uint8], first_byte: int, size: int, number: int) -> None:
    """Put the lowest ``size`` bytes of a number into the data of a frame."""
    for byte in range(size):
        data[first_byte + byte] = number >> 8 * byte & 0xFF
