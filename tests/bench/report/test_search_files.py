"""Files of a search: beside a table, in a run, or in a separate folder."""

import json
import shutil
from dataclasses import replace

import pytest

from gyrobench.bench.bias.dwell_table import write_dwells
from gyrobench.bench.closure.campaign import Table
from gyrobench.bench.report.closure_page import write_search
from gyrobench.bench.report.page import read_findings_file
from gyrobench.bench.runs.folder import RunFolder
from tests.bench.report.made_up_closure import clean, made_up_rows

FILES = {"closure.html", "closure.json", "findings.json", "predictions.csv", "model.yaml", "figures"}


@pytest.fixture
def run(short_run, tmp_path):
    shutil.copytree(short_run[0].path, tmp_path / "run")
    return RunFolder(tmp_path / "run")


def names(folder):
    return {path.name for path in folder.iterdir()}


@pytest.mark.draws
def test_a_search_in_an_emulated_run_stands_in_its_folder_and_report_marked_in_page_figures_and_files(
    run, tmp_path
):
    page, report = write_search(clean(), [run.path])
    assert (page, report) == (run.closure / "closure.html", run.report)
    assert names(run.closure) == FILES
    assert "Search for effects" in run.report.read_text()
    assert 'data-word="SIMULATED"' in page.read_text()
    assert read_findings_file(run.closure).watermark == "SIMULATED"
    plain, _ = write_search(clean(), [run.path], tmp_path / "a" / "b")  # says nothing of where it is from
    assert "SIMULATED" not in plain.read_text()
    one, other = ((each.parent / "figures" / "residuals_x.png").read_bytes() for each in (page, plain))
    assert one != other


def test_a_search_elsewhere_keeps_the_mark_of_the_runs_it_was_read_from(run, tmp_path):
    read = replace(clean(), campaign=replace(clean().campaign, tables=(Table(str(run.path), (1, 2)),)))
    page, _ = write_search(read, [run.path], tmp_path / "found")
    assert 'data-word="SIMULATED"' in page.read_text()
    assert json.loads((page.parent / "closure.json").read_text())["simulated"] is True


def test_a_search_that_is_written_elsewhere_leaves_the_run_as_it_is(run, tmp_path):
    before = {path: path.read_bytes() for path in run.path.rglob("*") if path.is_file()}
    page, report = write_search(clean(), [run.path], tmp_path / "found")
    assert (page, report) == (tmp_path / "found" / "closure.html", None)
    assert {path: path.read_bytes() for path in run.path.rglob("*") if path.is_file()} == before


def test_a_search_in_a_table_stands_beside_it(tmp_path):
    write_dwells(tmp_path / "dwells.csv", made_up_rows())
    page, report = write_search(clean(), [tmp_path / "dwells.csv"])
    assert (page.parent, report) == (tmp_path / "closure", None)
    assert names(tmp_path / "closure") == FILES
