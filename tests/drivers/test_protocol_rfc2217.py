"""A serial port behind a network server by RFC 2217; the server is pyserial's own, its port echoes."""

import socket
import threading
import time
from types import SimpleNamespace

import pytest
import serial.rfc2217

from gyrobench.bench.foundations.clock import Deadline, WallClock
from gyrobench.bench.foundations.errors import ConnectionFailedError, NoReplyError
from gyrobench.drivers.serial_line import SerialLine
from gyrobench.drivers.text_line import TextLine

pytestmark = pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")  # in pyserial


class Server:
    """Serves one client; counts how often the client sets the baud rate."""

    def __init__(self):
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.url = f"rfc2217://127.0.0.1:{self._listening.getsockname()[1]}"
        self.baudrates = 0
        self.port = serial.serial_for_url("loop://", timeout=0)
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def _serve(self):
        self.client, _ = self._listening.accept()
        self._listening.close()
        manager = serial.rfc2217.PortManager(self.port, SimpleNamespace(write=self.client.sendall))
        while data := self.client.recv(4096):
            self.baudrates += data.count(serial.rfc2217.IAC + serial.rfc2217.SB + b"\x2c\x01")
            self.port.write(b"".join(manager.filter(data)))
            if echo := self.port.read(4096):
                self.client.sendall(b"".join(manager.escape(echo)))
        self.client.close()

    def close(self):
        self.client.shutdown(socket.SHUT_RDWR)
        self.thread.join()


@pytest.fixture
def server():
    return Server()


def test_replies_come_through_and_a_time_out_sends_nothing_to_the_server(server):
    with SerialLine("rate table", server.url, WallClock(), 19200) as line:
        assert server.port.baudrate == 19200
        assert TextLine(line, b"\r", reply_timeout_s=60.0).ask("12.3456789, 0.001") == b"12.3456789, 0.001"
        line.write(b"\xff\x00\xff")
        assert line.read(3, Deadline(line.clock, 60.0)) == b"\xff\x00\xff"
        with pytest.raises(NoReplyError):
            line.read(1, Deadline(line.clock, 0.01))
        assert server.baudrates == 1
        server.close()
        for _ in range(2):
            with pytest.raises(ConnectionFailedError, match="the server closed the connection"):
                line.read(1, Deadline(line.clock, 60.0))


def test_a_read_without_waiting_returns_all_that_has_arrived(server):
    with SerialLine("INS", server.url, WallClock()) as line:
        line.write(b"t1230\rt4560\r")
        port = line._port
        while port.in_waiting < len(b"t1230\rt4560\r"):
            time.sleep(0.001)
        port.timeout = 0
        assert port.read(4096) == b"t1230\rt4560\r"
