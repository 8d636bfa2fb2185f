"""The output of an INS as CAN frames of the shipped DBC, and the marks that the engine would write."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.runs.marks import DwellMarks, WindowMark
from gyrobench.drivers.frames import FrameBlock
from tests.adversarial.strapdown import EPOCH_S, Angles, Floats, Output

_PER_S = round(1.0 / EPOCH_S)
_NAVIGATE, _FINE = 3, 2
_SYSTEM_TIME, _VELOCITY, _ROLL_PITCH, _HEADING, _STATUS, _OPTICS, _ELECTRONICS = 1, 4, 6, 7, 16, 32, 33


def euler_deg(C_nb: Floats, is_pry: bool) -> tuple[Floats, Floats, Floats]:
    """Roll, pitch and heading (n,) in the sequence that is regular."""
    if is_pry:
        roll = -np.arcsin(np.clip(C_nb[:, 2, 0], -1.0, 1.0))
        pitch = np.arctan2(C_nb[:, 2, 1], C_nb[:, 2, 2])
        yaw = np.arctan2(C_nb[:, 1, 0], C_nb[:, 0, 0])
    else:
        roll = np.arctan2(-C_nb[:, 2, 0], C_nb[:, 2, 2])
        pitch = np.arcsin(np.clip(C_nb[:, 2, 1], -1.0, 1.0))
        yaw = np.arctan2(-C_nb[:, 0, 1], C_nb[:, 1, 1])
    return np.degrees(roll), np.degrees(pitch), np.degrees(-yaw) % 360.0


def dwell_frames(
    output: Output,
    position: str,
    angles_deg: list[Angles],
    number: int,
    random: np.random.Generator,
    gyro_c: float = 35.0,
) -> tuple[DwellMarks, FrameBlock]:
    """Frames of one dwell, an epoch every 0.1 s, and its marks."""
    is_pry = position.startswith("y")
    roll, pitch, heading = euler_deg(output.C_nb, is_pry)
    epochs = len(output.time_s)
    index = np.arange(epochs)
    data = {
        _VELOCITY: _packed(
            "i4", _rounded(output.velocity_enu_mps[:, 1], 1e-4), _rounded(output.velocity_enu_mps[:, 0], 1e-4)
        ),
        _ROLL_PITCH: _packed("i4", _rounded(roll, 1e-6), _rounded(pitch, 1e-6)),
        _HEADING: _packed("i4", _rounded(heading, 1e-6), (index & 0xFFFF) | _FINE << 16 | 1 << 24),
    }
    seconds = index[::_PER_S]
    warmth = 100.0 * (gyro_c + 0.02 * random.standard_normal((2, 4, len(seconds))))
    warmth[1] += 1000.0
    status = np.full(len(seconds), _NAVIGATE | int(is_pry) << 8 | 600 << 16)
    each_second = {
        _SYSTEM_TIME: _packed("u4", seconds // _PER_S, np.zeros(len(seconds))),
        _STATUS: _packed("u4", status, (seconds // _PER_S & 0xFFFF) << 16),
        _OPTICS: _packed("i2", *warmth[0]),
        _ELECTRONICS: _packed("i2", *warmth[1]),
    }
    at, identifiers, payloads = [], [], []
    for order, (identifier, payload) in enumerate({**each_second, **data}.items()):
        own = seconds if identifier in each_second else index
        at.append(own * 10 + order)
        identifiers.append(np.full(len(own), identifier, np.uint32))
        payloads.append(payload)
    place = np.concatenate(at)
    order = np.argsort(place, kind="stable")
    place = place[order]
    frames = FrameBlock.from_columns(
        place // 10 * EPOCH_S + place % 10 * 2.5e-4,
        np.concatenate(identifiers)[order],
        np.full(len(order), 8, np.uint8),
        np.concatenate(payloads)[order],
    )
    return _marks(
        output, position, angles_deg, number, np.searchsorted(place, 10 * np.arange(epochs + 1))
    ), frames


def _marks(
    output: Output, position: str, angles_deg: list[Angles], number: int, first_frames: Floats
) -> DwellMarks:
    def frame(epoch: int) -> int:
        return int(first_frames[epoch])

    windows = []
    for window, ((begin, end), angles) in enumerate(zip(output.windows, angles_deg, strict=True)):
        turn = [frame(epoch) for epoch in output.turns[window - 1]] if window else [None, None]
        windows.append(WindowMark(frame(begin), frame(end), *angles, *turn))
    return DwellMarks(
        unit="1", run="adversarial-1", dwell=number, cycle=1, position=position, azimuth_deg=0.0,
        log_part=number,
        windows=tuple(windows), start_s=2000.0 * number, end_s=2000.0 * number + output.time_s[-1],
        since_power_on_s=2000.0 * number, chamber_set_c=20.0, chamber_c=20.0,
    )  # fmt: skip


def _rounded(values: Floats, lsb: float) -> Floats:
    return np.rint(values / lsb)


def _packed(kind: str, *columns: Floats) -> np.ndarray:
    """Little-endian fields side by side, (n, 8) bytes."""
    fields = np.stack([np.asarray(column).astype(np.int64) for column in columns], axis=-1)
    return np.ascontiguousarray(fields.astype(f"<{kind}")).view(np.uint8).reshape(len(fields), 8)
