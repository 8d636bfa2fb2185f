import getpass
import platform
import subprocess
from datetime import UTC, datetime

import pytest

from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.provenance import (
    data_hashes,
    emulated_bench_text,
    read_provenance,
    write_provenance,
)


def written(tmp_path):
    folder = RunFolder(tmp_path)
    for path in (folder.procedure, folder.station):
        path.write_text("a: 1\n")
    write_provenance(folder, datetime(2026, 1, 1, tzinfo=UTC), {}, {})
    return read_provenance(folder)


def test_who_started_it_and_where_is_reported(tmp_path):
    own = written(tmp_path)
    assert own["operator"] == getpass.getuser()
    assert own["host"] == platform.node()
    offset = datetime(2026, 1, 1, tzinfo=UTC).astimezone().utcoffset()
    assert own["utc_offset_s"] == offset.total_seconds()


def test_a_user_without_a_name_is_no_fault(tmp_path, monkeypatch):
    def unknown_user():
        raise OSError("no such user")

    monkeypatch.setattr(getpass, "getuser", unknown_user)
    assert written(tmp_path)["operator"] == "unknown"


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"clock": "wall"}, ""),
        (
            {"clock": "wall", "world": "gyro_b", "seed": 7, "faults": "bus.yaml"},
            "Emulated bench: world gyro_b, seed 7, faults bus.yaml, wall clock. All data are simulated.",
        ),
    ],
)
def test_only_an_emulated_bench_is_stated_as_one(tmp_path, options, text):
    folder = RunFolder(tmp_path)
    for path in (folder.procedure, folder.station):
        path.write_text("a: 1\n")
    write_provenance(folder, datetime(2026, 1, 1, tzinfo=UTC), {}, options)
    assert emulated_bench_text(folder) == text


@pytest.fixture
def folder(tmp_path):
    folder = RunFolder(tmp_path)
    folder.can.mkdir()
    folder.dwells.write_text("dwell\n")
    for number in (2, 1, 3):
        (folder.can / f"part-{number:05d}.blf").write_bytes(bytes([number]) * 100)
    return folder


def test_hashes_are_those_that_sha256sum_gives(folder):
    table, log = data_hashes(folder)
    assert (table.name, table.count) == ("dwells.csv", 1)
    assert (log.name, log.count) == ("can/*.blf", 3)
    for command, ours in (("sha256sum < dwells.csv", table), ("sha256sum can/*.blf | sha256sum", log)):
        printed = subprocess.run(["sh", "-c", command], cwd=folder.path, capture_output=True, check=True)
        assert printed.stdout.decode().split()[0] == ours.sha256


@pytest.mark.parametrize("change", ["content", "name", "number"])
def test_any_change_of_the_log_changes_its_hash(folder, change):
    before = data_hashes(folder)[-1].sha256
    part = folder.can / "part-00002.blf"
    if change == "content":
        part.write_bytes(b"x")
    elif change == "name":
        part.rename(folder.can / "part-00004.blf")
    else:
        part.unlink()
    assert data_hashes(folder)[-1].sha256 != before


def test_nothing_there_gives_no_hash(tmp_path):
    assert data_hashes(RunFolder(tmp_path)) == []
