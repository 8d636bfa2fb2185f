"""A preflight in real time, the emulators in a process of their own behind real ports."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from gyrobench.bench.engine.preflight.bench_check import check_bench
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import BenchInUseError
from gyrobench.bench.station.instruments import Emulation
from gyrobench.bench.station.locks import BenchLock
from gyrobench.bench.station.preflight_check import CheckVerdict
from gyrobench.bench.station.station import Station
from tests.bench.engine.test_wall_time import station_of

SERVE = "gyrobench.drivers.emulators.serve"


@pytest.mark.long
@pytest.mark.wall_time
def test_a_bench_behind_real_ports_passes_and_one_that_a_run_holds_is_refused(tmp_path):
    command = [
        sys.executable,
        "-m",
        "gyrobench.drivers.emulators.serve",
        "--world",
        "ideal",
        "--for-s",
        "1000",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        path = tmp_path / "station.yaml"
        path.write_text(station_of(json.loads(server.stdout.readline())))
        with (
            BenchLock(Station(path), Path("runs/night"), WallClock()),
            pytest.raises(BenchInUseError, match="night"),
        ):
            check_bench(str(path), None, Emulation(), tmp_path)
        checks = check_bench(str(path), "ten_minute_check", Emulation(), tmp_path)
        server.terminate()
    assert [each for each in checks if each.verdict is not CheckVerdict.PASS] == []
    assert {each.subject for each in checks} == {"procedure", "rate table", "chamber", "INS", "disk"}
