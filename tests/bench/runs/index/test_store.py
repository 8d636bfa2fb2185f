"""Run folders are found wherever they lie, but not inside each other, and named in several ways."""

import pytest

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.index.run_index import RunIndex, runs_in_index
from gyrobench.bench.runs.index.selection import Selection
from gyrobench.bench.runs.index.store import find_run_folders, open_store
from tests.bench.runs.index.sample_runs import copy_run


def make_run(path):
    path.mkdir(parents=True)
    (path / "journal.jsonl").write_text("{}\n")
    return path


def test_runs_are_found_at_any_depth_in_the_order_of_their_paths(tmp_path):
    for name in ("b", "a/2", "a/1"):
        make_run(tmp_path / name)
    (tmp_path / "other").mkdir()
    assert [run.path for run in open_store(str(tmp_path)).runs()] == ["a/1", "a/2", "b"]


def test_a_run_inside_a_run_is_part_of_it(tmp_path):
    make_run(make_run(tmp_path / "run") / "verify" / "none")
    assert [run.path for run in open_store(str(tmp_path)).runs()] == ["run"]


def test_the_runs_of_an_investigation_are_found(tmp_path):
    investigation = make_run(tmp_path / "investigation")
    (investigation / "start.csv").touch()
    for name in ("campaign", "block-1/run"):
        make_run(investigation / name)
    found = [run.path for run in open_store(str(tmp_path)).runs()]
    assert found == ["investigation/block-1/run", "investigation/campaign"]


def test_the_root_may_be_the_run(tmp_path):
    run = make_run(tmp_path / "run")
    assert [each.path for each in open_store(str(run)).runs()] == ["."]


def test_a_link_that_leads_back_does_not_keep_the_search_going(tmp_path):
    make_run(tmp_path / "run")
    (tmp_path / "loop").symlink_to(tmp_path)
    assert "run" in {each.path for each in open_store(str(tmp_path)).runs()}


def test_the_fingerprint_follows_the_files_that_the_index_reads(tmp_path):
    run = make_run(tmp_path / "run")

    def fingerprint():
        return next(open_store(str(tmp_path)).runs()).fingerprint

    before = fingerprint()
    (run / "report.html").write_text("not read")
    assert fingerprint() == before
    (run / "closure").mkdir()
    (run / "closure" / "closure.json").write_text("{}")
    assert fingerprint() != before


@pytest.fixture
def root(tmp_path):
    for name in ("a", "b", "deep/c"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "journal.jsonl").write_text("{}\n")
    return tmp_path


def test_runs_are_named_by_folder_root_and_pattern_each_once(root, monkeypatch):
    every = [root / "a", root / "b", root / "deep" / "c"]
    assert find_run_folders([str(root)]) == every
    assert find_run_folders([str(root / "b"), str(root)]) == [root / "b", root / "a", root / "deep" / "c"]
    assert find_run_folders([str(root / "[ab]")]) == every[:2]
    monkeypatch.chdir(root)
    assert find_run_folders(["d*"]) == every[2:]


def test_a_name_without_run_is_reported(root):
    (root / "empty").mkdir()
    for name in ("nothing", "no*", "empty"):
        with pytest.raises(RunFolderError, match="no run folder found"):
            find_run_folders([str(root / name)])


def test_runs_are_chosen_from_an_index(sample, tmp_path):
    copy_run(sample, tmp_path / "a", "1001")
    copy_run(sample, tmp_path / "b", "1002")
    index = RunIndex(open_store(str(tmp_path)))
    index.update()
    assert runs_in_index(str(tmp_path), index, Selection(unit="1002")) == [tmp_path / "b"]
    with pytest.raises(RunFolderError, match="no run matches the selection"):
        runs_in_index(str(tmp_path), index, Selection(unit="1003"))
    with pytest.raises(RunFolderError, match="can't be changed"):
        runs_in_index("memory://bucket", index, Selection())
