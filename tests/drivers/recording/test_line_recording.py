"""Recordings of lines, over pseudo-terminals."""

import os
import tty

import pytest

from gyrobench.bench.foundations.clock import Deadline, WallClock
from gyrobench.bench.foundations.errors import NoReplyError, RunFolderError
from gyrobench.drivers.recording.recording_file import RecordingHeader, read_recording, recording_lines
from gyrobench.drivers.serial_line import SerialLine

HEADERS = {"chamber": RecordingHeader(instrument="chamber", dialect="watlow_f4")}


@pytest.fixture
def instrument():
    """The far end of a pseudo-terminal, and the name of the near one."""
    far, near = os.openpty()
    tty.setraw(near)
    yield far, os.ttyname(near)
    os.close(far)
    os.close(near)


def exchange(line, far, question, reply):
    line.write(question)
    assert os.read(far, 100) == question
    os.write(far, reply)
    return line.read(len(reply), Deadline(line.clock, 120.0))


def test_all_transfers_are_recorded_in_order_with_their_times(instrument, tmp_path):
    far, url = instrument
    with recording_lines(tmp_path, HEADERS), SerialLine("chamber", url, WallClock(), 19200, "N") as line:
        exchange(line, far, b"one", b"eins")
        line.clock.sleep(0.05)
        exchange(line, far, b"two\r", b"zwei")
    recording = read_recording(tmp_path / "chamber-001.rec")
    assert [(t.is_sent, t.data) for t in recording.transfers] == [
        (True, b"one"),
        (False, b"eins"),
        (True, b"two\r"),
        (False, b"zwei"),
    ]
    assert recording.transfers[2].time_s - recording.transfers[1].time_s >= 0.05
    header = recording.header
    assert (header.dialect, header.baudrate, header.parity) == ("watlow_f4", 19200, "N")
    assert header.recorded_utc.startswith("20")


def test_discarded_input_is_recorded_too(instrument, tmp_path):
    far, url = instrument
    with recording_lines(tmp_path, HEADERS), SerialLine("chamber", url, WallClock()) as line:
        os.write(far, b"noise")
        while line._port.in_waiting < len(b"noise"):
            line.clock.sleep(0.005)
        line.discard_input()
        with pytest.raises(NoReplyError):
            line.read(1, Deadline(line.clock, 0.02))
    assert [t.data for t in read_recording(tmp_path / "chamber-001.rec").transfers] == [b"noise"]


def test_each_opening_has_a_separate_file(instrument, tmp_path):
    far, url = instrument
    with recording_lines(tmp_path, HEADERS), SerialLine("chamber", url, WallClock()) as line:
        exchange(line, far, b"a", b"b")
        line.reopen()
        exchange(line, far, b"c", b"d")
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["chamber-001.rec", "chamber-002.rec"]
    assert [t.data for t in read_recording(tmp_path / "chamber-002.rec").transfers] == [b"c", b"d"]


def test_other_lines_and_later_ones_are_not_recorded(instrument, tmp_path):
    _, url = instrument
    with recording_lines(tmp_path, HEADERS), SerialLine("rate table", url, WallClock()) as line:
        line.write(b"x")
    with SerialLine("chamber", url, WallClock()) as line:
        line.write(b"x")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_can_not_be_created_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunFolderError), recording_lines(tmp_path / "file", HEADERS):
        pass


def test_a_full_disk_ends_the_recording_and_not_the_line(instrument, tmp_path):
    far, url = instrument
    (tmp_path / "chamber-001.rec").symlink_to("/dev/full")
    full = tmp_path / "full"
    full.mkdir()
    with recording_lines(full, HEADERS), SerialLine("chamber", url, WallClock()) as line:
        line._recording._file.close()
        line._recording._file = open("/dev/full", "w", buffering=1)  # noqa: PTH123, SIM115
        assert exchange(line, far, b"one", b"eins") == b"eins"
        assert exchange(line, far, b"two", b"zwei") == b"zwei"
