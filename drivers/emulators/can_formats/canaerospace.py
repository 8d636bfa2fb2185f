"""CANaerospace frames, version 1.7: big-endian, one number per frame, with a counter for each identifier.

Byte 0 is the node, byte 1 the type of data, byte 2 the service, and byte 3 the message code: a counter, 0 to
255, from which the receiver detects lost frames. The number follows. Mode, gyro temperatures and the bench's
command have user-defined identifiers.

References
----------
Stock Flight Systems, CANaerospace interface specification 1.7.
"""

from __future__ import annotations

import can
import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from gyrobench.drivers.emulators.can_formats import (
    FRAME_S,
    CanFormat,
    empty_frames,
    execute_command,
    in_order,
)
from gyrobench.drivers.emulators.world.inertial_unit import SAMPLE_RATE_HZ, Epochs
from gyrobench.drivers.emulators.world.strapdown import euler_output
from gyrobench.drivers.frames import FrameBlock

BENCH_COMMAND = 200
PITCH, ROLL = 311, 312
TRUE_EAST_VELOCITY, TRUE_NORTH_VELOCITY, TRUE_UP_VELOCITY, TRUE_HEADING = 1130, 1131, 1132, 1133
INS_MODE, ALIGNMENT, GYRO_X_TEMPERATURE, GYRO_Y_TEMPERATURE, GYRO_Z_TEMPERATURE = range(1800, 1805)

_NODE, _SERVICE = 1, 0
_FLOAT, _ULONG = 2, 4
_FAST = (PITCH, ROLL, TRUE_EAST_VELOCITY, TRUE_NORTH_VELOCITY, TRUE_UP_VELOCITY, TRUE_HEADING)
_SLOW = (INS_MODE, ALIGNMENT, GYRO_X_TEMPERATURE, GYRO_Y_TEMPERATURE, GYRO_Z_TEMPERATURE)
_ZERO_C_IN_K = 273.15


class CanaerospaceFormat(CanFormat):
    """The frames described above."""

    @override
    def reset_counters(self) -> None:
        self._fast_codes = self._slow_codes = 0

    @override
    def skip_epochs(self, count: int) -> None:
        self._fast_codes += count
        self._slow_codes += count

    @override
    def receive(self, message: can.Message) -> None:
        if message.arbitration_id == BENCH_COMMAND and len(message.data) == 8:
            execute_command(self._world.unit, message.data[7])

    @override
    def frames(self, epochs: Epochs) -> FrameBlock:
        time_s = self._epoch_unix_s + epochs.sample / SAMPLE_RATE_HZ
        is_whole_second = epochs.sample % SAMPLE_RATE_HZ == 0
        slow = empty_frames(time_s[is_whole_second], _SLOW, 8)
        slow["data"].view(">u4")[:, :2, 1] = int(epochs.mode), int(epochs.alignment)
        slow["data"].view(">f4")[:, 2:, 1] = epochs.read_c[:, 1:4] + _ZERO_C_IN_K
        _set_headers(slow, [_ULONG, _ULONG, _FLOAT, _FLOAT, _FLOAT], self._slow_codes)
        north, east, roll, pitch, heading = euler_output(epochs.states, pitch_first=False).T
        fast = empty_frames(time_s + len(_SLOW) * FRAME_S * is_whole_second, _FAST, 8)
        course_deg = (np.degrees(heading) + 180.0) % 360.0 - 180.0
        numbers = (np.degrees(pitch), np.degrees(roll), east, north, np.zeros_like(east), course_deg)
        fast["data"].view(">f4")[:, :, 1] = np.stack(numbers, axis=-1)
        _set_headers(fast, [_FLOAT] * len(_FAST), self._fast_codes)
        self._slow_codes += len(slow)
        self._fast_codes += len(fast)
        return in_order(slow, fast)


def _set_headers(rows: NDArray[np.void], types: list[int], first_code: int) -> None:
    """Set node, type of data, service and message code; the codes count the frames of each identifier."""
    data = rows["data"]
    data[..., 0], data[..., 1], data[..., 2] = _NODE, types, _SERVICE
    data[..., 3] = (first_code + np.arange(len(rows)) & 0xFF)[:, None]
