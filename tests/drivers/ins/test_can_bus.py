"""The CAN bus of the INS: blocks of frames, and an slcan adapter that goes away."""

import os
import tty
from pathlib import Path

import can
import pytest

from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import ConnectionFailedError, ReplyError
from gyrobench.drivers.frames import concatenate
from gyrobench.drivers.ins.can_bus import close_bus, open_bus
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
    driver = CanIns(adapter.bus(), signal_map, codec.database, VirtualClock())
    driver.on_frames = batches.append
    yield driver
    driver.close()
    adapter.pull()


def open_descriptors():
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def receive(driver, count):
    blocks = []
    while sum(map(len, blocks)) < count:
        blocks.append(driver.poll())
    return concatenate(blocks)


def poll_until_error(driver):
    while True:
        driver.poll()


def test_a_reopened_bus_replaces_a_lost_one(driver, adapter, batches):
    adapter.send(3 * FRAME)
    receive(driver, 3)
    adapter.pull()
    with pytest.raises(ConnectionFailedError, match="went away"):
        poll_until_error(driver)
    adapter.plug_in()
    driver.replace_bus(adapter.bus())
    adapter.send(2 * FRAME)
    receive(driver, 2)
    assert driver.frames == 5
    assert sum(map(len, batches)) == 5


def test_a_second_reader_of_an_adapter_is_refused(driver, adapter):
    with pytest.raises(ConnectionFailedError, match="another program uses it"):
        adapter.bus()
    adapter.send(FRAME)


@pytest.mark.parametrize("count", [10, pytest.param(100, marks=pytest.mark.long)])
def test_adapters_that_went_away_leak_no_descriptor(driver, adapter, count):
    before = open_descriptors()
    for _ in range(count):
        adapter.pull()
        with pytest.raises(ConnectionFailedError):
            poll_until_error(driver)
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


@pytest.mark.parametrize(
    "garbage", [b"\xff\xfe\x80\r", b"t12\r", b"t0049\r", b"txyz8\r", b"T\r", b"t0048ff\r", b"\r\xe4\r"]
)
def test_a_line_that_is_no_frame_is_an_error_once_and_the_next_frames_are_read(driver, adapter, garbage):
    adapter.send(FRAME + garbage + FRAME)
    assert receive(driver, 2).arbitration_id.tolist() == [4, 4]
    with pytest.raises(ReplyError, match="no CAN frame"):
        poll_until_error(driver)
    adapter.send(2 * FRAME)
    assert receive(driver, 2).arbitration_id.tolist() == [4, 4]


def test_frames_before_a_failure_reach_the_sink(driver, adapter, batches):
    adapter.send(2 * FRAME + b"\xff\r")
    with pytest.raises(ReplyError, match="no CAN frame"):
        poll_until_error(driver)
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
    assert driver.frames == 1
    assert driver.status().mode.name == "NAVIGATE"
    driver.close()
