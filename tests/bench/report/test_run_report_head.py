import json

import pytest

from gyrobench.bench.report.content import read_run
from gyrobench.bench.report.run_report import ending_of, head_lines, serial_number_of
from gyrobench.bench.runs.folder import RunFolder


@pytest.fixture
def stopped(empty_folder, journal_writer):
    """A run that was stopped by order in a turn."""
    journal_writer(empty_folder, ended="stopped", reason="stopped by SIGINT")
    return empty_folder


def add(folder, **entry):
    with folder.journal.open("a", encoding="utf-8") as journal:
        journal.write(json.dumps(entry) + "\n")


def resume(folder):
    add(folder, time_s=9000.0, event="run_resumed", procedure="six_position_fig7", station="emulated")


def test_a_run_tells_how_it_ended_and_where(stopped: RunFolder):
    ending = ending_of(read_run(stopped))
    assert (ending["word"], ending["reason"]) == ("stopped", "stopped by SIGINT")
    assert ending["step"] == "step 6, turn 180 deg (cycle 1, 62 degC, z_up)"
    assert [action["what"] for action in ending["safe_state"]] == [
        "rate table stopped",
        "chamber switched off",
    ]


def test_a_run_that_was_stopped_resumed_and_cut_off_has_not_ended(stopped: RunFolder):
    resume(stopped)
    content = read_run(stopped)
    ending, lines = ending_of(content), head_lines(content)
    assert ending["word"] == "not ended"
    assert "killed or cut off" in ending["reason"]
    assert ending["safe_state"] == ()
    assert "ended" not in lines
    assert lines["duration"] == "2:30 h, gone on with 1 time"


def test_a_run_that_was_stopped_and_resumed_tells_its_new_end(stopped: RunFolder):
    resume(stopped)
    add(stopped, time_s=9060.0, event="step_finished", step=6)
    add(stopped, time_s=9100.0, event="run_ended", ended="finished", reason="", safe_state=[])
    ending = ending_of(read_run(stopped))
    assert (ending["word"], ending["reason"], ending["step"]) == ("finished", "", "")


def test_the_serial_number_of_a_run_without_dwells_is_what_the_ins_said(stopped: RunFolder):
    assert serial_number_of(read_run(stopped)) == ""
    add(stopped, time_s=9000.0, event="ins_identified", unit="1007")
    assert serial_number_of(read_run(stopped)) == "1007"
