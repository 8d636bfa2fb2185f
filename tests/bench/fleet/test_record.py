"""The record shows what is left to do."""

import pytest

from gyrobench.bench.fleet.jobs import FleetRecord, JobKind, JobResult, JobState, read_record
from gyrobench.bench.foundations.errors import RunFolderError


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
