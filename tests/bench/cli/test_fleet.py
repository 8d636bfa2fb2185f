"""``gyrobench fleet`` as an engineer types it."""

import json
import sys

import pytest

from gyrobench.bench.bias.dwell_table import read_dwells, write_dwells
from gyrobench.bench.cli.output import EXIT_NOT_FINISHED, EXIT_WRONG_INPUT
from gyrobench.bench.runs.folder import RunFolder
from tests.bench.command_line import gyrobench, output_of, refusal_of
from tests.bench.runs.index.sample_runs import copy_run
from tests.benchmarks.fleet_runs import OUTLIER, make_runs


@pytest.fixture
def place(tmp_path, sample):
    """Folder with two good runs and a damaged one."""
    for name, unit in (("a", "1001"), ("b", "1002"), ("broken", "1003")):
        copy_run(sample, tmp_path / "runs" / name, unit)
    (tmp_path / "runs" / "broken" / "station.yaml").write_text("station: [")
    return tmp_path


def test_only_what_failed_is_done_again(place):
    printed = output_of(
        "fleet", "bins", "runs", "--threads", "--workers", 1, cwd=place, code=EXIT_NOT_FINISHED
    )
    assert "fleet bins: 3 of 3 runs, 1 thread" in printed
    assert f"failed: {place / 'runs' / 'broken'}" in printed
    assert "2 done, 1 failed" in printed
    (place / "runs" / "broken" / "station.yaml").write_bytes(
        (place / "runs" / "a" / "station.yaml").read_bytes()
    )
    second = gyrobench("fleet", "bins", "runs", "--threads", "--json", cwd=place)
    assert second.returncode == 0, second.stderr
    assert "1 of 3 runs" in second.stderr
    assert {run["state"] for run in json.loads(second.stdout)["runs"].values()} == {"done"}
    assert "3 done before" in output_of("fleet", "bins", "runs", cwd=place)


def test_runs_that_can_not_be_searched_are_named_and_counted_apart_from_those_done(sample, tmp_path):
    for name in ("few", "searched"):
        copy_run(sample, tmp_path / "runs" / name, "1001")
    few = RunFolder(tmp_path / "runs" / "few")
    write_dwells(few.dwells, read_dwells(few.dwells)[:2])
    printed = output_of("fleet", "close", "runs", "--threads", "--workers", 1, cwd=tmp_path)
    assert f"not searched: {few.path}\n" in printed
    assert "degrees of freedom" in printed
    assert "1 done, 1 not searched; " in printed
    output = output_of("fleet", "close", "runs", cwd=tmp_path)
    assert f"not searched: {few.path}\n" in output
    assert "1 done before, 1 not searched before; " in output


def test_runs_in_folders_of_this_machine_need_no_extra(place, monkeypatch):
    for name in ("fsspec", "fsspec.core", "duckdb", "distributed"):
        monkeypatch.setitem(sys.modules, name, None)
    assert "2 done" in output_of("fleet", "close", "runs/a", "runs/b", "--threads", "--workers", 1, cwd=place)


def test_runs_of_an_index_are_chosen_by_what_they_are(place):
    printed = output_of(
        "fleet", "report", "--from-index", "runs", "--unit", "1002", "--threads", "--json", cwd=place
    )
    assert list(json.loads(printed)["runs"]) == [str(place / "runs" / "b")]
    assert (place / "runs" / "b" / "report.html").exists()


def test_mistakes_are_reported(place):
    for wrong in (
        ["bins"],
        ["bins", "runs", "--unit", "1001"],
        ["close", "runs", "--scheduler", "tcp://127.0.0.1:1", "--workers", 2],
    ):
        assert gyrobench("fleet", *wrong, cwd=place).returncode == EXIT_WRONG_INPUT
    assert "no run folder found" in refusal_of("fleet", "bins", "nowhere", cwd=place)


@pytest.mark.long
def test_the_outlier_of_an_emulated_batch_is_named(tmp_path):
    make_runs(tmp_path / "runs", OUTLIER + 1, OUTLIER + 1, outlying_dph=0.05)
    lines = "".join(f"{2000 + unit},B7\n" for unit in range(OUTLIER + 1))
    (tmp_path / "runs" / "units.csv").write_text(f"unit,batch\n{lines}")
    printed = output_of("fleet", "batch", "--batch", "B7", "--out", "batch", cwd=tmp_path)
    assert max(map(len, printed.splitlines())) <= 80
    assert f"1 outlying unit: unit {2000 + OUTLIER} in Y gyro" in printed.replace("\n", " ")
    content = json.loads((tmp_path / "batch" / "batch.json").read_text())
    assert {each["unit"] for each in content["standing_out"]} == {str(2000 + OUTLIER)}
    assert "Batch B7" in (tmp_path / "batch" / "batch.html").read_text()


def test_units_of_several_batches_and_too_few_units_are_no_batch(place):
    (place / "runs" / "units.csv").write_text("unit,batch\n1001,B7\n")
    assert "Give --batch" in refusal_of("fleet", "batch", cwd=place)
    problem = refusal_of("fleet", "batch", "--batch", "B7", cwd=place, code=EXIT_NOT_FINISHED)
    assert "at least 4 units" in problem
