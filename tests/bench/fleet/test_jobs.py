"""One job with one run: done, failed or left out, and nothing else is touched."""

import json

import pytest

from gyrobench.bench.fleet.jobs import JobKind, JobState, do_job, inputs_of
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.station.locks import RunLock
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
