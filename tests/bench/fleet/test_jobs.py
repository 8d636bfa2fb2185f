"""One job with one run, and the record that shows what is left to do."""

import json

import pytest

from gyrobench.bench.fleet.jobs import (
    FleetRecord,
    JobKind,
    JobResult,
    JobState,
    do_job,
    inputs_of,
    read_record,
)
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.locks import RunLock
from tests.bench.runs.index.sample_runs import copy_run


@pytest.fixture
def run(sample, tmp_path):
    return copy_run(sample, tmp_path / "run").path


def test_bins_re_evaluates_a_run_from_its_raw_log(run, sample):
    (run / "dwells.csv").unlink()
    result = do_job(JobKind.BINS, str(run))
    assert (result.state, result.text) == (JobState.DONE, "12 dwells")
    assert (run / "dwells.csv").read_bytes() == (sample / "dwells.csv").read_bytes()


def test_close_searches_a_run_and_writes_page_and_verdict(run):
    result = do_job(JobKind.CLOSE, str(run))
    assert result.state == JobState.DONE, result.text
    assert result.text.startswith(json.loads((run / "closure" / "closure.json").read_text())["verdict"])
    assert (run / "closure" / "closure.html").exists()
    assert "Search for effects" in RunFolder(run).report.read_text()


def test_report_writes_the_report(run):
    assert do_job(JobKind.REPORT, str(run)).state == JobState.DONE
    assert RunFolder(run).report.exists()


def test_a_run_that_another_process_holds_is_left_out_with_the_reason(run):
    before = (run / "dwells.csv").read_bytes()
    with RunLock(run, WallClock(), command="another command"):
        result = do_job(JobKind.BINS, str(run))
    assert result.state == JobState.SKIPPED
    assert "another command" in result.text
    assert (run / "dwells.csv").read_bytes() == before


def test_a_damaged_run_fails_with_the_reason(run):
    (run / "station.yaml").write_text("station: [")
    result = do_job(JobKind.BINS, str(run))
    assert result.state == JobState.FAILED
    assert "station.yaml" in result.text
    assert do_job(JobKind.BINS, str(run.parent)).state == JobState.FAILED


def test_the_inputs_of_a_job_are_not_what_it_writes(run):
    before = {kind: inputs_of(kind, run) for kind in JobKind}
    assert do_job(JobKind.REPORT, str(run)).state == JobState.DONE
    assert {kind: inputs_of(kind, run) for kind in JobKind} == before
    with (run / "journal.jsonl").open("a") as journal:
        journal.write("{}\n")
    assert all(inputs_of(kind, run) != before[kind] for kind in JobKind)


@pytest.fixture
def runs(tmp_path):
    paths = [tmp_path / name for name in ("a", "b", "c", "d")]
    for path in paths:
        path.mkdir()
        (path / "journal.jsonl").write_text("{}\n")
    return paths


def test_what_failed_was_left_out_is_new_or_has_changed_is_left(runs, tmp_path):
    record = FleetRecord(JobKind.BINS, tmp_path / "record")
    for path, state in zip(runs, (JobState.DONE, JobState.FAILED, JobState.SKIPPED), strict=False):
        record.add(JobResult(str(path), state, "why", 1.0))
    record.write()
    again = read_record(JobKind.BINS, tmp_path / "record")
    assert again.runs == record.runs
    assert again.pending(runs) == runs[1:]
    (runs[0] / "journal.jsonl").write_text("{}\n{}\n")
    assert again.pending(runs) == runs


def test_no_record_is_an_empty_one(runs, tmp_path):
    assert read_record(JobKind.CLOSE, tmp_path / "none").pending(runs) == runs


def test_a_damaged_record_and_one_of_another_job_are_refused(tmp_path):
    FleetRecord(JobKind.BINS, tmp_path).write()
    with pytest.raises(RunFolderError, match=r"record of `gyrobench fleet bins`"):
        read_record(JobKind.CLOSE, tmp_path)
    (tmp_path / "fleet.json").write_text("{")
    with pytest.raises(RunFolderError, match=r"damaged.*--again"):
        read_record(JobKind.CLOSE, tmp_path)
