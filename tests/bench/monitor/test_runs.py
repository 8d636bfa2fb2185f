import json

import pytest

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.live.picture import RunState
from gyrobench.bench.monitor.runs import is_run, runs_in, signature_of, summarise
from tests.bench.monitor.served_run import run_under_way, write_picture

JOURNAL = [
    {"event": "run_started", "procedure": "shift", "utc": "2026-03-01T10:00:00+00:00"},
    {"event": "ins_identified", "unit": "1001"},
    {"event": "dwell_finished"},
    {"event": "dwell_finished"},
    {"event": "run_ended", "ended": "failed", "reason": "the chamber is broken"},
]


def write_journal(folder, entries):
    folder.mkdir(exist_ok=True)
    (folder / "journal.jsonl").write_text("".join(json.dumps(entry) + "\n" for entry in entries))


def test_a_run_without_a_picture_is_told_from_its_journal(tmp_path):
    write_journal(tmp_path / "old", JOURNAL)
    summary = summarise(tmp_path / "old")
    assert (summary.procedure, summary.unit, summary.dwells) == ("shift", "1001", 2)
    assert (summary.state, summary.reason) == (RunState.FAILED, "the chamber is broken")


def test_a_run_that_did_not_tell_of_its_end_was_cut_off(tmp_path):
    write_journal(tmp_path / "old", JOURNAL[:-1])
    summary = summarise(tmp_path / "old")
    assert summary.state is RunState.STOPPED
    assert "without a word" in summary.reason


def test_a_run_that_was_stopped_resumed_and_cut_off_does_not_tell_its_old_end(tmp_path):
    write_journal(tmp_path / "old", [*JOURNAL, {"event": "run_resumed", "procedure": "shift"}])
    summary = summarise(tmp_path / "old")
    assert summary.state is RunState.STOPPED
    assert "without a word" in summary.reason
    assert (summary.procedure, summary.unit, summary.dwells) == ("shift", "1001", 2)


def test_a_run_with_a_picture_is_told_from_it(tmp_path):
    with run_under_way(tmp_path / "new") as run:
        summary = summarise(run)
    assert (summary.state, summary.dwells, summary.dwell_count) == (RunState.RUNNING, 13, 24)
    assert summary.left_s == pytest.approx(6 * 3600.0)


def test_runs_are_folders_in_which_one_has_begun(tmp_path):
    write_journal(tmp_path / "one", JOURNAL)
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    assert [run.name for run in runs_in(tmp_path)] == ["one"]
    assert not is_run(tmp_path)
    with pytest.raises(RunFolderError, match="can't be read"):
        runs_in(tmp_path / "nowhere")


def test_the_signature_changes_with_the_picture_and_with_who_holds_the_run(tmp_path):
    with run_under_way(tmp_path / "mine") as run:
        first = signature_of(run)
        assert signature_of(run) == first
        write_picture(run)
        second = signature_of(run)
    assert len({first, second, signature_of(run)}) == 3
