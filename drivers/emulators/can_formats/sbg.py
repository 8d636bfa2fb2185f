"""The frames of sbg.dbc: those of SBG Systems' Ellipse, Ekinox and Quanta, little-endian.

Each navigation epoch consists of EKF_INFO with the time, EKF_QUAT and EKF_VEL_NED; each whole second starts
with the status and the temperature. A real unit takes no commands on CAN; a gateway beside it executes
BENCH_COMMAND. The emulated unit executes it itself.

References
----------
SBG Systems, CAN protocol specifications and sbgCan.dbc, release 5.2.590.
"""

from __future__ import annotations

import can
import numpy as np
from typing_extensions import override

from gyrobench.drivers.emulators.can_formats import (
    FRAME_S,
    CanFormat,
    empty_frames,
    execute_command,
    in_order,
)
from gyrobench.drivers.emulators.world.inertial_unit import SAMPLE_RATE_HZ, Epochs, Mode
from gyrobench.drivers.frames import FrameBlock

STATUS_03, IMU_INFO = 0x102, 0x120
EKF_INFO, EKF_QUAT, EKF_VEL_NED = 0x130, 0x131, 0x137
BENCH_COMMAND = 0x7F0

_INT16_MAX = 32767
_US_PER_SAMPLE = 1_000_000 // SAMPLE_RATE_HZ
_UNINITIALISED, _AHRS, _NAV_VELOCITY = 0, 2, 3
_ATTITUDE_VALID, _HEADING_VALID, _VELOCITY_VALID, _ALIGN_VALID = 1 << 4, 1 << 5, 1 << 6, 1 << 27
_IMU_OK = 0x3FF


class SbgFormat(CanFormat):
    """The frames described above."""

    @override
    def receive(self, message: can.Message) -> None:
        if message.arbitration_id == BENCH_COMMAND and len(message.data) >= 1:
            execute_command(self._world.unit, message.data[0])

    @override
    def frames(self, epochs: Epochs) -> FrameBlock:
        time_s = self._epoch_unix_s + epochs.sample / SAMPLE_RATE_HZ
        stamps_us = epochs.sample * _US_PER_SAMPLE & 0xFFFFFFFF
        is_whole_second = epochs.sample % SAMPLE_RATE_HZ == 0
        slow = empty_frames(time_s[is_whole_second], (STATUS_03, IMU_INFO), (6, 8))
        words, halves = slow["data"].view("<u4"), slow["data"].view("<i2")
        words[:, 0, 0] = _solution(epochs)
        words[:, 1, 0], halves[:, 1, 2] = stamps_us[is_whole_second], _IMU_OK
        optics_c = epochs.read_c[:, 1:4].mean(axis=1)
        halves[:, 1, 3] = np.rint(100.0 * optics_c).clip(-_INT16_MAX, _INT16_MAX)
        fast = empty_frames(
            time_s + 2 * FRAME_S * is_whole_second, (EKF_INFO, EKF_QUAT, EKF_VEL_NED), (4, 8, 6)
        )
        fast["data"].view("<u4")[:, 0, 0] = stamps_us
        halves = fast["data"].view("<i2")
        # From right-forward-up and ENU to forward-right-down and NED.
        w, x, y, z = epochs.states[:, :4].T
        halves[:, 1] = np.rint(np.stack([w, y, x, -z], axis=-1) * _INT16_MAX)
        halves[:, 2, :2] = np.rint(100.0 * epochs.states[:, [5, 4]]).clip(-_INT16_MAX, _INT16_MAX)
        return in_order(slow, fast)


def _solution(epochs: Epochs) -> int:
    """Solution status: mode in bits 0 to 3, validity flags above."""
    mode = {Mode.ALIGN: _AHRS, Mode.NAVIGATE: _NAV_VELOCITY}.get(epochs.mode, _UNINITIALISED)
    if epochs.mode is Mode.NAVIGATE:
        mode |= _ATTITUDE_VALID | _HEADING_VALID | _VELOCITY_VALID
    elif epochs.alignment:
        mode |= _ATTITUDE_VALID | _HEADING_VALID
    return mode | (_ALIGN_VALID if epochs.alignment else 0)
