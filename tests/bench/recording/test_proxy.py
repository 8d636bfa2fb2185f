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


@pytest.mark.parametrize("kind", ["terminal", "tcp"])
def test_a_client_reaches_the_instrument_and_both_are_recorded(tmp_path, kind):
    clock, path = WallClock(), tmp_path / "proxy.rec"
    served = PseudoTerminal() if kind == "terminal" else TcpPort()
    port = open_port("emulator://chamber?world=ideal", clock, 9600, "N")
    file = RecordingFile(path, RecordingHeader(instrument="chamber"), clock)
    proxy = Proxy(served, port, file, clock)
    thread = threading.Thread(target=proxy.run, args=(3.0,))
    thread.start()
    if kind == "terminal":
        client = ModbusSerialClient(served.url, baudrate=9600, timeout=2)
    else:
        client = ModbusTcpClient("127.0.0.1", port=served.number, framer=FramerType.RTU, timeout=2)
    try:
        assert client.connect()
        assert client.read_holding_registers(0).registers == [5270]
    finally:
        client.close()
        thread.join()
        served.unplug()
        port.close()
        file.close()
    transfers = read_recording(path).transfers
    assert b"".join(t.data for t in transfers if t.is_sent).hex(" ") == "01 03 00 00 00 01 84 0a"
    assert b"".join(t.data for t in transfers if not t.is_sent).hex(" ") == "01 03 02 14 96 37 2a"
