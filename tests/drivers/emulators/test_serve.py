import contextlib
import json
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from urllib.parse import urlsplit

import can
import pytest
import serial

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import ConnectionFailedError, InstrumentError
from gyrobench.drivers.chamber.thermotron_8800 import Thermotron8800
from gyrobench.drivers.chamber.watlow_f4 import WatlowF4
from gyrobench.drivers.chamber.watlow_f4t import WatlowF4T
from gyrobench.drivers.emulators.serve import main
from gyrobench.drivers.rate_table.acutrol3000 import Acutrol3000
from gyrobench.drivers.serial_line import SerialLine
from tests.drivers.emulators.forked import served
from tests.drivers.emulators.quick_world import LIMIT_S, QUICK_WORLD

COMMAND = [sys.executable, "-m", "gyrobench.drivers.emulators.serve"]
READ_PV = bytes.fromhex("01 03 00 64 00 01 C5 D5")
VELOCITY_NE, ROLL_PITCH, HEADING, STATUS = 0x004, 0x006, 0x007, 0x010


@pytest.fixture
def serve(tmp_path):
    """Start the emulators as a process; returns it and where they are."""
    servers = []
    world = tmp_path / "quick.yaml"
    world.write_text(QUICK_WORLD)

    def start(*options):
        server, urls = served("--world", world, "--for-s", "600", *options)
        servers.append(server)
        return server, urls

    yield start
    for server in servers:
        server.close()


def frames_until_status(bus):
    """Frames up to the first status frame; fails if none comes."""
    frames, end_s = [], time.monotonic() + LIMIT_S
    while all(frame.arbitration_id != STATUS for frame in frames):
        assert time.monotonic() < end_s, f"only {len(frames)} frames came"
        frame = bus.recv(0.5)
        if frame is not None:
            frames.append(frame)
    return frames


@pytest.mark.parametrize(("options", "start"), [((), "/dev/pts/"), (("--tcp",), "socket://127.0.0.1:")])
def test_all_three_instruments_answer(serve, options, start):
    server, urls = serve(*options)
    assert sorted(urls) == ["chamber", "ins", "table"]
    assert all(url.startswith(start) for url in urls.values())
    clock = WallClock()
    table = Acutrol3000(SerialLine("rate table", urls["table"], clock))
    chamber = WatlowF4(SerialLine("chamber", urls["chamber"], clock))
    assert "Acutrol3000" in table.identify()
    table.prepare()
    table.move_to({1: 2.0}, 30.0)
    assert chamber.read().temperature_c == pytest.approx(23.0, abs=0.2)

    with can.Bus(interface="slcan", channel=urls["ins"], sleep_after_open=0.0, ignore_config=True) as bus:
        assert bus.recv(0.1) is None
        chamber.switch_event(2, True)
        frames = frames_until_status(bus)
        chamber.switch_event(2, False)
    navigation = [f.arbitration_id for f in frames if f.arbitration_id in (VELOCITY_NE, ROLL_PITCH, HEADING)]
    assert navigation[:3] == [VELOCITY_NE, ROLL_PITCH, HEADING]
    assert len(navigation) >= 24
    assert {f.data[0] for f in frames if f.arbitration_id == STATUS} == {1}
    assert table.read().position_deg == pytest.approx((2.0, 0.0), abs=0.01)
    table.close()
    chamber.close()
    assert server.poll() is None


@pytest.mark.parametrize(
    ("adapter", "address"),
    [("slcan", r"/dev/pts/\d+"), ("socketcand", r"socketcand://127\.0\.0\.1:\d+/can0")],
)
def test_each_unit_has_its_bus_and_its_supply(serve, adapter, address):
    _, urls = serve("--units", "2", "--power-event", "2", "--power-event", "4", "--can", adapter)
    assert sorted(urls) == ["chamber", "ins", "ins-2", "table"]
    assert re.fullmatch(address, urls["ins"])
    assert urls["table"].startswith("/dev/pts/")
    chamber = WatlowF4(SerialLine("chamber", urls["chamber"], WallClock()))
    with can_bus(urls["ins"]) as first, can_bus(urls["ins-2"]) as second:
        chamber.switch_event(4, True)
        assert {f.data[0] for f in frames_until_status(second) if f.arbitration_id == STATUS} == {1}
        second.send(can.Message(arbitration_id=0x200, data=b"\x02\x00", is_extended_id=False))
        frames_until_status(second)
        assert {f.data[0] for f in frames_until_status(second) if f.arbitration_id == STATUS} == {2}
        assert first.recv(0.1) is None
    chamber.close()


def can_bus(url):
    if url.startswith("/"):
        return can.Bus(interface="slcan", channel=url, sleep_after_open=0.0, ignore_config=True)
    at = urlsplit(url)
    options = {"channel": at.path.strip("/"), "host": at.hostname, "port": at.port}
    return can.Bus(interface="socketcand", ignore_config=True, **options)


def test_options_select_a_model_of_the_chamber_and_wrong_ones_end_it(serve, capsys):
    _, urls = serve("--chamber-option", "model=F4S", "--chamber-option", "decimals=2")
    with contextlib.closing(WatlowF4(SerialLine("chamber", urls["chamber"], WallClock()))) as chamber:
        assert not chamber.can_ramp
        assert chamber.read().temperature_c == pytest.approx(23.0, abs=0.005)
    for option, why in (
        ("wheels=3", "no such option; there are address, model, decimals"),
        ("decimals=x", "decimals=x: the value must be a whole number"),
        ("model=F5", "model=F5: the value must be 'F4P' or 'F4S'"),
    ):
        assert why in ended_at_once(capsys, "--chamber-option", option)


def test_it_ends_by_itself_after_its_time(serve):
    server, _ = serve("--for-s", "0.05")
    server.communicate(timeout=LIMIT_S)
    assert server.returncode == 0


def ended_at_once(capsys, *options):
    """What it complains of where it ends with 2 and has printed nothing else."""
    with pytest.raises(SystemExit) as caught:
        main([*map(str, options)])
    printed, complaints = capsys.readouterr()
    assert (caught.value.code, printed) == (2, "")
    return complaints


def test_a_wrong_world_ends_it_with_a_message(capsys):
    complaints = ended_at_once(capsys, "--world", "atlantis")
    assert complaints.startswith("gyrobench emulate: atlantis: no such file or shipped name")
    assert "gyro_a, gyro_b, heating_neighbour, ideal" in complaints


def test_a_negative_seed_ends_it_with_a_message(capsys):
    complaints = ended_at_once(capsys, "--world", "ideal", "--seed", "-3")
    assert "the seed must not be negative; found -3" in complaints


@pytest.fixture
def faults(tmp_path):
    """Write a list of faults; returns the options that name it, and its log."""

    def write(*entries):
        path = tmp_path / "faults.yaml"
        path.write_text("faults:\n" + "".join(f"  - {{{entry}}}\n" for entry in entries))
        log = tmp_path / "faults.log"
        return ("--faults", str(path), "--faults-log", str(log)), log

    return write


def answers(url):
    """Whether a chamber can be opened and read there."""
    try:
        with SerialLine("chamber", url, WallClock()) as line:
            return WatlowF4(line).read().temperature_c == pytest.approx(23.0, abs=0.2)
    except InstrumentError:
        return False


def wait_for(condition):
    end_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)


# pyserial leaves the socket of a connection that was hung up to the garbage collector.
@pytest.mark.filterwarnings(
    "ignore:Exception ignored in. <socket.socket:pytest.PytestUnraisableExceptionWarning"
)
@pytest.mark.parametrize("options", [(), ("--tcp",)])
def test_a_port_goes_away_and_comes_back_under_its_address(serve, faults, options):
    listed, log = faults("fault: port_gone, target: chamber, during: power_on, for_s: 3.0")
    _, urls = serve(*options, *listed)
    chamber = WatlowF4(SerialLine("chamber", urls["chamber"], WallClock()))
    assert chamber.read().temperature_c == pytest.approx(23.0, abs=0.2)
    with contextlib.suppress(ConnectionFailedError):
        chamber.switch_event(2, True)
    wait_for(lambda: "port_gone" in log.read_text())
    with pytest.raises(ConnectionFailedError):
        chamber.read()
    assert not answers(urls["chamber"])
    chamber.close()
    wait_for(lambda: answers(urls["chamber"]))
    with SerialLine("rate table", urls["table"], WallClock()) as line:
        assert "Acutrol3000" in Acutrol3000(line).identify()


def assert_ends(server, number):
    """A signal ends it, and it complains of nothing."""
    server.send_signal(number)
    _, complaints = server.communicate(timeout=LIMIT_S)
    assert (server.returncode, complaints) == (0, "")


def test_replies_are_lost_and_late_over_a_pseudo_terminal_and_its_link_goes_in_the_end(serve, faults):
    listed, log = faults(
        "fault: lost_reply, target: chamber, at_s: 0",
        "fault: late_reply, target: chamber, at_s: 0, delay_s: 2",
    )
    server, urls = serve(*listed)
    with serial.Serial(urls["chamber"], timeout=0.15) as port:
        port.write(READ_PV)
        assert port.read(7) == b""
        port.write(READ_PV)
        assert port.read(7) == b""
        port.timeout = LIMIT_S
        assert port.read(7)[:3] == bytes.fromhex("01 03 02")
    kinds = [json.loads(line)["fault"] for line in log.read_text().splitlines()]
    assert kinds == ["lost_reply", "late_reply"]
    assert_ends(server, signal.SIGINT)
    assert not Path(urls["table"]).parent.exists()


def test_a_wrong_list_of_faults_ends_it_with_a_message(tmp_path, capsys):
    path = tmp_path / "faults.yaml"
    path.write_text("faults:\n  - {fault: gremlins, at_s: 1}\n")
    complaints = ended_at_once(capsys, "--world", "quick", "--faults", path)
    assert f"gyrobench emulate: {path}:2:6: " in complaints


def test_ports_are_where_they_are_asked_for_and_a_client_that_left_makes_room_for_the_next_one(
    serve, tmp_path
):
    with socket.create_server(("127.0.0.1", 0)) as free:
        number = free.getsockname()[1]
    link = tmp_path / "table"
    server, urls = serve("--table-port", str(link), "--chamber-port", str(number))
    assert urls["table"] == str(link)
    assert urls["chamber"] == f"socket://127.0.0.1:{number}"
    for _ in range(3):
        assert answers(urls["chamber"])
    with SerialLine("rate table", urls["table"], WallClock()) as line:
        assert "Acutrol3000" in Acutrol3000(line).identify()
    assert_ends(server, signal.SIGTERM)
    assert not link.is_symlink()


def test_a_port_that_is_taken_ends_it_with_a_message(capsys):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        complaints = ended_at_once(capsys, "--world", "ideal", "--ins-port", taken.getsockname()[1])
    assert "can't open a port: [Errno 98] Address already in use" in complaints


def test_it_ends_with_the_program_that_started_it(tmp_path):
    command = [*COMMAND, "--world", "ideal", "--until-stdin-closes", "--table-port", str(tmp_path / "table")]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as server:
        server.stdout.readline()
        assert (tmp_path / "table").is_symlink()
        server.stdin.close()
        assert server.wait(LIMIT_S) == 0
        assert server.stderr.read() == b""
    assert not (tmp_path / "table").is_symlink()


@pytest.mark.parametrize("speed", ["0.5", "1000", "fast"])
def test_a_speed_that_is_not_possible_is_refused(capsys, speed):
    assert "--speed" in ended_at_once(capsys, "--speed", speed)


class StallingConnection:
    """A device server between an instrument and one client, whose replies stall until a number has come."""

    def __init__(self, url):
        self._near = socket.create_server(("127.0.0.1", 0))
        self.url = f"socket://127.0.0.1:{self._near.getsockname()[1]}"
        self._far = socket.create_connection(("127.0.0.1", urlsplit(url).port))
        self._wanted = self._requests = 0
        threading.Thread(target=self._serve, daemon=True).start()

    def stall(self, count):
        """Hold the replies until the one to this request, from now on, has come."""
        self._wanted = self._requests + count

    def _serve(self):
        self._client, _ = self._near.accept()
        threading.Thread(target=self._reply, daemon=True).start()
        with contextlib.suppress(OSError):
            while data := self._client.recv(1000):
                self._requests += 1
                self._far.sendall(data)

    def _reply(self):
        held = b""
        with contextlib.suppress(OSError):
            while data := self._far.recv(1000):
                held += data
                if self._requests >= self._wanted:
                    self._client.sendall(held)
                    held = b""

    def close(self):
        for each in (self._near, self._far, self._client):
            each.close()


DRIVERS = {"watlow_f4": WatlowF4, "watlow_f4t": WatlowF4T, "thermotron_8800": Thermotron8800}


@pytest.mark.long
@pytest.mark.parametrize("dialect", DRIVERS)
def test_no_reply_that_stalled_for_many_time_outs_is_taken_for_another(serve, dialect):
    _, urls = serve("--tcp", "--chamber-dialect", dialect)
    connection = StallingConnection(urls["chamber"])
    chamber = DRIVERS[dialect](SerialLine("chamber", connection.url, WallClock()), reply_timeout_s=0.3)
    chamber.set_temperature(23.0, None)
    right = {
        chamber.read: chamber.read(),
        chamber.running_profile: "",
        chamber.set_point_c: 23.0,
        lambda: chamber.is_event_on(1): False,
    }
    read, running_profile, set_point_c, is_event_on = right
    stalled = 0
    for asked in (
        [running_profile, read],
        [read, running_profile],
        [read, read, read, running_profile],
        [is_event_on, set_point_c],
        3 * [is_event_on] + [set_point_c],
        4 * [set_point_c] + [read],
    ):
        connection.stall(len(asked))
        for ask in [*asked, *right]:
            try:
                answer = ask()
            except InstrumentError:
                stalled += 1
            else:
                assert answer == right[ask]
    assert stalled >= 10
    chamber.close()
    connection.close()
