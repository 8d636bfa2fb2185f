"""Exit codes that all commands share."""

import os
import re
import subprocess
from pathlib import Path

import pytest

from gyrobench.bench.foundations.clock import VirtualClock, WallClock
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.journal import Journal
from gyrobench.bench.runs.locks import LOCK_DIR_VARIABLE
from gyrobench.bench.station.bench_lock import BenchLock
from gyrobench.bench.station.station import Station
from tests.bench.command_line import PROCESS, gyrobench, output_of, refusal_of

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


@pytest.mark.parametrize("option", ["--world", "--faults"])
@pytest.mark.parametrize(
    "command", [("run", "ten_minute_check"), ("check", "emulated"), ("jog", "emulated", "show")]
)
def test_a_wrong_world_or_list_of_faults_is_wrong_input_and_no_cable(command, option, tmp_path):
    (tmp_path / "wrong.yaml").write_text("x: 1\n")
    where = (*command[:2], option, "wrong.yaml", *command[2:])
    problem = refusal_of(*where, cwd=tmp_path)
    assert problem.count("unknown key 'x'") == 1
    assert "cable" not in problem
    assert "can't open" not in problem


def test_a_current_folder_that_was_deleted_is_reported(tmp_path):
    (tmp_path / "gone").mkdir()
    script = f"import os; os.chdir({str(tmp_path / 'gone')!r}); os.rmdir({str(tmp_path / 'gone')!r}); "
    command = [*PROCESS[:-1], script + PROCESS[-1], "validate", "mine.yaml"]
    answer = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (answer.returncode, "Traceback" in answer.stderr) == (2, False)
    assert "the current folder was deleted" in answer.stderr


@pytest.mark.parametrize("value", ["1.0e-300", "1.0e+300", "-1"])
def test_noise_whose_square_overflows_is_refused(value, tmp_path):
    text = find_document("stations", "emulated").read_text()
    text = re.sub(r"(angle_random_walk_deg_per_sqrt_h: )\S+", rf"\g<1>{value}", text)
    (tmp_path / "noisy.yaml").write_text(text)
    [line] = [number for number, each in enumerate(text.splitlines(), 1) if "angle_random_walk" in each]
    printed = output_of("validate", "noisy.yaml", cwd=tmp_path, code=2)
    assert value.replace(".0", "") in printed
    assert f"noisy.yaml:{line}:" in printed


@pytest.mark.parametrize(
    "command",
    [
        ("resume", "nowhere"),
        ("resume", "nowhere", "--look"),
        ("report", "nowhere"),
        ("bins", "nowhere"),
        ("close", "nowhere"),
        ("export", "nowhere"),
        ("monitor", "nowhere"),
        ("control", "nowhere", "abort"),
        ("verify", "nowhere"),
        ("fleet", "bins", "nowhere"),
        ("runs", "nowhere"),
    ],
)
def test_a_missing_run_is_wrong_input_in_every_command(command, tmp_path):
    assert refusal_of(*command, cwd=tmp_path).count("nowhere") == 1


@pytest.mark.parametrize("command", [("resume",), ("report",), ("control",)])
def test_a_path_that_is_too_long_is_wrong_input(command, tmp_path):
    problem = refusal_of(*command, "y" * 256, *(["skip"] if command == ("control",) else []), cwd=tmp_path)
    assert problem.endswith("the path is too long\n")


def test_a_run_folder_with_a_name_that_is_not_utf8_is_refused_before_anything_moves(tmp_path):
    command = [*map(os.fsencode, PROCESS), b"run", b"ten_minute_check", b"--out", b"run\xb0\xfa"]
    answer = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert answer.returncode == 2
    assert answer.stderr.startswith("gyrobench: 'run\\udcb0\\udcfa': not valid UTF-8")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", [("--version",), ("plan", "ten_minute_check", "--figure", "plan.png")])
def test_output_to_a_full_disk_is_an_error_in_one_line(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with Path("/dev/full").open("w") as full:
        command = [*PROCESS, *command]
        answer = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert answer.returncode == 1
    assert answer.stderr == "gyrobench: the output can't be written: No space left on device\n"


def test_close_on_a_run_without_dwells_says_why(tmp_path):
    (tmp_path / "journal.jsonl").write_text("")
    assert "no dwell was finished in this run" in refusal_of("close", tmp_path, cwd=tmp_path)


@pytest.mark.parametrize("port", ["/dev/nowhere", "socket://127.0.0.1:1"])
def test_a_port_that_can_not_be_opened_is_named_once(port, tmp_path):
    text = find_document("stations", "emulated").read_text().replace("clock: virtual", "clock: wall")
    (tmp_path / "real.yaml").write_text(text.replace("emulator://table", port))
    problem = refusal_of("run", "ten_minute_check", "--station", "real.yaml", cwd=tmp_path, code=3)
    assert problem.count(port) == 1
    assert "rate table: can't open" in problem


def test_jog_works_with_the_instruments_that_answer(tmp_path):
    text = (
        find_document("stations", "emulated").read_text().replace("emulator://chamber", "emulator://nowhere")
    )
    (tmp_path / "mine.yaml").write_text(text)
    printed = output_of("jog", "mine.yaml", "servo on", "table inner 5 at 1", "show", cwd=tmp_path)
    assert "Left out: chamber" in printed
    assert "Interlock chamber" not in printed
    assert "inner 5.0" in printed
    assert "rate table stopped" in printed
    refused = gyrobench("jog", "mine.yaml", "chamber 25 at 1", cwd=tmp_path)
    assert (refused.returncode, "Start jog again" in refused.stdout) == (1, True)
    assert "Acutrol3000" in output_of("check", "mine.yaml", cwd=tmp_path, code=1)


@pytest.mark.parametrize(
    "command",
    [
        ("run", "ten_minute_check", "--out", "taken"),
        ("run", "ten_minute_check", "--out", "/proc/x"),
        ("plan", "ten_minute_check", "--figure", "nowhere/x.png"),
        ("plan", "ten_minute_check", "--figure", "taken"),
    ],
)
def test_a_path_that_can_not_be_written_is_wrong_input(command, tmp_path):
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "notes.txt").write_text("mine")
    assert command[-1] in refusal_of(*command, cwd=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


@pytest.mark.parametrize("ended", ["", "stopped", "finished"])
def test_a_new_run_in_the_folder_of_an_interrupted_one_names_the_command_to_continue_it(ended, tmp_path):
    (tmp_path / "first").mkdir()
    with Journal(tmp_path / "first" / "journal.jsonl", VirtualClock()) as journal:
        journal.record("run_started", procedure="ten_minute_check", station="emulated")
        if ended:
            journal.record("run_ended", ended=ended, reason="", safe_state=[])
    problem = refusal_of("run", "ten_minute_check", "--out", "first", cwd=tmp_path)
    assert ("gyrobench resume first" in problem) == (ended != "finished")


def test_close_on_an_interrupted_run_without_dwells_does_not_speak_of_rotations(tmp_path):
    (tmp_path / "run").mkdir()
    with Journal(tmp_path / "run" / "journal.jsonl", VirtualClock()) as journal:
        journal.record("run_started", procedure="ten_minute_check", station="emulated")
    problem = refusal_of("close", "run", cwd=tmp_path)
    assert problem.startswith("run: the run has not finished. Resume it with: gyrobench resume run\n")
    assert "nothing to search. Search a run with finished dwells" in problem
    with Journal(tmp_path / "run" / "journal.jsonl", VirtualClock()) as journal:
        journal.record("dwell_finished", marks={"dwell": 1, "is_rotated": True}, flags="")
    assert "Rotations need a dwell" in gyrobench("close", "run", cwd=tmp_path).stderr


def test_a_key_for_seals_that_can_not_sign_is_named_before_anything_moves(tmp_path, monkeypatch):
    monkeypatch.setenv("GYROBENCH_SEAL_KEY", str(tmp_path / "weekend.pem"))
    problem = refusal_of("run", "ten_minute_check", cwd=tmp_path)
    assert "weekend.pem: can't be read" in problem
    assert "Correct GYROBENCH_SEAL_KEY, or unset it" in problem
    assert not (tmp_path / "runs").exists()
