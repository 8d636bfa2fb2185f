"""A preflight in real time, the emulators in a process of their own behind real ports."""

from pathlib import Path

import pytest

from gyrobench.bench.engine.preflight.bench_check import check_bench
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import BenchInUseError
from gyrobench.bench.station.bench_lock import BenchLock
from gyrobench.bench.station.check_result import CheckVerdict
from gyrobench.bench.station.instruments import Emulation
from gyrobench.bench.station.station import Station
from tests.bench.engine.stations import served_station


@pytest.mark.long
@pytest.mark.wall_time
def test_a_bench_behind_real_ports_passes_and_one_that_a_run_holds_is_refused(tmp_path):
    with served_station(tmp_path) as path:
        with (
            BenchLock(Station(path), Path("runs/night"), WallClock()),
            pytest.raises(BenchInUseError, match="night"),
        ):
            check_bench(str(path), None, Emulation(), tmp_path)
        checks = check_bench(str(path), "ten_minute_check", Emulation(), tmp_path)
    assert [each for each in checks if each.verdict is not CheckVerdict.PASS] == []
    assert {each.subject for each in checks} == {"procedure", "rate table", "chamber", "INS", "disk"}
