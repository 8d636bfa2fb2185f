"""CAN frames written as MDF4, read back by asammdf and python-can."""

import json

import can
import numpy as np
import pytest

from gyrobench.bench.exchange.can_export import TimedLog
from gyrobench.bench.exchange.signal_logs import _mf4_frames
from gyrobench.drivers.frames import EXTENDED_ID, FrameBlock, concatenate
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc
from tests.bench.exchange.frames import assert_same, frames_of, strange_parts

asammdf = pytest.importorskip("asammdf", reason="MDF4 needs: pip install 'gyrobench[mf4]'")

from asammdf import MDF  # noqa: E402

from gyrobench.bench.exchange.mf4 import _samples, write_mf4  # noqa: E402


@pytest.fixture(scope="module")
def mf4(two_dwells, dbc, tmp_path_factory):
    path = tmp_path_factory.mktemp("mf4") / "can.mf4"
    write_mf4(path, TimedLog(two_dwells), dbc, {"run": "a < b & c"})
    return path


def test_an_mdf4_file_holds_every_frame_with_its_calendar_time(mf4, messages):
    with can.MF4Reader(mf4) as reader:
        assert_same(list(reader), messages)


def test_frames_of_all_kinds_survive(dbc, tmp_path):
    path, parts = tmp_path / "can.mf4", strange_parts()
    write_mf4(path, parts, dbc, {})
    assert_same(frames_of(path), [message for _, frames in parts for message in frames.messages()])


def test_an_import_reads_the_data_frames_as_they_were(dbc, tmp_path):
    path, parts = tmp_path / "can.mf4", strange_parts()
    write_mf4(path, parts, dbc, {})
    written = concatenate([frames.data_frames() for _, frames in parts])
    assert_same_rows(_mf4_frames(path), written)


def test_an_import_reads_the_frames_of_all_buses_of_a_file_in_the_order_of_time(dbc, tmp_path):
    written = concatenate([frames.data_frames() for _, frames in strange_parts()])
    with MDF(version="4.10") as log:
        for bus in (0, 1):
            block = written.take(np.arange(len(written)) % 2 == bus)
            samples = _samples("CAN_DataFrame", block)
            times_s = block.timestamp_s - written.timestamp_s[0]
            log.append(asammdf.Signal(samples, times_s, name="CAN_DataFrame"))
        log.save(tmp_path / "two.mf4")
    assert_same_rows(_mf4_frames(tmp_path / "two.mf4"), written)


def assert_same_rows(read, written):
    assert len(read) == len(written) > 2
    assert np.any(read.arbitration_id & EXTENDED_ID)
    assert read.timestamp_s == pytest.approx(written.timestamp_s - written.timestamp_s[0], abs=2e-6)
    for name in ("id", "length", "data", "flags"):
        assert np.array_equal(read.rows[name], written.rows[name]), name


def test_asammdf_decodes_to_the_numbers_of_our_own_decoder(mf4, messages, dbc):
    codec, block = DbcCodec(load_dbc(dbc)), FrameBlock.from_messages(messages)
    with MDF(mf4) as log:
        decoded = log.extract_bus_logging({"CAN": [(dbc, 0)]})
    compared = 0
    for message in codec.message_names:
        if not len(codec.rows(block, message)):
            continue
        for name, values in codec.decode(block, message).items():
            known = np.isfinite(values)
            signal = decoded.get(f"{message}.{name}", raw=True).physical(ignore_value2text_conversions=True)
            np.testing.assert_allclose(signal.samples.astype(float), values[known], rtol=1e-12, atol=1e-12)
            times = block.timestamp_s[codec.rows(block, message)][known] - block.timestamp_s[0]
            np.testing.assert_allclose(signal.timestamps, times, atol=1e-6)
            compared += 1
    assert compared > 20
    assert decoded.get("VELOCITY_NE.VELOCITY_EAST").unit == "m/s"


def test_an_mdf4_file_says_where_it_came_from_and_brings_its_database(mf4, messages, dbc):
    with MDF(mf4) as log:
        assert log.header.start_time.timestamp() == pytest.approx(messages[0].timestamp, abs=1e-6)
        assert json.loads(log.header.description)["run"] == "a < b & c"
        content, name, _ = log.extract_attachment(0)
    assert name.name == dbc.name
    assert content == dbc.read_bytes()


def test_nothing_is_left_beside_the_file(mf4):
    assert [path.name for path in mf4.parent.iterdir()] == ["can.mf4"]


def test_a_log_without_frames_gives_a_file_without_groups(dbc, tmp_path):
    write_mf4(tmp_path / "can.mf4", [], dbc, {})
    with MDF(tmp_path / "can.mf4") as log:
        assert log.groups == []
