import contextlib
import os
import signal
import subprocess
import sys
from datetime import datetime
from pathlib import Path

import pytest

from gyrobench.bench.foundations.clock import VirtualClock, WallClock
from gyrobench.bench.foundations.errors import GyrobenchError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.guard.process import Guard, GuardProcess, guard_for
from gyrobench.bench.guard.watching import LOG_NAME
from gyrobench.bench.station.station import Station
from tests.bench.guard.served_bench import station_file


@pytest.fixture
def station(tmp_path):
    return Station(station_file(tmp_path / "station.yaml", "/dev/table", "/dev/chamber"))


def test_a_bench_inside_the_process_has_no_guard(tmp_path):
    with guard_for(Station(find_document("stations", "emulated")), tmp_path, VirtualClock()) as guard:
        assert type(guard) is Guard
        assert guard.beat() is None
        guard.release()


def test_a_bench_behind_ports_has_one(station, tmp_path):
    assert isinstance(guard_for(station, tmp_path, WallClock()), GuardProcess)


def test_the_log_of_a_guard_is_on_the_clock_of_a_fast_bench(station, tmp_path):
    clock = WallClock(speed=1000.0)
    with GuardProcess(station, tmp_path, clock) as guard:
        clock.sleep(200.0)
        guard.release()
    begin, *_, end = (line.partition(" ")[0] for line in (tmp_path / LOG_NAME).read_text().splitlines())
    assert (datetime.fromisoformat(end) - datetime.fromisoformat(begin)).total_seconds() > 190.0


def test_a_guard_that_can_not_start_is_an_error(station, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(GyrobenchError, match="did not start"), GuardProcess(station, tmp_path, WallClock()):
        pass


def test_a_guard_that_can_not_be_replaced_is_noted_once_a_minute(station, tmp_path, monkeypatch):
    clock = WallClock()
    with GuardProcess(station, tmp_path, clock) as guard:
        monkeypatch.setattr(sys, "executable", "/bin/false")
        guard._process.kill()
        guard._process.wait()
        assert "could not be started" in guard.beat()
        assert guard.beat() is None
        guard.release()


def test_only_the_engine_holds_its_end_of_the_pipe(station, tmp_path):
    with GuardProcess(station, tmp_path, WallClock()) as guard:
        assert not os.get_inheritable(guard._pipe)
        pipe = os.fstat(guard._pipe).st_ino
        ends = []
        for path in Path(f"/proc/{guard.pid}/fd").iterdir():
            with contextlib.suppress(FileNotFoundError):  # the guard, which still starts, has closed it
                ends += [path.name] if path.stat().st_ino == pipe else []
        assert ends == ["0"]
        guard._end()


def test_a_guard_that_died_is_replaced(station, tmp_path):
    with GuardProcess(station, tmp_path, WallClock()) as guard:
        dead = guard.pid
        guard._process.kill()
        guard._process.wait()
        assert guard.beat() == "the guard process died; a new one was started"
        assert guard.pid != dead
        assert guard.beat() is None
        guard._end()


def test_a_guard_that_hangs_is_replaced(station, tmp_path):
    with GuardProcess(station, tmp_path, WallClock()) as guard:
        hanging = guard.pid
        os.kill(hanging, signal.SIGSTOP)
        notes = [note for _ in range(5000) if (note := guard.beat())]
        assert notes == ["the guard process hung; a new one was started"]
        assert guard.pid != hanging
        guard._end()


def test_starting_loads_nothing_heavy():
    code = (
        "import sys, gyrobench.bench.guard.__main__\n"
        "print(sorted({'numpy', 'scipy', 'numba', 'can', 'pydantic', 'serial', 'yaml'} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
