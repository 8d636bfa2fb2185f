"""The proxy between a client and an emulated chamber."""

import threading

import pytest
from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient, ModbusTcpClient

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.recording.recorder import Proxy
from gyrobench.drivers.recording.recording_file import RecordingFile, RecordingHeader, read_recording
from gyrobench.drivers.serial_line import open_port
from gyrobench.drivers.served_ports import PseudoTerminal, TcpPort

#: Bound against hanging only.
HANGS_S = 120.0


class EndedClock(WallClock):
    """A wall clock that ends what waits for its time once ``ended`` is set."""

    def __init__(self):
        super().__init__()
        self.ended = threading.Event()

    def now(self):
        return float("inf") if self.ended.is_set() else super().now()


@pytest.mark.parametrize("kind", ["terminal", "tcp"])
def test_a_client_reaches_the_instrument_and_both_directions_are_recorded(tmp_path, kind):
    clock, path = WallClock(), tmp_path / "proxy.rec"
    served = PseudoTerminal() if kind == "terminal" else TcpPort()
    port = open_port("emulator://chamber?world=ideal", clock, 9600, "N")
    file = RecordingFile(path, RecordingHeader(instrument="chamber"), clock)
    until = EndedClock()
    thread = threading.Thread(target=Proxy(served, port, file, until).run, args=(HANGS_S,))
    thread.start()
    if kind == "terminal":
        client = ModbusSerialClient(served.url, baudrate=9600, timeout=HANGS_S)
    else:
        client = ModbusTcpClient("127.0.0.1", port=served.number, framer=FramerType.RTU, timeout=HANGS_S)
    try:
        assert client.connect()
        assert client.read_holding_registers(0).registers == [5270]
    finally:
        client.close()
        until.ended.set()
        thread.join()
        served.unplug()
        port.close()
        file.close()
    transfers = read_recording(path).transfers
    assert b"".join(t.data for t in transfers if t.is_sent).hex(" ") == "01 03 00 00 00 01 84 0a"
    assert b"".join(t.data for t in transfers if not t.is_sent).hex(" ") == "01 03 02 14 96 37 2a"
