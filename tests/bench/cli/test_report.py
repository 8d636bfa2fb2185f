"""`gyrobench report`: the report written again, with a name, as PDF, elsewhere."""

import json
import shutil

import pytest

from gyrobench.bench.bias.dwell_table import read_dwells, write_dwells
from gyrobench.bench.bias.verdicts import Acceptance, write_acceptance
from gyrobench.bench.cli.output import EXIT_INSTRUMENT, EXIT_NOT_FINISHED
from gyrobench.bench.foundations.clock import VirtualClock
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import Journal
from gyrobench.bench.runs.locks import RunLock
from tests.bench.command_line import gyrobench, output_of, refusal_of


def begun(path, **ending):
    """A run in which nothing was measured; without an ending it is unfinished."""
    folder = RunFolder(path)
    folder.path.mkdir(exist_ok=True)
    with Journal(folder.journal, VirtualClock()) as journal:
        journal.record("run_started", procedure="six_position_fig7", station="emulated")
        if ending:
            journal.record("run_ended", **ending, safe_state=[])
    return folder


@pytest.fixture
def run(tmp_path):
    """A run that ended before anything was measured."""
    folder = begun(tmp_path / "run", ended="stopped", reason="by an order")
    write_acceptance(folder.acceptance, Acceptance())
    return folder


@pytest.fixture
def unit(run):
    """The folder of a unit of that run."""
    folder = RunFolder(run.path / "units" / "7")
    folder.path.mkdir(parents=True)
    shutil.copy(run.journal, folder.journal)
    return folder


def test_the_report_is_written_again_with_the_name_and_the_verdict(run, tmp_path):
    printed = output_of("report", run.path, "--by", "A. Smith", cwd=tmp_path)
    assert "Unit not judged. The procedure has no acceptance limits." in printed
    assert f"Report   {run.report}" in printed
    assert "A. Smith" in run.report.read_text()


@pytest.mark.parametrize("ended", ["finished", "stopped", ""])
def test_a_run_that_has_not_finished_is_stated_with_how_to_resume_it(ended, tmp_path):
    folder = begun(tmp_path / "run", **({"ended": ended, "reason": ""} if ended else {}))
    text = gyrobench("report", folder.path, cwd=tmp_path).stdout
    assert (f"Resume it with: gyrobench resume {folder.path}" in text) == (ended != "finished")


def test_of_a_run_in_progress_the_report_says_so_and_its_tables_are_not_written_again(tmp_path):
    folder = begun(tmp_path / "run")
    with RunLock(folder.path, VirtualClock(), command="gyrobench run six_position_fig7"):
        text = gyrobench("report", folder.path, cwd=tmp_path).stdout
        bins = gyrobench("bins", folder.path, cwd=tmp_path)
    assert "the run is still in progress: these are its dwells so far." in text
    assert "Resume" not in text
    assert bins.returncode == EXIT_INSTRUMENT
    assert "is in use by" in bins.stderr
    assert not folder.dwells.exists()


def test_the_report_of_a_unit_of_an_unfinished_run_states_how_to_resume_the_whole_run(run, unit, tmp_path):
    text = gyrobench("report", unit.path, cwd=tmp_path).stdout
    assert f"{unit.path}: the run has not finished. Resume it with: gyrobench resume {run.path}\n" in text


def test_a_search_with_too_few_dwells_of_an_unfinished_run_states_how_to_resume_it(run, sample, tmp_path):
    write_dwells(run.dwells, read_dwells(RunFolder(sample).dwells)[:2])
    problem = refusal_of("close", run.path, cwd=tmp_path)
    assert "degrees of freedom" in problem
    assert problem.count(f"has not finished. Resume it with: gyrobench resume {run.path}") == 1


def test_a_search_of_an_unfinished_run_without_dwells_states_once_how_to_resume_it(run, tmp_path):
    problem = refusal_of("close", run.path, cwd=tmp_path)
    assert "no dwell was finished in this run" in problem
    assert problem.count("gyrobench resume") == 1


def test_a_search_of_an_unfinished_run_as_json_states_on_standard_error_how_to_resume_it(sample, tmp_path):
    run = RunFolder(tmp_path / "run")
    shutil.copytree(sample, run.path)
    run.journal.write_text("".join(run.journal.read_text().splitlines(keepends=True)[:-1]))
    done = gyrobench("close", run.path, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["folder"]
    assert f"Resume it with: gyrobench resume {run.path}" in done.stderr


def test_a_search_states_that_the_dwell_table_was_edited_since_it_was_sealed(sample, tmp_path):
    run = RunFolder(tmp_path / "run")
    shutil.copytree(sample, run.path)
    assert "has changed" not in gyrobench("close", run.path, cwd=tmp_path).stdout
    run.dwells.write_text(run.dwells.read_text().replace("z_up", "z_down", 1))
    text = gyrobench("close", run.path, cwd=tmp_path).stdout
    advice = f"Write it again with `gyrobench bins {run.path}`."
    assert f"{run.dwells}: has changed since it was sealed. {advice}" in text


def test_who_prepares_it_stays_when_it_is_written_again(run, tmp_path):
    run.provenance.write_text('{"gyrobench": "0.1.0"}')
    gyrobench("report", run.path, "--by", "A. Smith", cwd=tmp_path)
    gyrobench("report", run.path, cwd=tmp_path)
    assert "A. Smith" in run.report.read_text()


def test_a_name_for_the_report_of_an_emulated_run_is_answered_that_none_is_signed(run, tmp_path):
    text = "reports of emulated runs have no table to sign"
    assert text not in gyrobench("report", run.path, "--by", "A. Smith", cwd=tmp_path).stdout
    run.provenance.write_text('{"options": {"world": "quick"}}')
    assert text not in gyrobench("report", run.path, cwd=tmp_path).stdout
    assert text in gyrobench("report", run.path, "--by", "A. Smith", cwd=tmp_path).stdout


def test_a_pdf_stands_beside_the_page_where_it_was_asked_for(run, tmp_path):
    printed = output_of("report", run.path, "--pdf", "--out", "signed", cwd=tmp_path)
    assert "PDF      signed/report.pdf" in printed
    assert (tmp_path / "signed" / "report.pdf").read_bytes().startswith(b"%PDF-")
    assert not run.report.exists()


def test_a_pdf_in_the_run_folder_is_sealed(run, tmp_path):
    output_of("report", run.path, "--pdf", cwd=tmp_path)
    assert (run.path / "report.pdf").is_file()
    assert "Not sealed" not in output_of("seal", "--verify", run.path, cwd=tmp_path)


@pytest.mark.usefixtures("unit")
def test_a_run_of_several_units_has_a_pdf_too(run, tmp_path):
    output_of("report", run.path, "--pdf", cwd=tmp_path)
    assert (run.path / "report.pdf").read_bytes().startswith(b"%PDF-")


def test_a_run_before_a_change_is_set_beside_it(run, tmp_path):
    earlier = RunFolder(tmp_path / "earlier")
    shutil.copytree(run.path, earlier.path)
    problem = refusal_of("report", run.path, "--before", earlier.path, cwd=tmp_path)
    assert f"{earlier.path}: is the same run, or a copy of it" in problem
    earlier.journal.unlink()
    begun(earlier.path, ended="stopped", reason="by the operator")
    printed = output_of("report", run.path, "--before", earlier.path, cwd=tmp_path)
    assert "Before and after" in run.report.read_text()
    assert f"Before and after\nBefore: run {earlier.path.name}. After: this run." in printed
    assert "X gyro  after" in printed


def test_what_is_no_run_is_refused(tmp_path):
    assert "is not a run folder" in refusal_of("report", tmp_path, cwd=tmp_path)


def test_a_run_with_a_damaged_file_is_reported_with_exit_code_1_and_not_judged(run, tmp_path):
    write_acceptance(run.acceptance, Acceptance(verdict="accepted"))
    run.journal.write_text(f"xx\n{run.journal.read_text()}")
    assert output_of("report", run.path, cwd=tmp_path, code=EXIT_NOT_FINISHED).splitlines() == [
        f"{run.journal}:1: damaged entry: 'xx'. Restore the file from a copy.",
        "Unit not judged.",
        f"Report   {run.report}",
    ]


@pytest.mark.usefixtures("unit")
@pytest.mark.parametrize("options", [("--before", "run"), ("--mark-temperature", "20"), ("--out", "page")])
def test_what_is_of_one_unit_is_refused_for_a_run_of_several(options, run, tmp_path):
    problem = refusal_of("report", "run", *options, cwd=tmp_path)
    assert "Give the folder of one of them: run/units/7" in problem
    assert not run.report.exists()
