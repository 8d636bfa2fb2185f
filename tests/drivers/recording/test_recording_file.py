import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers.recording.recording_file import (
    Call,
    RecordingHeader,
    Transfer,
    join_transfers,
    read_recording,
    recording_text,
)

HEADER = RecordingHeader(
    instrument="chamber",
    dialect="watlow_f4",
    options={"address": 3},
    note="ein Gerät: 'quirky' # really",
    calls=[Call(ask="read", gives="1"), Call(ask="limits_c", fails="NoReplyError")],
)


def written(tmp_path, text):
    path = tmp_path / "test.rec"
    path.write_text(text)
    return path


@given(
    st.lists(st.tuples(st.integers(0, 10**9), st.booleans(), st.binary(min_size=1, max_size=40)), max_size=20)
)
def test_what_is_written_is_read_again(tmp_path_factory, pieces):
    transfers = [Transfer(us / 1e6, sent, data) for us, sent, data in sorted(pieces, key=lambda p: p[0])]
    path = tmp_path_factory.mktemp("rec") / "test.rec"
    path.write_text(recording_text(HEADER, transfers))
    recording = read_recording(path)
    assert recording.header == HEADER
    assert [(t.time_s, t.is_sent, t.data) for t in recording.transfers] == [
        (t.time_s, t.is_sent, t.data) for t in transfers
    ]


def test_transfers_know_their_line(tmp_path):
    path = written(tmp_path, recording_text(HEADER, [Transfer(0.0, True, b"a"), Transfer(0.5, False, b"b")]))
    lines = path.read_text().splitlines()
    for transfer in read_recording(path).transfers:
        assert transfer.data.hex() in lines[transfer.line - 1]


def test_remarks_and_empty_lines_are_left_out(tmp_path):
    path = written(tmp_path, "recording: 1\ninstrument: table\n---\n# a remark\n\n 0.5 > 41 42\n")
    (transfer,) = read_recording(path).transfers
    assert (transfer.time_s, transfer.is_sent, transfer.data, transfer.line) == (0.5, True, b"AB", 6)


def test_a_folder_is_refused_and_what_to_give_is_named(tmp_path):
    with pytest.raises(DocumentError, match=r"is a folder\. Give a recording"):
        read_recording(tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("instrument: table\n", r":1:1: not a recording: the line '---'"),
        ("recording: 2\ninstrument: table\n---\n", r":1:1: 'recording' must be 1"),
        ("instrument: table\ncolour: red\n---\n", r":2:1: unknown key 'colour'"),
        ("instrument: toaster\n---\n", r":1:1: 'instrument' must be"),
        ("instrument: table\n---\n0.1 > 4\n", r":3:1: not a transfer"),
        ("instrument: table\n---\n0.1 = 41\n", r":3:1: not a transfer"),
        ("instrument: table\n---\n0.2 > 41\n0.1 < 42\n", r":4:1: its time is before that of the line above"),
    ],
)
def test_a_mistake_is_reported_with_its_place(tmp_path, text, message):
    with pytest.raises(DocumentError, match=rf"test\.rec{message}"):
        read_recording(written(tmp_path, text))


def test_a_file_that_is_no_text_is_refused(tmp_path):
    path = tmp_path / "test.rec"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DocumentError, match="is not UTF-8 text"):
        read_recording(path)


def test_pieces_of_one_reply_are_joined_and_replies_are_not():
    pieces = [
        Transfer(1.0, True, b"?"),
        Transfer(1.01, False, b"he"),
        Transfer(1.0102, False, b"ad"),
        Transfer(1.5, False, b"late"),
    ]
    assert [t.data for t in join_transfers(pieces)] == [b"?", b"head", b"late"]
