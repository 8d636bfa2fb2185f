"""Exit codes that all commands share."""

import os

import pytest

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.station.locks import LOCK_DIR_VARIABLE, BenchLock
from gyrobench.bench.station.station import Station
from tests.bench.command_line import gyrobench

COMMANDS = {
    "run": ("run", "ten_minute_check", "--station", "real.yaml"),
    "check": ("check", "real.yaml"),
    "jog": ("jog", "real.yaml", "show"),
    "record": ("record", "real.yaml", "--instrument", "table", "--out", "table.rec"),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_bench_that_a_receiver_else_holds_is_not_touched_and_ends_with_three(
    command, tmp_path, monkeypatch
):
    monkeypatch.setenv(LOCK_DIR_VARIABLE, str(tmp_path))
    text = find_document("stations", "emulated").read_text().replace("clock: virtual", "clock: wall")
    path = tmp_path / "real.yaml"
    path.write_text(text.replace("emulator://table", os.devnull))
    with BenchLock(Station(path), tmp_path / "some_run", WallClock()):
        answer = gyrobench(*COMMANDS[command], cwd=tmp_path)
    assert answer.returncode == 3
    assert "some_run" in answer.stderr
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    "command",
    [("validate", "bad.yaml"), ("check", "bad.yaml"), ("run", "ten_minute_check", "--station", "bad.yaml")],
)
def test_a_station_with_one_signal_in_two_roles_is_refused_with_its_line(command, tmp_path):
    text = find_document("stations", "emulated").read_text()
    text = text.replace("VELOCITY_NE.VELOCITY_EAST", "VELOCITY_NE.VELOCITY_NORTH")
    (tmp_path / "bad.yaml").write_text(text)
    answer = gyrobench(*command, cwd=tmp_path)
    assert answer.returncode == 2
    assert "VELOCITY_NORTH is already mapped to velocity_east" in answer.stderr + answer.stdout
    assert "bad.yaml:" in answer.stderr + answer.stdout
