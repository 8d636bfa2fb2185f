"""BLF files in bulk: what python-can writes and reads is written and read the same."""

import io
import struct
import zlib

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.runs import can_log
from gyrobench.bench.runs.can_log import BlfWriter, read_blf
from gyrobench.drivers.frames import ERROR_FRAME, EXTENDED_ID, REMOTE_FRAME, FrameBlock

BEGIN_S = 1_700_000_000.123_456


@st.composite
def blocks(draw):
    """Frames of all kinds, now and then a remote or an error frame."""
    count = draw(st.integers(1, 60))
    seed = draw(st.integers(0, 2**32 - 1))
    odd = draw(st.sampled_from([0.0, 0.1, 1.0]))
    rng = np.random.default_rng(seed)
    extended = rng.random(count) < 0.3
    identifiers = np.where(
        extended, rng.integers(0, 2**29, count) | EXTENDED_ID, rng.integers(0, 2**11, count)
    )
    flags = np.where(rng.random(count) < odd, rng.choice([REMOTE_FRAME, ERROR_FRAME], count), 0)
    length = rng.integers(0, 9, count)
    filled = (np.arange(8) < length[:, np.newaxis]) & (flags != REMOTE_FRAME)[:, np.newaxis]
    data = np.where(filled, rng.integers(0, 256, (count, 8)), 0)
    begin_s = draw(st.sampled_from([0.0, 12.5, BEGIN_S]))
    return FrameBlock.from_columns(
        np.round(begin_s + np.cumsum(rng.random(count)), 6), identifiers, length, data, flags
    )


def written(parts):
    stream = io.BytesIO()
    writer = BlfWriter(stream)
    for part in parts:
        writer.write(part)
    writer.finish()
    return stream.getvalue()


def written_by_python_can(messages, **options):
    class Kept(io.BytesIO):
        def close(self):
            pass

    with can.BLFWriter(stream := Kept(), **options) as writer:
        for message in messages:
            writer.on_message_received(message)
    return stream.getvalue()


def assert_same(block, messages):
    for ours, theirs in zip(block.messages(), messages, strict=True):
        assert ours.equals(theirs, timestamp_delta=1e-6, check_channel=False)


@given(blocks(), st.integers(0, 60))
def test_python_can_reads_what_went_in_and_so_do_we(block, first):
    content = written([block.take(slice(0, first)), block.take(slice(first, None))])
    with can.BLFReader(io.BytesIO(content)) as reader:
        theirs = list(reader)
    assert reader.object_count == len(theirs)
    assert reader.file_size == len(content)
    assert_same(block, theirs)
    ours = read_blf(content)[0]
    assert_same(ours, theirs)
    assert ours.timestamp_s.tolist() == [message.timestamp for message in theirs]


@given(blocks(), st.sampled_from([200, 1000, 128 * 1024]))
def test_what_python_can_wrote_is_read_also_where_objects_cross_containers(block, container):
    content = written_by_python_can(block.messages(), max_container_size=container)
    with can.BLFReader(io.BytesIO(content)) as reader:
        assert_same(read_blf(content)[0], list(reader))


def test_frames_of_python_can_that_are_longer_are_left_out_and_the_others_read():
    messages = [
        can.Message(timestamp=BEGIN_S, arbitration_id=1, data=bytes(8), is_extended_id=False),
        can.Message(timestamp=BEGIN_S, arbitration_id=2, data=bytes(64), is_fd=True),
        can.Message(timestamp=BEGIN_S, arbitration_id=3, data=b"\x01", is_extended_id=False),
    ]
    assert read_blf(written_by_python_can(messages))[0].arbitration_id.tolist() == [1, 3]


@pytest.mark.parametrize("cut", [1, 40, 400])
def test_a_file_cut_in_a_container_gives_the_frames_of_those_before(cut):
    numbers = np.arange(9000)
    frames = FrameBlock.from_columns(
        BEGIN_S + numbers * 0.001, 5, 8, numbers.astype("<u8")[:, np.newaxis].view(np.uint8)
    )
    content = written([frames.take(slice(0, 3000)), frames.take(slice(3000, None))])
    read, is_whole = read_blf(content[:-cut])
    assert not is_whole
    assert 3000 < len(read) < 9000
    assert np.array_equal(read.data, frames.data[: len(read)])
    assert read.timestamp_s == pytest.approx(frames.timestamp_s[: len(read)], abs=1e-6)


@given(blocks(), st.sampled_from([0, -1]), st.sampled_from([200, 128 * 1024]))
def test_files_with_and_without_compression_are_read_whole(block, level, container):
    messages = block.messages()
    content = written_by_python_can(messages, compression_level=level, max_container_size=container)
    read, is_whole = read_blf(content)
    assert is_whole
    assert len(read) == len(messages)
    with can.BLFReader(io.BytesIO(content)) as reader:
        assert_same(read, list(reader))


def test_a_container_of_many_megabytes_is_read():
    numbers = np.arange(400_000)
    frames = FrameBlock.from_columns(BEGIN_S + numbers * 0.001, numbers % 7, 8, np.zeros((400_000, 8)))
    content = written([frames])
    objects = zlib.compress(can_log._unpack_containers(content, 144)[0], 1)
    size = 32 + len(objects)
    container = struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, size, 10, 2, 400_000 * 48) + objects
    read, is_whole = read_blf(content[:144] + container)
    assert is_whole
    assert np.array_equal(read.arbitration_id, frames.arbitration_id)


def test_a_longer_file_header_is_passed_over():
    frames = FrameBlock.from_columns(BEGIN_S + np.arange(10), 5, 8, np.zeros((10, 8)))
    content = written([frames])
    longer = content[:4] + struct.pack("<L", 160) + content[8:144] + bytes(16) + content[144:]
    read, is_whole = read_blf(longer)
    assert is_whole
    assert len(read) == 10


def test_a_container_of_an_unknown_form_ends_the_file_which_then_is_not_whole():
    frames = FrameBlock.from_columns(BEGIN_S + np.arange(10), 5, 8, np.zeros((10, 8)))
    content = written([frames, frames])
    second = content.index(b"LOBJ", 150)
    for place, value in ((second + 12, 200), (second + 16, 7)):  # kind of the object; compression
        changed = bytearray(content)
        changed[place] = value
        read, is_whole = read_blf(bytes(changed))
        assert len(read) == 10
        assert not is_whole
