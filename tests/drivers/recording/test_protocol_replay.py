"""A recording as a serial port, in virtual time."""

import pytest

from gyrobench.bench.foundations.clock import Deadline, VirtualClock, WallClock
from gyrobench.bench.foundations.errors import ConnectionFailedError, NoReplyError
from gyrobench.drivers.recording.recording_file import RecordingHeader, Transfer, recording_text
from gyrobench.drivers.serial_line import SerialLine


@pytest.fixture
def line(tmp_path):
    """Open a line to a recording of these transfers."""
    opened = []

    def start(*transfers, clock=None):
        path = tmp_path / "a recording.rec"
        header = RecordingHeader(instrument="table")
        path.write_text(recording_text(header, [Transfer(*transfer) for transfer in transfers]))
        opened.append(SerialLine("rate table", f"replay://{path}", clock or VirtualClock()))
        return opened[-1]

    yield start
    for each in opened:
        each.close()


def read(line, count, within_s=5.0):
    return line.read(count, Deadline(line.clock, within_s))


def test_it_replies_after_the_recorded_delay_at_any_time(line):
    it = line((1.0, True, b"ask"), (1.25, False, b"reply"), (2.0, True, b"again"), (2.5, False, b"yes"))
    it.clock.sleep(100.0)
    it.write(b"ask")
    assert read(it, 5) == b"reply"
    assert it.clock.now() == pytest.approx(100.25)
    it.clock.sleep(50.0)
    it.write(b"again")
    assert read(it, 3) == b"yes"
    assert it.clock.now() == pytest.approx(150.75)


def test_on_a_fast_wall_clock_the_delay_is_that_of_the_clock(line):
    it = line((0.0, True, b"ask"), (2.0, False, b"reply"), clock=WallClock(speed=50.0))
    start_s = it.clock.now()
    it.write(b"ask")
    assert read(it, 5) == b"reply"
    assert it.clock.now() - start_s >= 2.0


def test_a_reply_after_the_time_out_is_no_reply(line):
    it = line((0.0, True, b"ask"), (1.5, False, b"reply"), (3.5, True, b"ask"), (3.6, False, b"fresh"))
    it.write(b"ask")
    with pytest.raises(NoReplyError):
        read(it, 5, within_s=1.0)
    it.await_silence(1.0, 10.0)
    it.write(b"ask")
    assert read(it, 5) == b"fresh"


def test_unrequested_bytes_are_replayed_unrequested(line):
    it = line((0.5, False, b"hello"), (2.0, True, b"ask"), (2.1, False, b"reply"))
    assert read(it, 5) == b"hello"
    it.write(b"ask")
    assert read(it, 5) == b"reply"


def test_requests_may_be_written_in_pieces_and_two_at_once(line):
    it = line((0.0, True, b"first"), (0.0, True, b"second"), (0.1, False, b"ok"))
    it.write(b"fir")
    it.write(b"stsecond")
    assert read(it, 2) == b"ok"


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (
            b"asq",
            r"deviates from the recording: .*recording\.rec:5: expected 61 73 6b .*; got 61 73 71 \('asq'\)",
        ),
        (b"ask more", r"a recording\.rec:6: 20 6d 6f 72 65 .* is sent before the reply 72 65 "),
    ],
)
def test_another_request_fails_with_the_place_and_both_texts(line, asked, message):
    it = line((0.0, True, b"ask"), (0.2, False, b"reply"))
    with pytest.raises(ConnectionFailedError, match=message):
        it.write(asked)


def test_a_request_after_the_end_fails(line):
    it = line((0.0, True, b"ask"))
    it.write(b"ask")
    with pytest.raises(ConnectionFailedError, match="the recording ends before 6d 6f 72 65"):
        it.write(b"more")


def test_a_missing_or_wrong_recording_can_not_be_opened(tmp_path):
    wrong = tmp_path / "wrong.rec"
    wrong.write_text("instrument: toaster\n---\n")
    for url, message in (
        (f"replay://{tmp_path}/absent.rec", "can't be read"),
        (f"replay://{wrong}", ":1:1: "),
    ):
        with pytest.raises(ConnectionFailedError, match=message):
            SerialLine("chamber", url, VirtualClock())
    with pytest.raises(ConnectionFailedError, match="no clock is named"):
        SerialLine("chamber", f"replay://{wrong}?clock=sundial", VirtualClock())
