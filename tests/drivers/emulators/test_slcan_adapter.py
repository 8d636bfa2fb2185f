import os
import select
from pathlib import Path

import can
import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gyrobench.drivers.ins
from gyrobench.drivers.emulators.can_adapters import SlcanAdapter
from gyrobench.drivers.emulators.can_ins import CanInsEmulator
from gyrobench.drivers.emulators.dialect import Connection
from gyrobench.drivers.emulators.world.inertial_unit import Mode
from tests.drivers.emulators.quick_world import LIMIT_S

DBC = cantools.database.load_file(Path(gyrobench.drivers.ins.__file__).with_name("gyrobench_ins.dbc"))
OK, BELL = b"\r", b"\a"


class Bench:
    """A booted INS behind an slcan adapter."""

    def __init__(self, world):
        self.world, self.unit = world, world.unit
        self.ins = CanInsEmulator(world)
        self.sent = []
        self.ins.listeners.append(lambda block: self.sent.extend(block.messages()))
        self.adapter = SlcanAdapter(self.ins, Connection())
        world.power_unit(True)
        world.advance(2.5)
        assert self.unit.mode is Mode.STANDBY

    def ask(self, line):
        return self.adapter.feed(line.encode() + OK, 0.0)


@pytest.fixture
def bench(make_world):
    return Bench(make_world(ins={"boot_s": 1.0}))


class PythonCan:
    """python-can's own slcan interface at the other end of a pseudo-terminal."""

    def __init__(self, bench):
        self.bench = bench
        self.master, self.slave = os.openpty()
        self.bus = can.Bus(
            interface="slcan",
            channel=os.ttyname(self.slave),
            bitrate=500_000,
            sleep_after_open=0.0,
            ignore_config=True,
        )
        self.exchange(b"O")

    def exchange(self, command):
        """Pass the client's lines to the adapter, up to one with this command, and the answers back."""
        line = b""
        while not line.startswith(command):
            line = b""
            while not line.endswith(OK):
                assert select.select([self.master], [], [], LIMIT_S)[0]
                line += os.read(self.master, 1)
            os.write(self.master, self.bench.adapter.feed(line, 0.0))

    def deliver(self):
        """Pass frames from the bus to the client."""
        os.write(self.master, self.bench.adapter.from_bus())

    def receive(self, count):
        return [self.bus.recv(LIMIT_S) for _ in range(count)]

    def close(self):
        self.bus.shutdown()
        os.close(self.master)
        os.close(self.slave)


@pytest.fixture
def client(bench):
    client = PythonCan(bench)
    yield client
    client.close()


def content(frames):
    return [(f.arbitration_id, f.is_extended_id, bytes(f.data)) for f in frames]


def test_python_can_receives_what_the_ins_sends(bench, client):
    bench.sent.clear()
    bench.world.advance(4.0)
    client.deliver()
    assert len(bench.sent) >= 45
    assert content(client.receive(len(bench.sent))) == content(bench.sent)
    assert client.bus.recv(0.0) is None


def test_python_can_commands_the_ins(bench, client):
    command = DBC.get_message_by_name("INS_COMMAND")
    client.bus.send(
        can.Message(
            arbitration_id=command.frame_id,
            data=command.encode({"COMMAND": 2, "ARGUMENT": 0}),
            is_extended_id=False,
        )
    )
    client.exchange(b"t")
    assert bench.unit.mode is Mode.ALIGN
    coefficient = DBC.get_message_by_name("COMPENSATION_COEFFICIENT")
    client.bus.send(
        can.Message(
            arbitration_id=coefficient.frame_id,
            data=coefficient.encode({"AXIS": 1, "INDEX": 3, "VALUE": -0.75}),
            is_extended_id=False,
        )
    )
    client.exchange(b"t")
    assert bench.unit.loaded_table[1, 3] == -0.75


def test_extended_frames_of_python_can_arrive_and_mean_nothing_to_the_ins(bench, client):
    client.bus.send(can.Message(arbitration_id=0x200, data=b"\2\0", is_extended_id=True))
    client.exchange(b"T")
    assert bench.unit.mode is Mode.STANDBY


def test_nothing_is_received_once_python_can_has_left(bench):
    client = PythonCan(bench)
    client.bus.shutdown()
    client.exchange(b"C")
    bench.world.advance(4.0)
    assert bench.adapter.from_bus() == b""
    os.close(client.master)
    os.close(client.slave)


@pytest.mark.parametrize(
    ("line", "reply"),
    [("O", OK), ("L", OK), ("C", OK), ("S6", OK), ("s031C", OK), ("", OK), ("Z0", OK), ("M00000000", OK)],
)
def test_good_settings_get_a_carriage_return(bench, line, reply):
    assert bench.ask(line) == reply


def test_version_and_number_are_answered(bench):
    assert bench.ask("V") == b"V1013\r"
    assert bench.ask("N") == b"NEMUL\r"


def test_good_frames_are_acknowledged(bench):
    bench.ask("O")
    assert bench.ask("t20020200") == b"z\r"
    assert bench.unit.mode is Mode.ALIGN
    assert bench.ask("t7ff0") == b"z\r"
    assert bench.ask("T1FFFFFFF81122334455667788") == b"Z\r"


@pytest.mark.parametrize(
    "line",
    [
        "?", "OO", "O1", "CC", "S", "S9", "S66", "s12", "Z1", "Y2", "v", "V1", "F", "é",
        "t", "t200", "t2002", "t200201", "t20020", "t2002020", "t2002020000", "t2003020", "t20090000",
        "t800801", "t+200", "t 20020200", "t2_020200", "t200202 00", "t20G20200", "r2002", "d20020200",
        "T2000", "T2000000000000", "TFFFFFFFF0", "T200000000201", "t20020200" + "0" * 100, "O" * 500,
    ],
)  # fmt: skip
def test_bad_lines_get_a_bell_and_change_nothing(bench, line):
    bench.ask("O")
    assert bench.ask(line) == BELL
    assert bench.unit.mode is Mode.STANDBY
    assert bench.ask("t20020200") == b"z\r"


def test_frames_need_an_open_channel(bench):
    assert bench.ask("t20020200") == BELL
    bench.ask("O")
    bench.ask("C")
    assert bench.ask("t20020200") == BELL
    assert bench.unit.mode is Mode.STANDBY


def test_a_channel_opened_to_listen_receives_and_does_not_send(bench):
    bench.ask("L")
    assert bench.ask("t20020200") == BELL
    assert bench.unit.mode is Mode.STANDBY
    bench.world.advance(3.5)
    assert bench.adapter.from_bus() != b""
    bench.ask("O")
    assert bench.ask("t20020200") == b"z\r"


def test_a_line_may_come_in_pieces_and_several_at_once(bench):
    assert bench.adapter.feed(b"O", 0.0) == b""
    assert bench.adapter.feed(b"\rt2002", 0.0) == b"\r"
    assert bench.adapter.feed(b"0200\rV\rbad\r", 0.0) == b"z\rV1013\r\a"
    assert bench.unit.mode is Mode.ALIGN


def test_frames_from_the_bus_are_given_once(bench):
    bench.ask("O")
    bench.world.advance(2.65)
    assert bench.adapter.from_bus().count(b"\r") == 3
    assert bench.adapter.from_bus() == b""


line_like = st.text("OCLSsVNZtTrR0123456789abcdefABCDEF \r\n", max_size=30).map(str.encode)


@pytest.mark.long
@given(chunks=st.lists(st.one_of(st.binary(max_size=80), line_like), max_size=8))
def test_random_bytes_never_break_it_and_each_line_gets_one_answer(make_world, chunks):
    bench = Bench(make_world(ins={"boot_s": 1.0}))
    reply = b"".join(bench.adapter.feed(chunk, 0.0) for chunk in chunks)
    assert reply.count(OK) + reply.count(BELL) == b"".join(chunks).count(OK)
    bench.adapter.feed(b"\rC\rO\r", 0.0)
    bench.world.advance(3.0)
    assert bench.ask("V") == b"V1013\r"


def test_after_bus_off_the_channel_must_be_reopened(make_world):
    connection = Connection()
    world = make_world("ideal", ins={"boot_s": 1.0})
    adapter = SlcanAdapter(CanInsEmulator(world), connection)
    world.power_unit(True)
    assert adapter.feed(b"O\r", 0.0) == b"\r"
    world.advance(2.0)
    assert adapter.from_bus()
    connection.disconnect()
    world.advance(3.0)
    assert adapter.from_bus() == b""
    assert adapter.feed(b"t20020200\rO\r", 3.0) == b"\a\a"
    connection.reconnect()
    assert adapter.feed(b"t20020200\r", 3.0) == b"\a"
    assert adapter.feed(b"O\rt20020200\r", 3.0) == b"\rz\r"
    world.advance(4.0)
    assert adapter.from_bus()
