"""Frames for files of other tools, and how they are compared."""

import can
import pytest

from gyrobench.drivers.frames import FrameBlock

BEGIN_S = 1_700_000_000.0


def strange_frames():
    """Frames that an INS does not send."""
    return [
        can.Message(BEGIN_S, 0x1ABCDE, is_extended_id=True, data=b"\x01\x02"),
        can.Message(BEGIN_S + 1.0, 0x7F, is_extended_id=False, is_remote_frame=True, dlc=4),
        can.Message(BEGIN_S + 2.0, 0x123, is_extended_id=False, is_error_frame=True),
        can.Message(BEGIN_S + 3.0, 0x124, is_extended_id=False),
    ]


def strange_parts():
    """Two parts of a log with them."""
    frames = FrameBlock.from_messages(strange_frames())
    later = frames.with_fields(time_s=frames.timestamp_s + 10.0)
    return [(1, frames), (2, later.take(slice(0, 2)))]


def frames_of(path):
    """What another tool reads, in the order of time."""
    with can.LogReader(path) as reader:
        return sorted(reader, key=lambda message: message.timestamp)


def assert_same(read, written):
    assert len(read) == len(written)
    for one, other in zip(read, written, strict=True):
        assert one.timestamp == pytest.approx(other.timestamp, abs=2e-6)
        assert (one.arbitration_id, one.is_extended_id) == (other.arbitration_id, other.is_extended_id)
        assert (one.is_rx, one.is_fd, one.is_remote_frame) == (
            other.is_rx,
            other.is_fd,
            other.is_remote_frame,
        )
        assert one.is_error_frame == other.is_error_frame
        if not one.is_remote_frame:
            assert bytes(one.data) == bytes(other.data)
