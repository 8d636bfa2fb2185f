import math
import os
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.can_log import CanLog, read_can_log
from gyrobench.drivers.frames import FrameBlock, concatenate


def frames(start, count, period_s=0.02):
    numbers = np.arange(start, start + count)
    return FrameBlock.from_columns(
        946684800.0 + period_s * numbers, numbers % 8, 8, numbers.astype("<u8")[:, None].view(np.uint8)
    )


@pytest.fixture
def log(tmp_path):
    return CanLog(tmp_path)


def test_frames_come_back_in_order_across_parts(tmp_path, log):
    log.write(frames(0, 500))
    log.cut()
    log.write(frames(500, 300))
    log.cut()
    parts = [part for _, part in read_can_log(tmp_path)]
    assert [len(part) for part in parts] == [500, 300]
    written, read = frames(0, 800), concatenate(parts)
    assert np.array_equal(read.data, written.data)
    assert np.array_equal(read.arbitration_id, written.arbitration_id)
    assert read.timestamp_s == pytest.approx(written.timestamp_s, abs=1e-6)


def test_python_cans_own_reader_opens_every_part(tmp_path, log):
    log.write(frames(0, 50))
    log.cut()
    with can.LogReader(tmp_path / "part-00001.blf") as reader:
        assert sum(1 for _ in reader) == 50


def test_what_was_cut_survives_a_part_that_was_never_ended(tmp_path, log):
    log.write(frames(0, 100))
    log.cut()
    log.write(frames(100, 5000))
    whole, rest = (part for _, part in read_can_log(tmp_path))
    assert len(whole) == 100
    assert len(rest) <= 5000
    log.cut()


def test_a_new_log_continues_with_the_numbering(tmp_path):
    for _ in range(2):
        log = CanLog(tmp_path)
        log.write(frames(0, 1))
        log.cut()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["part-00001.blf", "part-00002.blf"]


def contents(folder):
    return {number: part.data.copy().view("<u8")[:, 0].tolist() for number, part in read_can_log(folder)}


def test_every_part_is_read_up_to_its_last_whole_container_and_stands_alone(tmp_path):
    for begin in (0, 5000, 10_000):
        log = CanLog(tmp_path)
        for first in range(begin, begin + 3000, 100):
            log.write(frames(first, 100))
        if begin < 10_000:
            log.cut()
    for number in (1, 2):
        path = tmp_path / f"part-{number:05d}.blf"
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    parts = contents(tmp_path)
    assert list(parts) == [1, 2, 3]
    for number, begin in ((1, 0), (2, 5000), (3, 10_000)):
        assert 300 < len(parts[number]) < 3000
        assert parts[number] == list(range(begin, begin + len(parts[number])))
    log.cut()


def test_a_part_that_is_being_written_lacks_the_last_seconds_at_most(tmp_path, log):
    for begin in range(0, 2000, 10):
        log.write(frames(begin, 10))
        read = contents(tmp_path)[1]
        assert read == list(range(len(read)))
        assert begin + 10 - len(read) <= 350
    log.cut()
    assert contents(tmp_path) == {1: list(range(2000))}


def test_on_virtual_time_containers_are_full_and_the_last_one_alone_can_be_lost(tmp_path):
    log = CanLog(tmp_path, is_virtual=True)
    for begin in range(0, 40_000, 400):
        log.write(frames(begin, 400))
        log.write_waiting(begin / 40.0)
        read = contents(tmp_path)[1]
        assert read == list(range(len(read)))
        assert begin + 400 - len(read) <= 2800
    log.cut()
    assert contents(tmp_path) == {1: list(range(40_000))}
    (part,) = tmp_path.iterdir()
    assert part.read_bytes().count(b"LOBJ") == math.ceil(40_000 / 2400)


def test_frames_that_come_seldom_are_readable_after_some_seconds(tmp_path, log):
    for number in range(100):
        log.write(frames(number, 1, period_s=1.0))
        assert number + 1 - len(contents(tmp_path)[1]) <= 10
    log.cut()


def test_frames_that_no_others_follow_are_readable_after_some_seconds_of_the_clock(tmp_path, log):
    log.write_waiting(0.0)
    for now_s in (100.0, 105.0, 109.0):
        log.write(frames(0, 1))
        log.write_waiting(now_s)
    assert contents(tmp_path)[1] == []
    log.write_waiting(110.0)
    assert contents(tmp_path)[1] == [0, 0, 0]
    log.write(frames(1, 1))
    log.write_waiting(115.0)
    assert contents(tmp_path)[1] == [0, 0, 0]
    log.write_waiting(125.0)
    assert contents(tmp_path)[1] == [0, 0, 0, 1]
    log.cut()


def test_what_was_synchronized_is_complete_for_other_programs_while_the_part_continues(tmp_path, log):
    for begin in (0, 50):
        log.write(frames(begin, 50))
        log.sync()
        with can.LogReader(tmp_path / "part-00001.blf") as reader:
            assert reader.object_count == begin + 50
            assert reader.stop_timestamp == pytest.approx(946684800.0 + 0.02 * (begin + 49), abs=1e-3)
            assert sum(1 for _ in reader) == begin + 50
    log.cut()
    assert contents(tmp_path) == {1: list(range(100))}


@given(data=st.data())
def test_damage_anywhere_never_gives_a_frame_that_was_not_received_there(tmp_path, data):
    for path in tmp_path.iterdir():
        path.unlink()
    log = CanLog(tmp_path)
    for begin in range(0, 1500, 300):
        log.write(frames(begin, 300))
    log.cut()
    path = tmp_path / "part-00001.blf"
    content = bytearray(path.read_bytes())
    start = data.draw(st.integers(144, len(content) - 1))
    damage = data.draw(st.binary(min_size=1, max_size=40) | st.just(bytes(4096)))
    content[start : start + len(damage)] = damage
    path.write_bytes(content[: data.draw(st.integers(start, len(content)))])
    read = contents(tmp_path)[1]
    assert read == list(range(len(read)))


@pytest.mark.parametrize("content", [b"", b"not a BLF file", bytes(144), bytes(5000), b"LOGG" + bytes(200)])
def test_a_part_whose_begin_never_reached_the_disk_gives_no_frames(tmp_path, content):
    (tmp_path / "part-00001.blf").write_bytes(content)
    (tmp_path / "part-00002.blf").write_bytes(content)
    assert contents(tmp_path) == {1: [], 2: []}


def test_a_part_that_cant_be_read_is_an_error(tmp_path):
    (tmp_path / "part-00001.blf").mkdir()
    with pytest.raises(RunFolderError, match="part-00001"):
        list(read_can_log(tmp_path))


def test_other_files_in_the_folder_are_no_parts(tmp_path):
    for name in ("part-00001.blf.bak", "part-one.blf", "notes.txt"):
        (tmp_path / name).write_text("x")
    log = CanLog(tmp_path)
    assert log.next_part == 1


def test_the_part_after_number_99999_is_read_last(tmp_path):
    (tmp_path / "part-99999.blf").touch()
    log = CanLog(tmp_path)
    log.write(frames(0, 1))
    log.cut()
    assert list(contents(tmp_path)) == [99_999, 100_000]


def test_a_write_error_ends_the_part_and_the_next_frames_begin_another(tmp_path, log, small_files):
    log.write(frames(0, 1000))
    with small_files(1000), pytest.raises(RunFolderError, match=r"part-00001.*can't be written"):
        log.write(frames(1000, 1000))
    log.write(frames(2000, 500))
    log.cut()
    parts = contents(tmp_path)
    assert parts[1] == list(range(len(parts[1])))
    assert parts[2] == list(range(2000, 2500))


def open_descriptors():
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def test_a_part_that_cant_be_ended_is_an_error_and_leaks_no_descriptor(tmp_path, log, small_files):
    before = open_descriptors()
    log.write(frames(0, 100))
    with small_files(200), pytest.raises(RunFolderError, match="can't be written"):
        log.cut()
    assert open_descriptors() == before
    log.cut()
    assert contents(tmp_path) == {1: []}


def test_a_disk_that_fails_to_sync_is_an_error(log, monkeypatch):
    log.write(frames(0, 100))

    def broken(descriptor):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", broken)
    with pytest.raises(RunFolderError, match="Input/output error"):
        log.cut()


def test_a_second_writer_does_not_touch_the_part_of_the_first(tmp_path):
    first, second = CanLog(tmp_path), CanLog(tmp_path)
    first.write(frames(0, 100))
    with pytest.raises(RunFolderError, match="File exists"):
        second.write(frames(500, 100))
    first.cut()
    assert contents(tmp_path) == {1: list(range(100))}


def test_an_absent_log_is_an_error(tmp_path):
    with pytest.raises(RunFolderError, match="no CAN log"):
        list(read_can_log(tmp_path))
