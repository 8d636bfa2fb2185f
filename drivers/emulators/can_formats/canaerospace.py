"""CANaerospace frames, version 1.7: big-endian, one number a frame, with a separate counter.

Byte 0 is the node, byte 1 the type of data, byte 2 the service, byte 3 the message code: a counter, 0 to
255, that shows lost frames; the number follows. Mode, gyro temperatures and the bench's command have
user-defined identifiers.

References
----------
Stock Flight Systems, CANaerospace interface specification 1.7.
"""

from __future__ import annotations

import struct

import can
import numpy as np
from typing_extensions import override

from gyrobench.drivers.emulators.can_formats import FRAME_S, CanFormat, execute_command, frame
from gyrobench.drivers.emulators.world.inertial_unit import SAMPLE_RATE_HZ, Epochs
from gyrobench.drivers.emulators.world.strapdown import euler_output

BENCH_COMMAND = 200
PITCH, ROLL = 311, 312
TRUE_EAST_VELOCITY, TRUE_NORTH_VELOCITY, TRUE_UP_VELOCITY, TRUE_HEADING = 1130, 1131, 1132, 1133
INS_MODE, ALIGNMENT, GYRO_X_TEMPERATURE, GYRO_Y_TEMPERATURE, GYRO_Z_TEMPERATURE = range(1800, 1805)

_NODE, _SERVICE = 1, 0
_FLOAT, _ULONG = 2, 4
_WITH_FLOAT, _WITH_ULONG = struct.Struct(">BBBBf"), struct.Struct(">BBBBI")
_ZERO_C_IN_K = 273.15


class CanaerospaceFormat(CanFormat):
    """The frames described above."""

    @override
    def reset_counters(self) -> None:
        self._codes: dict[int, int] = {}

    @override
    def skip_epochs(self, count: int) -> None:
        self._codes = {identifier: code + count for identifier, code in self._codes.items()}

    @override
    def receive(self, message: can.Message) -> None:
        if message.arbitration_id == BENCH_COMMAND and len(message.data) == 8:
            execute_command(self._world.unit, message.data[7])

    @override
    def frames(self, epochs: Epochs) -> list[can.Message]:
        messages: list[can.Message] = []
        output = euler_output(epochs.states, pitch_first=False)
        for sample, (north, east, roll, pitch, heading) in zip(
            epochs.sample.tolist(), output.tolist(), strict=True
        ):
            time_s = self._epoch_unix_s + sample / SAMPLE_RATE_HZ
            if sample % SAMPLE_RATE_HZ == 0:
                self._append_slow(messages, time_s, epochs)
                time_s += 5 * FRAME_S
            numbers = (
                (PITCH, np.degrees(pitch)),
                (ROLL, np.degrees(roll)),
                (TRUE_EAST_VELOCITY, east),
                (TRUE_NORTH_VELOCITY, north),
                (TRUE_UP_VELOCITY, 0.0),
                (TRUE_HEADING, (np.degrees(heading) + 180.0) % 360.0 - 180.0),
            )
            for position, (identifier, number) in enumerate(numbers):
                data = _WITH_FLOAT.pack(_NODE, _FLOAT, _SERVICE, self._code(identifier), number)
                messages.append(frame(time_s + position * FRAME_S, identifier, data))
        return messages

    def _append_slow(self, messages: list[can.Message], time_s: float, epochs: Epochs) -> None:
        states = ((INS_MODE, int(epochs.mode)), (ALIGNMENT, int(epochs.alignment)))
        packed = [
            (identifier, _WITH_ULONG.pack(_NODE, _ULONG, _SERVICE, self._code(identifier), state))
            for identifier, state in states
        ]
        for identifier, optics_c in zip(
            range(GYRO_X_TEMPERATURE, GYRO_Z_TEMPERATURE + 1), self._world.temperatures_c()[1:4], strict=True
        ):
            code = self._code(identifier)
            packed.append(
                (identifier, _WITH_FLOAT.pack(_NODE, _FLOAT, _SERVICE, code, optics_c + _ZERO_C_IN_K))
            )
        for position, (identifier, data) in enumerate(packed):
            messages.append(frame(time_s + position * FRAME_S, identifier, data))

    def _code(self, identifier: int) -> int:
        code = self._codes.get(identifier, 0)
        self._codes[identifier] = code + 1
        return code & 0xFF
