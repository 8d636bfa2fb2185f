"""`gyrobench emulate`, in a separate process."""

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import threading
import time

import numpy as np
import pytest

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.station.instruments import Emulation, Outputs, open_ins
from gyrobench.bench.station.station import Station
from gyrobench.drivers.frames import concatenate
from gyrobench.drivers.ins.navigation_data import decode_navigation
from tests.bench.command_line import PROCESS, gyrobench, refusal_of


@pytest.fixture
def emulate(tmp_path):
    """Start the command; returns its process and the first line that it prints."""
    started = []

    def start(*options):
        command = [*PROCESS, "emulate", "--world", "quick", "--for-s", "60", *map(str, options)]
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
        )
        started.append(process)
        return process, process.stdout.readline()

    yield start
    for process in started:
        process.kill()
        process.communicate()


def test_the_station_written_reaches_the_bench_at_its_speed(emulate, tmp_path):
    path = tmp_path / "mine.yaml"
    process, line = emulate("--speed", "10", "--write-station", path, "--json")
    station = Station(path)
    urls = json.loads(line)
    assert station.file.chamber.port == urls["chamber"]
    clock = WallClock(speed=station.file.speed)
    with Outputs(station, clock) as outputs:
        assert "Acutrol3000" in outputs.table.identify()
        outputs.power_unit(True)
        ins = open_ins(station, clock, Emulation())
        assert ins.sends_frames(60.0)
        assert ins.identify().startswith("serial number")
        ins.close()
        began_s, real_s = clock.now(), time.monotonic()
        outputs.table.prepare()
        outputs.table.move_to({2: 60.0}, 20.0)
        while not outputs.table.in_position():
            clock.sleep(0.2)
        took_s, took_real_s = clock.now() - began_s, time.monotonic() - real_s
    assert took_s > 3.0
    assert took_real_s == pytest.approx(took_s / 10.0, rel=0.05)
    process.terminate()
    _, complaints = process.communicate(timeout=10)
    assert (process.returncode, complaints) == (0, "")


def test_operators_are_reported_where_it_is_and_the_emulators_end_with_it_even_if_it_is_killed(
    emulate, tmp_path
):
    link = tmp_path / "table"
    process, line = emulate("--table-port", link)
    assert line == "The emulated bench runs in real time until Ctrl-C.\n"
    process.stdout.readline()
    assert process.stdout.readline() == f"Table    {link}  acutrol3000\n"
    assert link.is_symlink()
    process.send_signal(signal.SIGKILL)
    process.wait(10)
    end_s = time.monotonic() + 20.0
    while link.is_symlink():
        assert time.monotonic() < end_s
        time.sleep(0.05)


@pytest.fixture
def refused(tmp_path, capfd):
    """Run the command in this process; its exit code, and the complaints of the emulators' process."""
    handler = signal.getsignal(signal.SIGTERM)
    yield lambda *options: (gyrobench("emulate", *options, cwd=tmp_path).returncode, capfd.readouterr().err)
    signal.signal(signal.SIGTERM, handler)


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (("--for-s", "1", "--world", "atlantis"), "emulate: atlantis: no such file or shipped name"),
        (("--table-port", "99999", "--for-s", "0"), "port must be 0-65535"),
    ],
)
def test_what_the_emulators_find_wrong_is_shown_with_its_exit_code(refused, options, problem):
    code, complaints = refused(*options)
    assert code == 2
    assert complaints.startswith("gyrobench")
    assert problem in complaints
    assert "Traceback" not in complaints


def test_a_station_that_is_wrong_is_printed_before_anything_starts(tmp_path):
    problem = refusal_of("emulate", "--station", "atlantis", cwd=tmp_path)
    assert "atlantis: no such file or shipped name" in problem


class SerialServer:
    """A serial server, as ser2net: what arrives on its TCP port goes to a terminal, and the other way."""

    def __init__(self, device):
        self._device = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"socket://127.0.0.1:{self._listener.getsockname()[1]}"
        self._thread = threading.Thread(target=self._relay, daemon=True)
        self._thread.start()

    def _relay(self):
        client, _ = self._listener.accept()
        with client, contextlib.suppress(ConnectionError):  # it leaves while frames still come
            while True:
                for each in select.select([client, self._device], [], [])[0]:
                    if each is client:
                        if not (data := client.recv(4096)):
                            return
                        os.write(self._device, data)
                    else:
                        client.sendall(os.read(self._device, 4096))

    def close(self):
        self._thread.join(30)
        self._listener.close()
        os.close(self._device)


@pytest.mark.parametrize("way", ["tcp", pytest.param("serial server", marks=pytest.mark.long)])
def test_slcan_on_a_socket_comes_at_full_rate_and_nothing_is_imported_from_the_current_folder(
    emulate, tmp_path, way
):
    for name in ("struct", "pickle", "bisect"):
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'trapped')!r}, 'w')\n")
    path = tmp_path / "served.yaml"
    tcp = ["--tcp"] if way == "tcp" else []
    _, line = emulate(
        "--world", "ideal", "--can", "slcan", "--speed", 10, "--write-station", path, "--json", *tcp
    )
    urls = json.loads(line)
    server = None
    if way == "serial server":
        server = SerialServer(urls["ins"])
        path.write_text(path.read_text().replace(urls["ins"], server.url))
    station = Station(path)
    clock = WallClock(speed=station.file.speed)
    with Outputs(station, clock) as outputs:
        outputs.power_unit(True)
        ins = open_ins(station, clock, Emulation())
        assert ins.sends_frames(60.0)
        assert ins.identify().startswith("serial number")
        blocks, end_s = [], time.monotonic() + 60.0
        while sum(map(len, blocks)) < 150:
            assert time.monotonic() < end_s
            blocks.append(ins.poll())
            time.sleep(0.05)
        ins.close()
    if server:
        server.close()
    received = concatenate(blocks)
    counts = decode_navigation(received, station.file.ins.signals, ins.codec).counts
    assert (counts.lost, counts.repeated, counts.contradicted) == (0, 0, 0)
    assert len(received) / np.ptp(received.timestamp_s) > 30.0
    assert not (tmp_path / "trapped").exists()
