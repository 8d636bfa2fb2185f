"""The CAN bus of the INS: blocks of frames, and an slcan adapter that goes away."""

import contextlib
import os
import tty
from pathlib import Path

import can
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import ConnectionFailedError, ReplyError
from gyrobench.drivers.ins.can_bus import EXTENDED_ID, FrameBlock, close_bus, concatenate, open_bus
from gyrobench.drivers.ins.can_ins import CanIns

FRAME = b"t00480102030405060708\r"


class Adapter:
    """The far end of an slcan adapter's port."""

    def __init__(self):
        self.plug_in()

    def plug_in(self):
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.channel = os.ttyname(self._slave)

    def send(self, data):
        os.write(self._master, data)

    def pull(self):
        os.close(self._slave)
        os.close(self._master)

    def bus(self):
        return open_bus("slcan", self.channel, VirtualClock(), 500_000, sleep_after_open=0.0)


@pytest.fixture
def adapter():
    return Adapter()


@pytest.fixture
def batches():
    return []


@pytest.fixture
def driver(adapter, signal_map, codec, batches):
    driver = CanIns(adapter.bus(), signal_map, codec.database, VirtualClock(), on_frames=batches.append)
    yield driver
    driver.close()
    adapter.pull()


def open_descriptors():
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def receive(driver, count):
    received = []
    while len(received) < count:
        received += driver.poll()
    return received


def poll_for_a_while(driver):
    for _ in range(20):
        driver.poll()


def test_a_reopened_bus_replaces_a_lost_one(driver, adapter, batches):
    adapter.send(3 * FRAME)
    receive(driver, 3)
    adapter.pull()
    with pytest.raises(ConnectionFailedError, match="went away"):
        driver.poll()
    adapter.plug_in()
    driver.replace_bus(adapter.bus())
    adapter.send(2 * FRAME)
    receive(driver, 2)
    assert driver.health().frames == 5
    assert sum(map(len, batches)) == 5


def test_a_hundred_adapters_that_went_away_leak_no_descriptor(driver, adapter):
    before = open_descriptors()
    for _ in range(100):
        adapter.pull()
        with pytest.raises(ConnectionFailedError):
            driver.poll()
        with pytest.raises(ConnectionFailedError, match="can't open"):
            open_bus("slcan", "/dev/absent", VirtualClock(), sleep_after_open=0.0)
        adapter.plug_in()
        driver.replace_bus(adapter.bus())
    assert open_descriptors() == before


def test_a_bus_can_be_closed_twice_also_after_its_adapter_went_away(adapter):
    bus = adapter.bus()
    adapter.pull()
    close_bus(bus)
    close_bus(bus)


@pytest.mark.parametrize("garbage", [b"\xff\xfe\x80\r", b"t12\r", b"t0049\r", b"txyz8\r", b"T\r", b"dFFF\r"])
def test_a_line_that_is_no_frame_is_an_error_once_and_the_next_frames_are_read(driver, adapter, garbage):
    adapter.send(garbage)
    with contextlib.suppress(ReplyError):
        poll_for_a_while(driver)
    poll_for_a_while(driver)
    adapter.send(2 * FRAME)
    assert [message.arbitration_id for message in receive(driver, 2)] == [4, 4]


def test_frames_before_a_failure_reach_the_sink(driver, adapter, batches):
    adapter.send(2 * FRAME + b"\xff\r")
    with pytest.raises(ReplyError, match="no CAN frame"):
        poll_for_a_while(driver)
    assert sum(map(len, batches)) == 2


def test_an_interface_that_does_not_exist_cant_be_opened():
    with pytest.raises(ConnectionFailedError, match="absent"):
        open_bus("absent", "can0", VirtualClock())


def test_frames_and_state_from_before_stay_with_a_new_bus(signal_map, codec, frames_of, to_messages):
    clock = VirtualClock()
    near = open_bus("virtual", "first", clock)
    with can.Bus("first", interface="virtual", ignore_config=True, preserve_timestamps=True) as far:
        driver = CanIns(near, signal_map, codec.database, clock)
        far.send(to_messages(frames_of("INS_STATUS", 0.0, {"MODE": 3}))[0])
        driver.poll()
    driver.replace_bus(open_bus("virtual", "second", clock))
    assert driver.health().frames == 1
    assert driver.status().mode.name == "NAVIGATE"
    driver.close()


messages = st.builds(
    can.Message,
    timestamp=st.floats(0, 1e9),
    arbitration_id=st.integers(0, 0x7FF),
    is_extended_id=st.booleans(),
    is_error_frame=st.booleans(),
    data=st.binary(max_size=8),
)


@given(st.lists(messages, max_size=20))
def test_every_data_frame_keeps_its_contents_and_order(batch):
    block = FrameBlock.from_messages(batch)
    kept = [m for m in batch if not m.is_error_frame]
    assert block.timestamp_s.tolist() == [m.timestamp for m in kept]
    assert block.arbitration_id.tolist() == [
        m.arbitration_id | (EXTENDED_ID if m.is_extended_id else 0) for m in kept
    ]
    assert [bytes(row[:n]) for row, n in zip(block.data, block.length, strict=True)] == [
        bytes(m.data) for m in kept
    ]
    assert all(not row[n:].any() for row, n in zip(block.data, block.length, strict=True))


def test_frames_that_are_not_classic_data_frames_are_left_out():
    block = FrameBlock.from_messages(
        [
            can.Message(arbitration_id=1, is_remote_frame=True, dlc=8),
            can.Message(arbitration_id=2, is_error_frame=True, data=bytes(8)),
            can.Message(arbitration_id=3, is_fd=True, data=bytes(8)),
            can.Message(arbitration_id=4, data=bytes(300)),
            can.Message(arbitration_id=5, data=bytes(8), is_extended_id=False),
        ]
    )
    assert block.arbitration_id.tolist() == [5]


def test_blocks_join_in_order_and_split_by_identifier():
    def block(identifier, stamps):
        return FrameBlock.from_messages(
            [
                can.Message(timestamp=t, arbitration_id=identifier, is_extended_id=False, data=bytes(8))
                for t in stamps
            ]
        )

    joined = concatenate([block(4, [1.0, 2.0]), block(7, [3.0])])
    assert len(joined) == 3
    assert joined.with_id(4).timestamp_s.tolist() == [1.0, 2.0]
    assert len(joined.with_id(4 | EXTENDED_ID)) == 0
    assert np.array_equal(joined.take(slice(1, None)).timestamp_s, [2.0, 3.0])
    assert len(concatenate([])) == 0
