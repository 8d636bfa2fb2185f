"""The fuzzer's short form, and that it finds what it looks for."""

import re
import socket
import subprocess
import sys
import time
from random import Random

import pytest

from tests.fuzz.mutations import damaged_bytes, damaged_csv, damaged_dbc, damaged_json, damaged_yaml
from tests.fuzz.sandbox import HangError, Sandbox

pytestmark = pytest.mark.long

COUNT = 100


def test_no_damaged_file_brings_more_than_a_clean_error():
    command = [sys.executable, "-m", "tests.fuzz", "--count", str(COUNT), "--seed", "11", "--jobs", "1"]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr
    rows = re.findall(r"^(\w[\w ]*?) +(\d+) +(\d+) +(\d+) +0$", result.stdout, re.MULTILINE)
    *kinds, total = [(name, *map(int, counts)) for name, *counts in rows]
    assert {"procedure", "station", "world", "fault list", "DBC", "dwell table", "resumed run"} < {
        name for name, *_ in kinds
    }
    assert all(inputs == refused + accepted >= 1 for _, inputs, refused, accepted in kinds)
    name, inputs, refused, accepted = total
    assert (name, inputs) == ("all", sum(inputs for _, inputs, *_ in kinds))
    assert inputs == pytest.approx(COUNT, rel=0.1)
    assert refused > accepted > 0


@pytest.mark.parametrize(
    ("damage", "data"),
    [
        (damaged_bytes, b"some bytes to damage"),
        (damaged_yaml, b"a: 1\nb: [1, 2, {c: d}]\n"),
        (damaged_json, b'{"a": 1, "b": [1, 2]}'),
        (damaged_csv, b"a,b\n1,2\n3,4\n"),
        (damaged_dbc, b'BO_ 1 M: 8 X\n SG_ S : 0|8@1+ (1,0) [0|0] "" X\n'),
    ],
)
def test_damage_follows_from_the_seed(damage, data):
    made = [[damage(Random(seed), data) for seed in range(50)] for _ in range(2)]  # noqa: S311
    assert made[0] == made[1]
    assert len(set(made[0])) > 20


@pytest.fixture(scope="module")
def sandbox():
    return Sandbox()


def test_the_sandbox_notes_what_is_written_outside(sandbox, tmp_path):
    inside = tmp_path / "inside"
    inside.mkdir()
    with sandbox.inside(inside, 10, 60):
        (inside / "file").write_text("x")
        (inside / "file").rename(inside / "other")
        (tmp_path / "absent").exists()
    assert sandbox.broken == []
    (inside / "link").symlink_to(tmp_path)
    with sandbox.inside(inside, 10, 60):
        (inside / "../outside").write_text("x")
        (inside / "link/outside").write_text("x")
        (inside / "other").rename(tmp_path / "other")
        (tmp_path / "folder").mkdir()
    assert [line.split()[0] for line in sandbox.broken] == ["open", "open", "os.rename", "os.mkdir"]


def test_the_sandbox_notes_processes_and_connections(sandbox, tmp_path):
    with sandbox.inside(tmp_path, 10, 60):
        subprocess.run([sys.executable, "-c", ""], check=True)
        socket.socket().close()
        with socket.create_server(("127.0.0.1", 0)):
            pass
    assert any(line.startswith("subprocess.Popen") for line in sandbox.broken)
    assert any(line.startswith("socket.bind") for line in sandbox.broken)


def spin():
    while True:
        pass


def test_the_sandbox_ends_what_hangs(sandbox, tmp_path):
    with pytest.raises(HangError), sandbox.inside(tmp_path, 10, 0.2):
        time.sleep(30)
    with pytest.raises(HangError), sandbox.inside(tmp_path, 0.2, 60):
        spin()
