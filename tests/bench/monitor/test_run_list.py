import json
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.engine.resume import NO_END_RECORDED
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.monitor.run_list import (
    cached_by_files,
    is_run,
    runs_in,
    signature_of,
    snapshot_from_records,
    snapshot_of,
    summarise,
)
from gyrobench.bench.monitor.snapshot import Question, RunSnapshot, RunState
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal
from gyrobench.bench.runs.locks import RunLock
from tests.bench.monitor.served_run import run_under_way, write_snapshot


@pytest.fixture
def folder(recorded, tmp_path):
    """A copy of a run that finished."""
    shutil.copytree(recorded.folder.path, tmp_path / "run")
    return RunFolder(tmp_path / "run")


def cut_off(folder, event):
    """Leave the journal as a kill after an event would."""
    lines = folder.journal.read_text().splitlines(keepends=True)
    last = next(number for number, line in enumerate(lines) if json.loads(line)["event"] == event)
    folder.journal.write_text("".join(lines[: last + 1]))


def add(folder, **details):
    """Write an entry as the last one of the journal."""
    entry = {"time_s": 90_000.0, "utc": "2000-01-02T01:00:00+00:00", **details}
    with folder.journal.open("a") as journal:
        journal.write(json.dumps(entry) + "\n")


def test_a_run_reports_its_snapshot_itself(folder, recorded):
    written, last = snapshot_of(folder.path), recorded.snapshots[-1]
    # Made one after the other, maybe on both sides of a full second.
    assert replace(written, updated_utc=last.updated_utc).to_json() == last.to_json()


def test_the_records_of_a_run_give_the_same_snapshot_but_for_what_they_do_not_hold(folder):
    live, found = snapshot_of(folder.path), snapshot_from_records(folder)
    assert found.dwells == tuple(
        replace(each, gyro_c=found.dwells[0].gyro_c, bias_dph=found.dwells[0].bias_dph,
                sigma_dph=found.dwells[0].sigma_dph)
        for each in live.dwells
    )  # fmt: skip
    np.testing.assert_allclose(found.dwells[0].bias_dph, live.dwells[0].bias_dph, atol=1e-9)
    assert (found.name, found.procedure, found.station, found.unit) == (
        live.name, live.procedure, live.station, live.unit,
    )  # fmt: skip
    assert (found.state, found.reason, found.left_s) == (RunState.FINISHED, "", 0.0)
    assert found.now_s == pytest.approx(live.now_s, abs=20.0)
    assert found.planned == live.planned
    assert len(found.bins) == len(live.bins)
    assert found.bench.ins_mode in ("navigate", "boot", "unknown")
    assert found.measured.time_s[-1] == pytest.approx(live.measured.time_s[-1], abs=20.0)
    np.testing.assert_allclose(found.attitude.body_in_enu, live.attitude.body_in_enu, atol=1e-3)
    assert RunSnapshot.from_json(found.to_json()).to_json() == found.to_json()


@pytest.mark.parametrize("content", [None, b"", b"{", b"[1, 2]"])
def test_without_a_snapshot_or_with_a_damaged_one_the_records_are_read(folder, content):
    folder.live.unlink()
    if content is not None:
        folder.live.write_bytes(content)
    snapshot = snapshot_of(folder.path)
    assert snapshot.state is RunState.FINISHED
    assert len(snapshot.dwells) == 1


def running(folder):
    return replace(
        snapshot_of(folder.path),
        state=RunState.RUNNING,
        question=Question("Is the cable free?", ("yes", "no")),
    )


def test_a_run_that_was_killed_is_not_said_to_continue(folder):
    cut_off(folder, "dwell_finished")
    folder.live.write_bytes(running(folder).to_json())
    snapshot = snapshot_of(folder.path)
    assert (snapshot.state, snapshot.reason) == (RunState.STOPPED, NO_END_RECORDED)
    assert snapshot.question is None


def test_a_run_that_was_killed_after_its_last_snapshot_shows_all_dwells_that_its_journal_has(folder):
    before = replace(running(folder), finished_dwells=0, dwells=())
    cut_off(folder, "dwell_finished")
    folder.live.write_bytes(before.to_json())
    assert (snapshot_of(folder.path).finished_dwells, len(snapshot_of(folder.path).dwells)) == (1, 1)
    assert summarise(folder.path).dwells == 1


def test_a_run_that_was_killed_and_whose_journal_was_lost_shows_its_last_snapshot(folder):
    folder.live.write_bytes(running(folder).to_json())
    folder.journal.write_text("")
    snapshot = snapshot_of(folder.path)
    assert (snapshot.state, snapshot.finished_dwells) == (RunState.STOPPED, 1)


def test_a_run_that_a_process_holds_continues(folder):
    folder.live.write_bytes(running(folder).to_json())
    with RunLock(folder.path, WallClock()):
        snapshot = snapshot_of(folder.path)
    assert snapshot.state is RunState.RUNNING
    assert snapshot.question.text == "Is the cable free?"


def test_an_investigation_is_listed_with_its_unit_its_dwells_and_its_end(tmp_path):
    journal = Journal(tmp_path / "journal.jsonl", WallClock())
    with RunLock(tmp_path, WallClock()), journal:
        journal.record("investigation_started", procedure="investigation", unit="S1", dwells=24)
        journal.record("measured", number=1, dwells=6)
        journal.record("investigation_resumed", procedure="investigation", unit="S1", dwells=24)
        journal.record("measured", number=1, dwells=6)
        assert summarise(tmp_path).state is RunState.RUNNING
        journal.record("investigation_ended", ended="settled", reason="Warm-up: probability 0.9990.")
    found = summarise(tmp_path)
    assert (found.procedure, found.units, found.dwells) == ("investigation", ["S1"], 30)
    assert (found.state, found.reason) == (RunState.FINISHED, "Warm-up: probability 0.9990.")
    assert found.started_utc
    assert snapshot_of(tmp_path).procedure == "investigation"


def test_a_run_that_was_killed_before_it_left_a_snapshot_has_what_was_on_the_disk(folder):
    folder.live.unlink()
    folder.dwells.unlink()
    cut_off(folder, "powered_on")
    snapshot = snapshot_of(folder.path)
    assert (snapshot.state, snapshot.reason) == (RunState.STOPPED, NO_END_RECORDED)
    assert snapshot.dwells == ()
    assert snapshot.left_s == pytest.approx(snapshot.planned_s)


def test_a_run_that_ended_and_was_resumed_and_killed_does_not_report_its_old_end(folder):
    folder.live.unlink()
    add(folder, event="run_resumed", procedure="short")
    snapshot = snapshot_of(folder.path)
    assert (snapshot.state, snapshot.reason) == (RunState.STOPPED, NO_END_RECORDED)


def test_a_run_whose_procedure_is_damaged_has_its_dwells_still(folder):
    folder.live.unlink()
    folder.procedure.write_text("procedure: [")
    snapshot = snapshot_of(folder.path)
    assert len(snapshot.dwells) == 1
    assert (snapshot.state, snapshot.planned.time_s) == (RunState.FINISHED, ())
    assert not math.isnan(snapshot.now_s)


def test_messages_are_those_that_the_journal_shows(folder):
    folder.live.unlink()
    add(folder, event="note", text="look here")
    assert snapshot_of(folder.path).messages[-1].text == "look here"


def test_what_is_no_run_folder_is_refused(tmp_path):
    with pytest.raises(RunFolderError):
        snapshot_of(tmp_path)


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


def test_a_run_without_a_snapshot_is_read_from_its_journal(tmp_path):
    write_journal(tmp_path / "old", JOURNAL)
    summary = summarise(tmp_path / "old")
    assert (summary.procedure, summary.units, summary.dwells) == ("shift", ["1001"], 2)
    assert (summary.state, summary.reason) == (RunState.FAILED, "the chamber is broken")


def test_a_run_of_several_units_is_listed_with_all_of_them(tmp_path):
    write_journal(tmp_path / "old", JOURNAL)
    for number in ("1001", "1002"):
        (tmp_path / "old/units" / number).mkdir(parents=True)
        write_journal(tmp_path / "old/units" / number, JOURNAL)
    assert summarise(tmp_path / "old").units == ["1001", "1002"]


def test_a_run_that_did_not_report_of_its_end_was_cut_off(tmp_path):
    write_journal(tmp_path / "old", JOURNAL[:-1])
    summary = summarise(tmp_path / "old")
    assert summary.state is RunState.STOPPED
    assert "without recording its end" in summary.reason


def test_a_run_that_was_stopped_resumed_and_cut_off_does_not_report_its_old_end(tmp_path):
    write_journal(tmp_path / "old", [*JOURNAL, {"event": "run_resumed", "procedure": "shift"}])
    summary = summarise(tmp_path / "old")
    assert summary.state is RunState.STOPPED
    assert "without recording its end" in summary.reason
    assert (summary.procedure, summary.units, summary.dwells) == ("shift", ["1001"], 2)


def test_a_run_with_a_snapshot_is_read_from_it(tmp_path):
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


def test_the_signature_changes_with_the_snapshot_and_with_who_holds_the_run(tmp_path):
    with run_under_way(tmp_path / "mine") as run:
        first = signature_of(run)
        assert signature_of(run) == first
        write_snapshot(run)
        second = signature_of(run)
    assert len({first, second, signature_of(run)}) == 3


def test_a_value_is_made_again_only_when_its_folder_has_changed(tmp_path):
    made, signs = [], {}
    memory = cached_by_files(lambda folder: made.append(folder) or len(made), 2, signs.get)
    one, two, three = (tmp_path / name for name in "123")
    assert [memory(one), memory(one)] == [1, 1]
    signs[one] = "changed"
    assert [memory(one), memory(two), memory(one)] == [2, 3, 2]
    assert memory(three) == 4
    assert [memory(one), memory(two)] == [2, 5], "the one that was asked for longest ago is dropped"


def test_an_error_is_passed_on_and_tried_again(tmp_path):
    answers = iter([ValueError("damaged"), "whole"])

    def make(_):
        answer = next(answers)
        if isinstance(answer, Exception):
            raise answer
        return answer

    memory = cached_by_files(make, 1, lambda _: 0)
    with pytest.raises(ValueError, match="damaged"):
        memory(tmp_path)
    assert memory(tmp_path) == "whole"
