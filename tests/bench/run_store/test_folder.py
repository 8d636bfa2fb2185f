from pathlib import Path

import pytest

from bench.errors import RunFolderError
from bench.files import write_whole
from bench.run_store.folder import RunFolder, create_run_folder, open_run_folder


def test_new_folders_are_numbered_under_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert create_run_folder(None, "fig7").path == Path("runs/fig7-001")
    assert create_run_folder(None, "fig7").path == Path("runs/fig7-002")


def test_a_name_never_leads_out_of_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = create_run_folder(None, "../../etc/passwd").path
    assert folder.resolve().is_relative_to(tmp_path / "runs")


def test_a_folder_with_something_in_it_is_refused(tmp_path):
    (tmp_path / "old.txt").write_text("results")
    with pytest.raises(RunFolderError, match="not empty"):
        create_run_folder(tmp_path, "x")


def test_a_folder_without_a_journal_is_no_run_folder(tmp_path):
    with pytest.raises(RunFolderError, match="no run folder"):
        open_run_folder(tmp_path)


def test_a_file_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "table.csv"
    write_whole(path, b"old")
    with pytest.raises(RunFolderError, match="can't be written"):
        write_whole(tmp_path / "absent" / "table.csv", b"new")
    write_whole(path, b"new")
    assert path.read_bytes() == b"new"
    assert [entry.name for entry in tmp_path.iterdir()] == ["table.csv"]


def test_everything_in_a_folder_has_a_name_of_its_own(tmp_path):
    folder = RunFolder(tmp_path)
    paths = [getattr(folder, name) for name, value in vars(RunFolder).items() if isinstance(value, property)]
    assert len(set(paths)) == len(paths)
    assert {path.parent for path in paths} == {tmp_path}
