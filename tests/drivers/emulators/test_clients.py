"""Programs that are not of this project talk to the served emulators."""

import contextlib
import os
import socket
import struct
import subprocess
import sys
import time
import tty
from urllib.parse import urlsplit

import can
import pytest
from cantools.database import load_file
from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient, ModbusTcpClient

from gyrobench.drivers import ins
from tests.drivers.emulators.forked import served
from tests.drivers.emulators.quick_world import LIMIT_S, QUICK_WORLD

SPEED = 5.0
UNIT_POWER_REGISTER = 2010


@pytest.fixture(scope="module", params=["terminals and slcan", "tcp and socketcand"])
def urls(request, tmp_path_factory):
    """Where the emulators of a bench are that lives five times as fast as real time, its unit on."""
    world = tmp_path_factory.mktemp("world") / "quick.yaml"
    world.write_text(QUICK_WORLD)
    options = ["--tcp", "--can", "socketcand"] if "tcp" in request.param else []
    server, addresses = served("--world", world, "--speed", SPEED, "--for-s", "600", *options)
    with modbus_client(addresses["chamber"]) as client:
        assert not client.write_register(UNIT_POWER_REGISTER, 1).isError()
    yield addresses
    server.terminate()
    assert server.wait(LIMIT_S) == 0
    server.close()


@contextlib.contextmanager
def modbus_client(url):
    where = urlsplit(url)
    if where.scheme == "socket":
        client = ModbusTcpClient(where.hostname, port=where.port, framer=FramerType.RTU, timeout=LIMIT_S)
    else:
        client = ModbusSerialClient(url, baudrate=9600, timeout=LIMIT_S)
    assert client.connect()
    yield client
    client.close()


def can_options(url):
    where = urlsplit(url)
    if where.scheme == "socketcand":
        return {
            "interface": "socketcand",
            "channel": where.path.strip("/"),
            "host": where.hostname,
            "port": where.port,
        }
    return {"interface": "slcan", "channel": url, "sleep_after_open": 0.0}


def exchanged(url, message, count):
    """What comes back for a message, by nothing but the operating system."""
    where = urlsplit(url)
    if where.scheme == "socket":
        with socket.create_connection((where.hostname, where.port), timeout=LIMIT_S) as client:
            client.sendall(message)
            received = b""
            while len(received) < count:
                received += client.recv(count - len(received))
            return received
    port = os.open(url, os.O_RDWR | os.O_NOCTTY)
    try:
        tty.setraw(port)
        os.write(port, message)
        received = b""
        while len(received) < count:
            received += os.read(port, count - len(received))
        return received
    finally:
        os.close(port)


def test_pymodbus_reads_the_chamber(urls):
    with modbus_client(urls["chamber"]) as client:
        assert client.read_holding_registers(0).registers == [5270]
        assert client.read_holding_registers(100, count=2).registers == [230, 0]
        assert client.read_holding_registers(3000).exception_code == 2


def test_a_public_client_of_the_chamber_ends_profiles_sets_the_clock_and_reads_digital_inputs(urls):
    with modbus_client(urls["chamber"]) as client:
        assert not client.write_register(1217, 1).isError()
        assert not client.write_registers(1916, [12, 30, 0, 6, 15, 2026]).isError()
        assert client.read_holding_registers(1919, count=3).registers == [6, 15, 2026]
        for place in range(4):
            status = client.read_holding_registers(201 + 12 * place).registers
            condition = client.read_holding_registers(1061 + 2 * place).registers
            assert status != condition  # no digital input is active


def test_a_terminal_sends_acl_to_the_table(urls):
    reply = exchanged(urls["table"], b":Read:Position? 1\r\n", 8)
    error, length = struct.unpack("<II", reply)
    assert (error, length) == (0, 8)


def test_python_can_receives_frames_which_cantools_decodes_and_which_come_at_the_bench_s_speed(urls):
    database = load_file(ins.__path__[0] + "/gyrobench_ins.dbc")
    seen, seconds = {}, []
    with can.Bus(**can_options(urls["ins"]), ignore_config=True) as bus:
        end_s = time.monotonic() + LIMIT_S
        while len(seconds) < 6 and time.monotonic() < end_s:
            frame = bus.recv(1.0)
            if frame is None:
                continue
            message = database.get_message_by_frame_id(frame.arbitration_id)
            seen[message.name] = decoded = message.decode(bytes(frame.data), decode_choices=False)
            if message.name == "SYSTEM_TIME":
                seconds.append((time.monotonic(), decoded["TIME_S"]))
    assert seen["INS_IDENTITY"]["SERIAL_NUMBER"] > 0
    assert seen["GYRO_OPTICS_TEMPERATURE"]["X"] == pytest.approx(23.0, abs=2.0)
    (first_s, first), (last_s, last) = seconds[1], seconds[-1]
    assert last - first == 4
    assert last_s - first_s < 4.0


def test_the_logger_of_python_can_writes_what_the_ins_sends(urls, tmp_path):
    options = can_options(urls["ins"])
    log = tmp_path / "ins.log"
    command = [
        sys.executable,
        "-m",
        "can.logger",
        "-i",
        options.pop("interface"),
        "-c",
        options.pop("channel"),
    ]
    extra = ["--bus-kwargs", *(f"{name}={value}" for name, value in options.items())]
    with subprocess.Popen([*command, "-f", str(log), *extra], stdout=subprocess.DEVNULL) as logger:
        end_s = time.monotonic() + LIMIT_S
        while (not log.exists() or log.stat().st_size < 500) and time.monotonic() < end_s:
            time.sleep(0.05)
        logger.terminate()
    with can.LogReader(log) as reader:
        assert 0x007 in {frame.arbitration_id for frame in reader}


def test_two_clients_of_the_daemon_get_the_same_frames_and_a_second_one_of_the_table_is_refused(urls):
    where = urlsplit(urls["ins"])
    if where.scheme != "socketcand":
        pytest.skip("a pseudo-terminal has no clients to count")
    with (
        can.Bus(**can_options(urls["ins"]), ignore_config=True) as first,
        can.Bus(**can_options(urls["ins"]), ignore_config=True) as second,
    ):
        counted = [sum(bus.recv(1.0) is not None for _ in range(50)) for bus in (first, second)]
    assert counted == [50, 50]
    table = urlsplit(urls["table"])
    address = (table.hostname, table.port)
    with socket.create_connection(address, timeout=LIMIT_S) as first:
        first.sendall(b":Read:Position? 1\r\n")
        assert first.recv(8)
        with socket.create_connection(address, timeout=LIMIT_S) as second:
            assert second.recv(8) == b""
        first.sendall(b":Read:Position? 1\r\n")
        assert first.recv(8)
