"""`gyrobench emulate`, in a separate process."""

import json
import signal
import subprocess
import time

import pytest

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.station.instruments import Emulation, Outputs, open_ins
from gyrobench.bench.station.station import Station
from tests.bench.command_line import PROCESS, gyrobench, gyrobench_process


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
        assert ins.identify(60.0).startswith("serial number")
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


def test_what_the_emulators_find_wrong_is_shown_with_its_exit_code(tmp_path):
    result = gyrobench_process("emulate", "--for-s", "1", "--world", "atlantis", cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.startswith("gyrobench emulate: atlantis: no such file or shipped name")
    assert "Traceback" not in result.stderr


def test_a_station_that_is_wrong_is_printed_before_anything_starts(tmp_path):
    result = gyrobench("emulate", "--station", "atlantis", cwd=tmp_path)
    assert result.returncode == 2
    assert "atlantis: no such file or shipped name" in result.stderr
