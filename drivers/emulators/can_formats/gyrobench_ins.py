"""The frames of gyrobench_ins.dbc.

Each navigation epoch is three frames (velocity, roll and pitch, heading with the epoch counter);
each whole second starts with the time, status and temperature frames. They are encoded here without the
DBC, as an independent check of its layout.
"""

from __future__ import annotations

import struct

import can
import numpy as np
from typing_extensions import override

from gyrobench.drivers.emulators.can_formats import FRAME_S, CanFormat, execute_command, frame
from gyrobench.drivers.emulators.world.inertial_unit import SAMPLE_RATE_HZ, Epochs, Mode
from gyrobench.drivers.emulators.world.ins_compensation import COEFFICIENTS, checksum
from gyrobench.drivers.emulators.world.strapdown import euler_output

SYSTEM_TIME, VELOCITY_NE, HEIGHT_VELOCITY_D, ROLL_PITCH, HEADING = 0x001, 0x004, 0x005, 0x006, 0x007
INS_STATUS, INS_IDENTITY, OPTICS_TEMPERATURE, ELECTRONICS_TEMPERATURE = 0x010, 0x011, 0x020, 0x021
COMPENSATION_STATUS = 0x012
INS_COMMAND, COMPENSATION_NUMBER = 0x200, 0x201

_FIRMWARE, _HARDWARE = 103, 1
_SLOW_FRAMES = 7
_TWO_INTS = struct.Struct("<ii")
_TWO_WORDS = struct.Struct("<II")
_HEADING = struct.Struct("<iHBB")
_STATUS = struct.Struct("<BBHBBH")
_IDENTITY = struct.Struct("<IHH")
_OPTICS = struct.Struct("<hhhH")
_ELECTRONICS = struct.Struct("<hhhh")
_OUTPUT_SCALES = np.array([1e4, 1e4, np.degrees(1e6), np.degrees(1e6), np.degrees(1e6)])
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
    def frames(self, epochs: Epochs) -> list[can.Message]:
        scaled = np.rint(euler_output(epochs.states, self._world.unit.pitch_first) * _OUTPUT_SCALES)
        scaled = scaled.clip(_INT32_MIN, _INT32_MAX)
        valid = 1 if epochs.mode is Mode.NAVIGATE or epochs.alignment else 0
        messages: list[can.Message] = []
        rows: list[list[int]] = scaled.astype(np.int64).tolist()
        for sample, (north, east, roll, pitch, heading) in zip(epochs.sample.tolist(), rows, strict=True):
            time_s = self._epoch_unix_s + sample / SAMPLE_RATE_HZ
            if sample % SAMPLE_RATE_HZ == 0:
                self._append_slow(messages, time_s, sample // SAMPLE_RATE_HZ, epochs)
                time_s += _SLOW_FRAMES * FRAME_S
            counter = self._epoch_counter
            self._epoch_counter = (counter + 1) & 0xFFFF
            heading_data = _HEADING.pack(heading % _FULL_TURN, counter, epochs.alignment, valid)
            messages += (
                frame(time_s, VELOCITY_NE, _TWO_INTS.pack(north, east)),
                frame(time_s + FRAME_S, ROLL_PITCH, _TWO_INTS.pack(roll, pitch)),
                frame(time_s + 2 * FRAME_S, HEADING, heading_data),
            )
        return messages

    def _append_slow(self, messages: list[can.Message], time_s: float, second: int, epochs: Epochs) -> None:
        unit, file = self._world.unit, self._world.file
        centidegrees = np.rint(100.0 * self._world.temperatures_c()).clip(-32768, 32767)
        case, *gyros = centidegrees.astype(int).tolist()
        counter = self._status_counter
        self._status_counter = (counter + 1) & 0xFFFF
        height = max(_INT32_MIN, min(_INT32_MAX, round(file.height_m * 1e4)))
        align_s = min(int(unit.align_time_s), 0xFFFF)
        applied = unit.compensation
        status = (epochs.mode, int(unit.pitch_first), align_s, 0 if applied is None else 1, 0, counter)
        checksums = (0 if applied is None else applied.checksum, checksum(unit.loaded_table))
        slow = (
            (SYSTEM_TIME, _TWO_WORDS.pack(second & 0xFFFFFFFF, 0)),
            (HEIGHT_VELOCITY_D, _TWO_INTS.pack(height, 0)),
            (INS_STATUS, _STATUS.pack(*status)),
            (INS_IDENTITY, _IDENTITY.pack(file.ins.serial_number, _FIRMWARE, _HARDWARE)),
            (COMPENSATION_STATUS, _TWO_WORDS.pack(*checksums)),
            (OPTICS_TEMPERATURE, _OPTICS.pack(*gyros[:3], counter)),
            (ELECTRONICS_TEMPERATURE, _ELECTRONICS.pack(*gyros[3:], case)),
        )
        for position, (identifier, data) in enumerate(slow):
            messages.append(frame(time_s + position * FRAME_S, identifier, data))
