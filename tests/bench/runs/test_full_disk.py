"""What a run leaves on a disk that fills up, on a real file system with room for 64 KiB."""

import contextlib

import numpy as np
import pytest

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import write_whole
from gyrobench.bench.runs.can_log import CanLog, read_can_log
from gyrobench.bench.runs.journal import Journal, read_journal
from gyrobench.bench.runs.telemetry import TELEMETRY_COLUMNS, Telemetry, read_telemetry
from gyrobench.drivers.frames import FrameBlock


def fill(disk):
    """Take all the room that is left; returns the file that has it."""
    path = disk / "ballast"
    with path.open("wb", buffering=0) as stream, contextlib.suppress(OSError):
        while stream.write(bytes(4096)):
            pass
    return path


def test_a_file_on_a_full_disk_stays_as_it_was(full_disk):
    path = full_disk / "table.csv"
    write_whole(path, b"old")
    with pytest.raises(RunFolderError, match="No space left on device"):
        write_whole(path, bytes(100_000))
    assert path.read_bytes() == b"old"
    assert list(full_disk.iterdir()) == [path]


def test_a_journal_continues_once_there_is_room_again(full_disk):
    path = full_disk / "journal.jsonl"
    with Journal(path, VirtualClock()) as journal:
        journal.record("a")
        ballast = fill(full_disk)
        with pytest.raises(RunFolderError, match="No space left on device"):
            journal.record("b", text="x" * 10_000)
        assert [entry["event"] for entry in read_journal(path)] == ["a"]
        ballast.unlink()
        journal.record("c")
    assert [entry["event"] for entry in read_journal(path)] == ["a", "c"]


def test_a_log_keeps_what_it_has_and_continues_in_a_new_part(full_disk):
    def frames(begin, count):
        numbers = np.arange(begin, begin + count)
        return FrameBlock.from_columns(numbers * 0.01, 1, 8, numbers.astype("<u8")[:, None].view(np.uint8))

    log = CanLog(full_disk / "can")
    log.write(frames(0, 100))
    log.cut()
    log.write(frames(100, 300))
    ballast = fill(full_disk)
    with pytest.raises(RunFolderError, match="No space left on device"):
        log.write(frames(400, 100_000))
    ballast.unlink()
    log.write(frames(200_000, 50))
    log.cut()
    parts = {
        number: part.data.copy().view("<u8")[:, 0].tolist()
        for number, part in read_can_log(full_disk / "can")
    }
    assert parts[1] == list(range(100))
    assert parts[2] == list(range(100, 100 + len(parts[2])))
    assert parts[3] == list(range(200_000, 200_050))


def test_telemetry_is_written_once_there_is_room_again(full_disk):
    telemetry = Telemetry(full_disk / "telemetry")

    def add(time_s):
        telemetry.add(dict.fromkeys(TELEMETRY_COLUMNS, time_s))

    add(0.0)
    telemetry.flush()
    add(1.0)
    ballast = fill(full_disk)
    with pytest.raises(RunFolderError, match="No space left on device"):
        telemetry.flush()
    assert read_telemetry(full_disk / "telemetry")["time_s"].tolist() == [0.0]
    ballast.unlink()
    add(2.0)
    telemetry.flush()
    assert read_telemetry(full_disk / "telemetry")["time_s"].tolist() == [0.0, 1.0, 2.0]
