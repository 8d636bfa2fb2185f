"""A serial line whose port goes away and comes back."""

import os
import socket
import threading
import tty
from pathlib import Path

import pytest

from gyrobench.bench.foundations.clock import Deadline, VirtualClock, WallClock
from gyrobench.bench.foundations.errors import ConnectionFailedError, NoReplyError, ReplyError
from gyrobench.drivers.serial_line import SerialLine


def open_descriptors():
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


class Plug:
    """A serial port that can be pulled and put in again under the same name."""

    def __init__(self, path):
        self.path = path
        self.plug_in()

    def plug_in(self):
        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.path.symlink_to(os.ttyname(slave))
        self._slave = slave

    def pull(self):
        self.path.unlink()
        os.close(self._slave)
        os.close(self.master)


@pytest.fixture
def plug(tmp_path):
    plug = Plug(tmp_path / "ttyUSB0")
    yield plug
    if plug.path.is_symlink():
        plug.pull()


@pytest.fixture
def line(plug):
    with SerialLine("chamber", str(plug.path), WallClock(), 19200) as line:
        yield line


def exchange(line, plug):
    line.write(b"ask")
    assert os.read(plug.master, 10) == b"ask"
    os.write(plug.master, b"reply")
    return line.read(5, Deadline(line.clock, 120.0))


def test_a_line_works_again_after_its_port_was_unplugged_and_plugged_in(line, plug):
    plug.pull()
    with pytest.raises(ConnectionFailedError, match="went away"):
        line.read(1, Deadline(line.clock, 0.1))
    with pytest.raises(ConnectionFailedError, match="can't open"):
        line.reopen()
    with pytest.raises(ConnectionFailedError, match="went away"):
        line.write(b"ask")
    plug.plug_in()
    line.reopen()
    assert exchange(line, plug) == b"reply"


def test_a_tcp_port_without_its_scheme_is_answered_with_how_to_write_it():
    with pytest.raises(ConnectionFailedError, match=r"as socket://192\.0\.2\.1:9878"):
        SerialLine("rate table", "192.0.2.1:9878", WallClock(), 9600)


def test_a_line_is_opened_again_as_it_was_opened_first(line):
    before = line._port.get_settings()
    line.reopen()
    after = line._port.get_settings()
    assert (after["baudrate"], after["parity"]) == (19200, "N")
    assert after == before | {"timeout": after["timeout"]}
    assert line._port.exclusive


def test_what_had_arrived_before_a_line_was_opened_again_is_lost(line, plug):
    os.write(plug.master, b"late reply")
    line.reopen()
    assert exchange(line, plug) == b"reply"


def test_a_closed_line_can_be_opened_again(line, plug):
    line.close()
    line.close()
    line.reopen()
    assert exchange(line, plug) == b"reply"


def test_a_hundred_failures_leak_no_descriptor(line, plug):
    before = open_descriptors()
    for _ in range(100):
        plug.pull()
        for call in (lambda: line.write(b"ask"), line.discard_input, line.reopen):
            with pytest.raises(ConnectionFailedError):
                call()
        plug.plug_in()
        line.reopen()
    assert exchange(line, plug) == b"reply"
    assert open_descriptors() == before


def test_a_port_held_by_another_program_is_refused_without_a_leak(line, plug):
    before = open_descriptors()
    with pytest.raises(ConnectionFailedError, match="can't open"):
        SerialLine("chamber", str(plug.path), WallClock())
    assert open_descriptors() == before
    assert exchange(line, plug) == b"reply"


def test_a_socket_that_was_closed_at_the_other_end_is_opened_again():
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        with SerialLine("rate table", url, WallClock()) as line:
            server.accept()[0].close()
            with pytest.raises(ConnectionFailedError, match="went away"):
                line.read(1, Deadline(line.clock, 120.0))
            line.reopen()
            far = server.accept()[0]
            far.sendall(b"x")
            assert line.read(1, Deadline(line.clock, 120.0)) == b"x"
            far.close()


def test_an_emulated_line_is_opened_again():
    clock = VirtualClock()
    with SerialLine("chamber", f"emulator://chamber?clock={clock.name}&world=ideal", clock) as line:
        line.write(bytes.fromhex("01 03 00 64 00 01 C5 D5"))
        line.reopen()
        with pytest.raises(NoReplyError):
            line.read(1, Deadline(clock, 1.0))
        line.write(bytes.fromhex("01 03 00 64 00 01 C5 D5"))
        assert line.read(1, Deadline(clock, 1.0)) == b"\x01"


def test_an_error_names_the_port_without_the_options_of_its_url():
    line = SerialLine("chamber", "loop://?logging=error", WallClock())
    with line, pytest.raises(NoReplyError) as raised:
        line.read(1, Deadline(line.clock, 0))
    assert "0 of 1 bytes within 0 s on loop://. Is it switched on" in str(raised.value)


def test_silence_is_awaited_until_what_was_late_has_passed(line, plug):
    timers = [threading.Timer(delay_s, os.write, (plug.master, b"late")) for delay_s in (0.05, 0.15)]
    for timer in timers:
        timer.start()
    line.await_silence(1.0, 120.0)
    for timer in timers:
        timer.join()
    assert line.clock.now() >= 1.15
    assert exchange(line, plug) == b"reply"


def test_a_line_that_is_never_silent_is_an_error(line, plug):
    ended = threading.Event()

    def babble():
        while not ended.wait(0.02):
            os.write(plug.master, b"babble")

    thread = threading.Thread(target=babble)
    thread.start()
    try:
        with pytest.raises(ReplyError, match="all the time"):
            line.await_silence(1.0, 1.2)
    finally:
        ended.set()
        thread.join()


def test_for_a_pseudo_terminal_that_is_gone_the_message_names_what_serves_it(tmp_path):
    with pytest.raises(ConnectionFailedError, match=r"Start the program that served it.*`gyrobench emulate`"):
        SerialLine("chamber", "/dev/pts/99999", VirtualClock())
    with pytest.raises(ConnectionFailedError, match="Check the station file's port and the cable"):
        SerialLine("chamber", str(tmp_path / "ttyUSB0"), VirtualClock())
