import pytest

from gyrobench.drivers.emulators.can_adapters import SocketcandDaemon
from gyrobench.drivers.emulators.can_ins import CanInsEmulator
from gyrobench.drivers.emulators.dialect import Connection


class Client:
    """A client of the daemon, with the INS switched on behind it."""

    def __init__(self, world):
        self.world = world
        self.connection = Connection()
        self.bus = CanInsEmulator(world)
        self.daemon = SocketcandDaemon(self.bus, self.connection)
        self.world.power_unit(True)

    def say(self, *commands):
        return self.daemon.feed(b"".join(f"< {each} >".encode() for each in commands), 0.0).decode()

    def frames(self, until_s):
        self.world.advance(until_s)
        return self.daemon.from_bus().decode()


@pytest.fixture
def client(make_world):
    return Client(make_world("ideal", ins={"boot_s": 1.0}))


def test_frames_come_once_the_bus_is_open_in_raw_mode(client):
    assert client.frames(2.0) == ""
    assert client.say("open can0", "rawmode") == "< ok >< ok >"
    frames = client.frames(3.0)
    assert frames.count("< frame ") == 38
    assert frames.startswith("< frame 004 2.100000 0000000000000000 >")


def test_a_frame_that_is_sent_reaches_the_ins(client):
    client.frames(2.0)
    client.say("open can0", "rawmode")
    assert client.say("send 200 2 2 0") == ""
    assert client.world.unit.mode == 2


@pytest.mark.parametrize(
    "command", ["open can1", "rawmode", "send 200 2 2 0", "bcmmode", "", "frame 1 2 3", "open can0 can0", "é"]
)
def test_what_is_wrong_or_too_early_is_answered_with_an_error(client, command):
    assert client.say(command) == "< error unknown command >"
    assert client.say("echo") == "< echo >"


@pytest.mark.parametrize("frame", ["send 200 3 2 0", "send 200 1 2 0", "send FFFFFFFF 0"])
def test_a_wrong_frame_is_refused(client, frame):
    client.say("open can0", "rawmode")
    assert client.say(frame) == "< error wrong frame >"


def test_a_command_may_come_in_pieces_and_garbage_is_forgotten(client):
    assert client.daemon.feed(b"\xff\x00 <<" + b"x" * 100_000 + b"< op", 0.0) == b""
    assert client.daemon.feed(b"en can0 >", 0.0) == b"< ok >"


def test_each_client_opens_the_bus_itself_and_gets_all_frames(client, make_world):
    other = SocketcandDaemon(client.bus, client.connection)
    client.say("open can0", "rawmode")
    client.frames(2.0)
    assert other.from_bus() == b""
    other.feed(b"< open can0 >< rawmode >", 2.0)
    assert client.frames(3.0) == other.from_bus().decode() != ""
    other.leave_bus()
    assert client.frames(4.0) != ""
    assert other.from_bus() == b""


def test_after_bus_off_the_bus_must_be_reopened(client):
    client.say("open can0", "rawmode")
    client.connection.disconnect()
    assert client.frames(3.0) == ""
    assert client.say("open can0") == "< error unknown command >"
    client.connection.reconnect()
    assert client.frames(4.0) == ""
    assert client.say("open can0", "rawmode") == "< ok >< ok >"
    assert client.frames(5.0)
