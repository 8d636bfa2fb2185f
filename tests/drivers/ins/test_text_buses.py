"""CAN adapters that send text: read in blocks, with the frames that python-can's own classes read."""

import os
import socket
import threading
import time
import tty
from contextlib import ExitStack

import can
import numpy as np
import pytest

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import NoReplyError, ReplyError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station.station import Station
from gyrobench.drivers.frames import FrameBlock, concatenate
from gyrobench.drivers.ins import can_bus
from gyrobench.drivers.ins.can_bus import block_receiver, close_bus, open_bus
from gyrobench.drivers.ins.can_ins import CanIns
from gyrobench.drivers.ins.readout import InsMode

SLCAN = (
    b"t00480102030405060708\rT1ABCDEF02FFee\r\rz\rr1238\rR0000000A0\r\at0050\r"
    b"x00000011100\rt0042aabb12f4\rV1013\rt7FF3000102\r"
)
SOCKETCAND = (
    b"< frame 123 1700000000.123456 0102030405060708 >< ok >< frame 1ABCDEF1 1700000001.5 11 >"
    b"< frame 7FF 1700000002.000001  >< error 20000004 1700000003.250000 ><frame>"
    b"< frame 004 1700000004.9 00ff >"
)
LIMIT_S = 30.0


class Slcan:
    """An adapter on a pseudo-terminal or a socket that sends what it is given."""

    def __init__(self, kind):
        self.kind, self.received = kind, b""
        if kind == "pty":
            self._far, self._slave = os.openpty()
            tty.setraw(self._slave)
            self.channel = os.ttyname(self._slave)
        else:
            self._server = socket.create_server(("127.0.0.1", 0))
            self.channel = f"socket://127.0.0.1:{self._server.getsockname()[1]}"
        self._connection = None

    def open(self, theirs=False, **options):
        kind = {"interface": "slcan", "channel": self.channel, "sleep_after_open": 0.0, **options}
        bus = can.Bus(ignore_config=True, **kind) if theirs else open_bus(clock=WallClock(), **kind)
        if self.kind != "pty":
            if self._connection:
                self._connection.close()
            self._connection, _ = self._server.accept()
            self._far = self._connection.fileno()
        return bus

    def send(self, data):
        while data:
            data = data[os.write(self._far, data) :]

    def read(self):
        return os.read(self._far, 1000)

    def close(self):
        for each in (self._connection, getattr(self, "_server", None)):
            if each:
                each.close()
        if self.kind == "pty":
            os.close(self._far)
            os.close(self._slave)


class Socketcand:
    """A server for one client."""

    def __init__(self):
        self._server = socket.create_server(("127.0.0.1", 0))
        self._connection = None

    def open(self, theirs=False, **options):
        host, port = self._server.getsockname()
        serving = threading.Thread(target=self._greet)
        serving.start()
        kind = {"interface": "socketcand", "channel": "can0", "host": host, "port": port, **options}
        bus = can.Bus(ignore_config=True, **kind) if theirs else open_bus(clock=WallClock(), **kind)
        serving.join()
        return bus

    def _greet(self):
        self.hang_up()
        self._connection, _ = self._server.accept()
        self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connection.sendall(b"< hi >")
        for _ in range(2):
            self._connection.recv(100)
            self._connection.sendall(b"< ok >")

    def send(self, data):
        self._connection.sendall(data)

    def read(self):
        return self._connection.recv(1000)

    def hang_up(self):
        if self._connection:
            self._connection.close()

    def close(self):
        self.hang_up()
        self._server.close()


ADAPTERS = {"slcan": (lambda: Slcan("pty"), SLCAN), "slcan on a socket": (lambda: Slcan("socket"), SLCAN),
            "socketcand": (Socketcand, SOCKETCAND)}  # fmt: skip


@pytest.fixture(params=ADAPTERS)
def adapter(request):
    make, text = ADAPTERS[request.param]
    adapter = make()
    adapter.text = text
    yield adapter
    adapter.close()


def received(bus, count):
    blocks, receive = [], block_receiver(bus)
    while sum(map(len, blocks)) < count:
        if len(block := receive()):
            blocks.append(block)
        else:
            time.sleep(0.001)
    return concatenate(blocks)


def expected_of(adapter):
    """What python-can's own class makes of the text."""
    bus = adapter.open(theirs=True)
    adapter.send(adapter.text)
    frames, misses = [], 0
    while misses < 20:
        frame = bus.recv(0.01)
        misses = 0 if frame else misses + 1
        frames += [frame] if frame else []
    close_bus(bus)
    return frames


def assert_same(block, messages, stamped):
    for ours, theirs in zip(block.messages(), messages, strict=True):
        if not stamped:
            assert ours.timestamp == pytest.approx(theirs.timestamp, abs=LIMIT_S)
        assert ours.equals(theirs, timestamp_delta=0.0 if stamped else None, check_channel=False)


def test_a_block_and_single_frames_are_those_of_python_cans_class(adapter):
    expected = expected_of(adapter)
    assert len(expected) >= 5
    for by_block in (True, False):
        bus = adapter.open()
        adapter.send(adapter.text)
        block = (
            received(bus, len(expected))
            if by_block
            else FrameBlock.from_messages([bus.recv(LIMIT_S) for _ in expected])
        )
        assert_same(block, expected, stamped=adapter.text is SOCKETCAND)
        close_bus(bus)


def test_a_poll_misses_nothing_that_the_thread_has_not_read_yet(adapter):
    """As after a stop of this process, which stops the thread too."""
    bus = adapter.open()
    for _ in range(20):
        adapter.send(adapter.text)
        assert len(block_receiver(bus)()) >= 5
    close_bus(bus)


def test_lines_that_come_in_pieces_are_whole_frames_in_order(adapter):
    bus = adapter.open()
    whole = received_at_once = None
    adapter.send(adapter.text)
    received_at_once = received(bus, 5)
    for begin in range(0, len(adapter.text), 7):
        adapter.send(adapter.text[begin : begin + 7])
    whole = received(bus, len(received_at_once))
    assert np.array_equal(whole.rows[["id", "length", "flags", "data"]],
                          received_at_once.rows[["id", "length", "flags", "data"]])  # fmt: skip
    close_bus(bus)


@pytest.fixture
def opened():
    """``opened(adapter)``: the adapter and its open bus, both closed after the test."""
    with ExitStack() as resources:

        def open_bus_of(adapter):
            resources.callback(adapter.close)
            bus = adapter.open()
            resources.callback(close_bus, bus)
            return adapter, bus

        yield open_bus_of


@pytest.mark.parametrize(
    ("make", "good", "garbage"),
    [
        (lambda: Slcan("pty"), b"t0040\r", b"t00" + 3000 * b"z" + b"\r"),
        (lambda: Slcan("socket"), b"t0040\r", b"t0048001122334455667g\r"),
        (Socketcand, b"< frame 004 17.5  >", b"< frame 004 1a.5  >"),
        (Socketcand, b"< frame 004 17.5 00 >", b"< frame 004 17.5 0g >"),
        (Socketcand, b"< frame 004 17.5 00 >", b"< error wrong frame >"),
    ],
)
def test_garbage_between_frames_is_reported_once_and_loses_none(opened, make, good, garbage):
    adapter, bus = opened(make())
    adapter.send(good + good + garbage + good)
    assert received(bus, 3).arbitration_id.tolist() == 3 * [4]
    with pytest.raises(ReplyError, match=r"no CAN frame: '[t<]"):
        received(bus, 1)
    adapter.send(good)
    assert len(received(bus, 1)) == 1


@pytest.mark.parametrize(
    ("make", "line", "wrong"),
    [
        (lambda: Slcan("socket"), b"t0040\r", b"t0048%04x\r"),
        (Socketcand, b"< frame 004 17.5 00 >", b"< frame 004 x%d 00 >"),
    ],
)
def test_frames_behind_many_different_invalid_lines_are_received(opened, make, line, wrong):
    adapter, bus = opened(make())
    adapter.send(b"".join(wrong % index for index in range(1000)) + 100 * line)
    assert len(received(bus, 100)) == 100
    assert bus.lost == 0


def test_frames_in_more_layouts_than_a_bus_has_count_as_lost(opened, monkeypatch):
    monkeypatch.setattr(can_bus, "_MAX_LAYOUTS", 3)
    adapter, bus = opened(Slcan("socket"))
    adapter.send(b"t00z\rt0040\rt004111\rt00421122\rt0043112233\rt0043112234\rt0040\r")
    assert len(received(bus, 4)) == 4
    with pytest.raises(ReplyError, match=r"no CAN frame: 't00z'.*2 frames are lost"):
        received(bus, 1)
    assert bus.lost == 2


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Slcan("socket"), b"t0040\r\nt0040\r\n \tt0040\r"),
        (Socketcand, b"< frame 004 17.5 00 >\n< frame 004 17.5 00 >\r\n  < frame 004 17.5 00 >"),
    ],
)
def test_blanks_between_frames_are_passed_over(opened, make, text):
    adapter, bus = opened(make())
    adapter.send(text)
    assert len(received(bus, 3)) == 3


def test_filters_apply_to_blocks(adapter):
    filters = [{"can_id": 0x004, "can_mask": 0x7FF, "extended": False}]
    bus = adapter.open(can_filters=filters)
    adapter.send(adapter.text)
    assert set(received(bus, 1).arbitration_id.tolist()) == {0x004}
    close_bus(bus)


def test_frames_are_sent_as_python_can_sends_them(adapter):
    message = can.Message(arbitration_id=0x200, data=b"\x02\x10", is_extended_id=False)
    sent = []
    for theirs in (True, False):
        bus = adapter.open(theirs=theirs)
        bus.send(message, timeout=1.0)
        text = b""
        while not text.rstrip(b"\r >").endswith(b"10"):
            text += adapter.read()
        sent.append(text)
        close_bus(bus)
    assert sent[0].endswith(sent[1]) or sent[1].endswith(sent[0])


def test_a_server_that_hangs_up_is_an_error_after_its_frames():
    server = Socketcand()
    bus = server.open()
    server.send(SOCKETCAND)
    server.hang_up()
    assert len(received(bus, 5)) == 5
    with pytest.raises(OSError, match="closed"):
        received(bus, 1)
    close_bus(bus)
    server.close()


def test_frames_that_find_the_queue_full_are_counted_and_reported(adapter, monkeypatch, signal_map, codec):
    monkeypatch.setattr(can_bus, "_MAX_QUEUED_BYTES", 5000)
    monkeypatch.setattr(can_bus, "_MAX_READ_BYTES", 1000)
    driver = CanIns(bus := adapter.open(), signal_map, codec.database, WallClock())
    line = adapter.text[: 1 + min(adapter.text.index(end) for end in (b"\r", b">") if end in adapter.text)]
    sent = 600
    for _ in range(0, sent, 20):
        adapter.send(20 * line)
    while not bus.lost:
        pass
    count, reported = 0, 0
    while count + bus.lost < sent or not reported:
        try:
            count += len(driver.poll())
        except ReplyError as error:
            reported += "lost" in str(error)
    assert count + bus.lost == sent
    assert 0 < bus.max_queued_bytes <= 5000
    driver.close()


@pytest.mark.parametrize(
    ("answer", "is_refused"), [(b"\a", True), (b"z\r", False), (b"F04\rs1a\rz\r", False)]
)
def test_a_command_that_an_slcan_adapter_refuses_says_so(answer, is_refused):
    adapter, station = Slcan("pty"), Station(find_document("stations", "emulated"))
    section, clock = station.file.ins, WallClock(speed=50.0)
    driver = CanIns(adapter.open(), section.signals, station.database(), clock, section.commands)
    adapter.send(b"\a")  # for a command to close a channel that is closed
    while not driver._bus.refusals:
        driver.poll()
    waiting = driver.enter_stepwise(InsMode.ALIGN)
    next(waiting)
    adapter.send(answer)
    with pytest.raises(NoReplyError, match="no confirmation of 'align'") as raised:
        driver._complete(waiting)
    assert ("the adapter refuses to send, as in listen-only mode" in str(raised.value)) == is_refused
    driver.close()
    adapter.close()


def test_frames_of_other_nodes_are_no_sign_of_life_of_the_ins(signal_map, codec):
    adapter = Slcan("pty")
    driver = CanIns(adapter.open(), signal_map, codec.database, clock := WallClock())
    blocks = []
    driver.on_frames = blocks.append

    def sent(line):
        adapter.send(line)
        count = sum(map(len, blocks))
        while sum(map(len, blocks)) == count:
            driver.poll()

    sent(b"t30080102030405060708\r")
    assert driver.status().age_s == float("inf")
    assert (
        driver.describe_foreign_frames() == "frames arrive, such as 0x300, but none that is in the DBC file"
    )
    sent(b"t00480102030405060708\r")
    heard_s = clock.now()
    sent(b"t30080102030405060708\rT0000000480102030405060708\r")
    now_s = clock.now()
    assert driver.status().age_s >= now_s - heard_s
    assert driver.frames == 1
    assert sum(map(len, blocks)) >= 3  # all are in the log
    driver.close()
    adapter.close()


@pytest.mark.parametrize("length", [8, 0])
def test_an_identifier_of_another_length_is_named(signal_map, codec, length):
    adapter = Slcan("pty")
    driver = CanIns(adapter.open(), signal_map, codec.database, WallClock())
    adapter.send(b"T00000004%d" % length + b"00" * length + b"\r")
    while not driver.has_other_format:
        driver.poll()
    assert driver.describe_foreign_frames() == (
        "0x004 arrives as an identifier of 29 bits, and has 11 bits in the DBC file"
    )
    driver.forget()
    assert driver.describe_foreign_frames() == ""
    driver.close()
    adapter.close()
