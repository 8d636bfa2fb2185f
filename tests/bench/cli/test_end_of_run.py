"""The end of a run that was stopped, as the terminal states it."""

import io
import weakref
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
import typer
from rich.console import Console

from gyrobench.bench.cli.output import EXIT_NOT_FINISHED, print_end
from gyrobench.bench.dwells.run_results import RunResults
from gyrobench.bench.engine.run_outcome import RunOutcome
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.report import run_findings, run_report
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal
from gyrobench.bench.station.safe_state import SafeAction, SafePart
from tests.bench.command_line import gyrobench


class _Row(SimpleNamespace):
    """Row of a dwell that can be referenced weakly."""


def lines_of(folder, outcome):
    """What the terminal shows of a run that did not finish; its command ends with the code for that."""
    with Journal(folder.journal, VirtualClock()) as journal:
        journal.record("run_started", procedure="ten_minute_check", station="emulated")
        journal.record("run_ended", ended=outcome.ended, reason=outcome.reason, safe_state=[])
    printed = io.StringIO()
    with pytest.raises(typer.Exit) as ended:
        print_end(Console(file=printed, width=80), folder, outcome, "x.yaml")
    assert ended.value.exit_code == EXIT_NOT_FINISHED
    return printed.getvalue().splitlines()


@pytest.mark.parametrize(
    ("reason", "sentence"),
    [
        ("stopped by the operator (Ctrl-C)", "The run was stopped by the operator (Ctrl-C)"),
        (
            "the operator answered 'stop' to: ready?",
            "The run stopped: the operator answered 'stop' to: ready?",
        ),
    ],
)
def test_a_stopped_run_begins_with_who_stopped_it_and_how_to_continue(tmp_path, reason, sentence):
    folder = RunFolder(tmp_path / "Labor 2")
    folder.path.mkdir()
    lines = lines_of(folder, RunOutcome(ended="stopped", reason=reason))
    resume = f"Resume   gyrobench resume '{folder.path}'"
    assert lines[:2] == [sentence, resume]
    assert lines[-1] == resume


def test_a_note_on_several_units_is_printed_and_reported_once_with_their_numbers(tmp_path):
    folder, numbers = RunFolder(tmp_path), ("7", "8", "9")
    for number in numbers:
        folder.unit(number).path.mkdir(parents=True)
        with Journal(folder.unit(number).journal, VirtualClock()) as journal:
            journal.record("run_started", procedure="ten_minute_check", station="emulated")
            journal.record("dwell_finished", marks={"dwell": 1}, flags="", signs_tested=number == "8")
    outcome = RunOutcome(ended="stopped", units={number: RunOutcome() for number in numbers})
    printed = "\n".join(lines_of(folder, outcome))
    assert printed.count("were not tested") == 1
    assert "Units 7 and 9: Signs and axes of the signal map were not tested" in " ".join(printed.split())
    assert "Units 7 and 9: Signal map not tested." in folder.report.read_text()


def test_what_is_doubtful_in_the_results_of_one_of_several_units_is_printed(tmp_path, monkeypatch):
    monkeypatch.setattr(run_findings, "noise_sentence", lambda _, station: "Large." if station else "")
    folder = RunFolder(tmp_path)
    units = {number: RunOutcome() for number in ("7", "8")}
    for number in units:
        folder.unit(number).path.mkdir(parents=True)
        with Journal(folder.unit(number).journal, VirtualClock()) as journal:
            journal.record("run_started", procedure="ten_minute_check", station="emulated")
    folder.unit("8").station.write_text("station: of unit 8")
    assert "Unit 8: Declared noise. Large." in lines_of(folder, RunOutcome(ended="stopped", units=units))


def test_the_report_of_a_run_is_written_without_its_dwells_in_memory(tmp_path, monkeypatch):
    folder, write_report = RunFolder(tmp_path), run_report.write_report
    folder.station.write_text(find_document("stations", "emulated").read_text())
    dwells = [SimpleNamespace(row=_Row(flags=("short",)), flags=("short",))]
    row, rows_in_memory = weakref.ref(dwells[0].row), []
    outcome = RunOutcome(ended="stopped", results=RunResults(dwells=dwells))
    del dwells

    def write(folder):
        rows_in_memory.append(row())
        return write_report(folder)

    monkeypatch.setattr(run_report, "write_report", write)
    lines_of(folder, outcome)
    assert rows_in_memory == [None]


def test_a_wrong_station_file_is_corrected_in_the_run_folder_before_the_run_resumes(tmp_path):
    folder = RunFolder(tmp_path)
    outcome = RunOutcome(ended="failed", reason="wrong", is_station_wrong=True, check_dwells=[Mock()])
    lines = lines_of(folder, outcome)
    assert "\n".join(lines).count("New run") == 1
    *_, copy, reads, seal, resume, new_run = lines
    assert copy == f"Resume   correct the copy {folder.station} or the DBC file beside it:"
    assert reads.strip().startswith("resume reads no other")
    assert seal.strip() == f"gyrobench seal {tmp_path} --accept-changes"
    assert resume.strip() == f"gyrobench resume {tmp_path}"
    assert new_run.startswith("New run  correct your own station file")


def test_a_finished_run_whose_report_can_not_be_written_states_the_safe_state_and_how_to_write_it(tmp_path):
    folder, printed = RunFolder(tmp_path), io.StringIO()
    lines_of(folder, RunOutcome(ended="stopped"))
    folder.report.unlink()
    folder.report.mkdir()  # as a full disk
    safe = SafeAction("rate table stopped", SafePart.TABLE_AT_REST)
    with pytest.raises(RunFolderError, match=r"report\.html: can't be written"):
        print_end(
            Console(file=printed, width=80), folder, RunOutcome(ended="finished", safe_state=[safe]), "x.yaml"
        )
    assert printed.getvalue().splitlines()[-3:] == [
        "rate table stopped",
        "All steps are finished, and all dwells are kept.",
        f"Report   gyrobench resume {tmp_path}",
    ]


def test_a_run_folder_that_has_disappeared_is_named_and_not_made_again(tmp_path):
    folder = RunFolder(tmp_path / "renamed")
    outcome = RunOutcome(ended="failed", reason="part-00002.blf: can't be written: No such file or directory")
    with pytest.raises(RunFolderError, match="the run folder has disappeared"):
        print_end(Console(file=io.StringIO()), folder, outcome, "x.yaml")
    assert not list(tmp_path.iterdir())


def test_the_flag_that_ends_a_run_is_printed_once(tmp_path):
    text = find_document("stations", "emulated").read_text()
    (tmp_path / "mine.yaml").write_text(text.replace("inner_axis: up", "inner_axis: down"))
    done = gyrobench("run", "ten_minute_check", "--station", "mine.yaml", "--out", "run", cwd=tmp_path)
    assert done.returncode == EXIT_NOT_FINISHED
    printed = " ".join(done.stdout.split())
    assert printed.count("rate_table.inner_axis has the wrong direction") == 1
    assert "The run failed: dwell 1 contradicts the station file, see its flag above." in printed


def test_a_wrong_station_file_without_a_dwell_needs_a_new_run_only(tmp_path):
    lines = lines_of(RunFolder(tmp_path), RunOutcome(ended="failed", reason="wrong", is_station_wrong=True))
    assert "Resume" not in "\n".join(lines)
    assert lines[-1].startswith("New run  correct your own station file")
