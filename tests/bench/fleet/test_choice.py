"""Runs may be named in several ways."""

import pytest

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.index.run_index import RunIndex, runs_in_index
from gyrobench.bench.runs.index.selection import Selection
from gyrobench.bench.runs.index.store import find_run_folders, open_store
from tests.bench.runs.index.sample_runs import copy_run


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
