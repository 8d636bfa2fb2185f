"""CAN frames written as BLF, read back by python-can."""

import can

from gyrobench.bench.export.can_blf import write_blf
from gyrobench.bench.export.placed_parts import PlacedLog
from tests.bench.export.frames import assert_same, frames_of, strange_parts


def test_a_blf_file_holds_every_frame_with_its_calendar_time(two_dwells, messages, tmp_path):
    path = tmp_path / "can.blf"
    assert write_blf(path, PlacedLog(two_dwells)) == len(messages)
    with can.BLFReader(path) as reader:
        assert_same(list(reader), messages)


def test_frames_of_all_kinds_survive(tmp_path):
    path, parts = tmp_path / "can.blf", strange_parts()
    write_blf(path, parts)
    assert_same(frames_of(path), [message for part in parts for message in part.messages])
