"""The guard with real processes, on wall time, over pseudo-terminals."""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest
import serial

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.guard.process import GuardProcess
from gyrobench.bench.guard.watching import GuardConfig
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.station.bench_lock import BenchLock
from tests.bench.guard.served_bench import is_running, wait_for

pytestmark = pytest.mark.wall_time


@contextmanager
def orphaned_guard(bench, folder):
    """A guard whose engine died right after it had started the guard."""
    with subprocess.Popen(["true"]) as engine:
        pass
    orders = GuardConfig(
        str(bench.station.path), str(folder), 5.0, engine.pid, "2026-01-01T00:00:00+00:00", 7.0
    )  # fmt: skip
    command = [sys.executable, "-m", "gyrobench.bench.guard"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL) as guard:
        guard.stdin.write(orders.line())
        guard.stdin.close()
        yield guard


def assert_safe(bench):
    rates_dps, servos, set_point_c = bench.state()
    assert all(abs(rate_dps) < 0.01 for rate_dps in rates_dps)
    assert all(servo.endswith("Open") for servo in servos)
    assert set_point_c == 23.0


def test_a_killed_engine_leaves_a_safe_bench_and_its_guard_ignores_signals(served, start_engine):
    engine = start_engine()
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
        os.kill(engine.guard_pid, number)
    engine.process.kill()
    wait_for(lambda: not is_running(engine.guard_pid))
    assert_safe(served)
    (entry,) = read_journal(engine.folder / "journal.jsonl")
    assert entry["event"] == "guard_acted"
    assert entry["reason"] == "the engine died without releasing the guard"
    assert [action["problem"] for action in entry["safe_state"]] == [""] * 4
    assert "the bench is in its safe state" in engine.log()


def test_a_stopped_engine_is_killed_and_leaves_a_safe_bench(served, start_engine):
    engine = start_engine()
    engine.process.send_signal(signal.SIGSTOP)
    assert engine.process.wait(300) == -signal.SIGKILL
    wait_for(lambda: not is_running(engine.guard_pid))
    assert_safe(served)
    (entry,) = read_journal(engine.folder / "journal.jsonl")
    assert entry["reason"] == "the engine hangs"


def test_an_engine_killed_while_its_guard_starts_leaves_a_safe_bench(served, tmp_path):
    served.disturb()
    with orphaned_guard(served, tmp_path) as guard:
        assert guard.wait(300) == 0
    assert_safe(served)
    (entry,) = read_journal(tmp_path / "journal.jsonl")
    assert 7.0 <= entry["time_s"] < 60.0


@pytest.mark.long
def test_a_guard_that_can_not_write_still_makes_the_bench_safe(served, tmp_path):
    served.disturb()
    with orphaned_guard(served, tmp_path / "gone") as guard:
        assert guard.wait(300) == 0
    assert_safe(served)


def test_a_run_that_took_the_bench_in_between_is_undisturbed(served, tmp_path):
    served.disturb()
    with (
        BenchLock(served.station, tmp_path / "resumed", WallClock()),
        orphaned_guard(served, tmp_path) as guard,
    ):
        assert guard.wait(300) == 0
    log = (tmp_path / "guard.log").read_text()
    assert "ends without acting" in log
    assert str(tmp_path / "resumed") in log
    assert served.state()[2] == 60.0
    assert not (tmp_path / "journal.jsonl").exists()


def test_a_busy_port_is_retried_and_the_other_instrument_does_not_wait_for_it(served, tmp_path):
    served.disturb()
    log = tmp_path / "guard.log"
    with orphaned_guard(served, tmp_path) as guard:
        with serial.Serial(served.urls["table"], exclusive=True):
            wait_for(lambda: log.exists() and "rate table's servos off" in log.read_text())
            assert "chamber's set point at 23 degC: done" in log.read_text()
            assert "rate table stopped: rate table: can't open" in log.read_text()
        assert guard.wait(300) == 0
    assert "the bench is in its safe state" in log.read_text()
    assert_safe(served)
    first, last = read_journal(tmp_path / "journal.jsonl")
    assert [bool(action["problem"]) for action in first["safe_state"]] == [True, False, False, True]
    assert [action["what"] for action in last["safe_state"]] == [
        "rate table stopped",
        "rate table's servos off",
    ]


def test_a_guard_left_unreleased_acts_when_the_bench_is_free_and_lets_the_process_live(served, tmp_path):
    served.disturb()
    clock = WallClock()
    with BenchLock(served.station, tmp_path, clock), GuardProcess(served.station, tmp_path, clock) as guard:
        pass
    assert guard._process.wait(300) == 0
    assert_safe(served)


def test_a_released_guard_leaves_the_bench_as_it_is(served, tmp_path):
    with GuardProcess(served.station, tmp_path, WallClock()) as guard:
        pid = guard.pid
        assert is_running(pid)
        assert guard.beat() is None
        guard.release()
        assert not is_running(pid)
    assert "released" in (tmp_path / "guard.log").read_text()
    assert not (tmp_path / "journal.jsonl").exists()
