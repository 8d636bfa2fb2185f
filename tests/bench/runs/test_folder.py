from pathlib import Path

import pytest

from gyrobench.bench.foundations.errors import MissingRunError, RunFolderError
from gyrobench.bench.runs.folder import PathInside, RunFolder, create_run_folder, open_run_folder


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
    with pytest.raises(RunFolderError, match="not a run folder"):
        open_run_folder(tmp_path)


def test_a_path_where_nothing_is_is_no_folder(tmp_path):
    with pytest.raises(MissingRunError, match=r"second-001: no such folder\. Give"):
        open_run_folder(tmp_path / "second-001")
    (tmp_path / "second-002").mkdir()
    with pytest.raises(MissingRunError, match=r"no such folder \(did you mean 'second-002'\?\)\. Give"):
        open_run_folder(tmp_path / "second-001")


def test_a_run_of_several_units_is_no_run_of_one(tmp_path):
    for folder in (tmp_path, tmp_path / "units" / "1101"):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "journal.jsonl").write_text("")
    with pytest.raises(MissingRunError, match=r"Give the folder of one of them: .*units/1101"):
        open_run_folder(tmp_path)


@pytest.mark.parametrize("name", ["figures", "closure/figures", "telemetry"])
def test_a_run_folder_that_leads_elsewhere_by_a_link_is_refused(tmp_path, name):
    elsewhere, run = tmp_path / "elsewhere", tmp_path / "run"
    elsewhere.mkdir()
    (run / name).parent.mkdir(parents=True, exist_ok=True)
    (run / "journal.jsonl").write_text("")
    (run / name).symlink_to(elsewhere)
    with pytest.raises(RunFolderError, match=f"run/{name}: is a link out of the run folder"):
        open_run_folder(run)


def test_a_run_folder_may_itself_be_reached_by_a_link(tmp_path):
    run = tmp_path / "run"
    (run / "figures").mkdir(parents=True)
    (run / "journal.jsonl").write_text("")
    (tmp_path / "link").symlink_to(run)
    assert open_run_folder(tmp_path / "link").path == tmp_path / "link"


def test_all_paths_in_a_folder_differ(tmp_path):
    folder = RunFolder(tmp_path)
    paths = [
        getattr(folder, name) for name, value in vars(RunFolder).items() if isinstance(value, PathInside)
    ]
    assert len(paths) == 26
    assert len(set(paths)) == len(paths)
    assert {path.parent for path in paths} == {tmp_path}


def test_a_run_that_was_cut_off_before_its_journal_began_makes_way(tmp_path):
    for name in ("procedure.yaml", "station.yaml", "ins.dbc", ".provenance.json.part", ".lock"):
        (tmp_path / name).write_text("left behind")
    assert create_run_folder(tmp_path, "run").path == tmp_path
    (tmp_path / ".lock").unlink()  # files of another origin
    with pytest.raises(RunFolderError, match="not empty"):
        create_run_folder(tmp_path, "run")
    (tmp_path / ".lock").touch()
    (tmp_path / "journal.jsonl").write_text("")
    with pytest.raises(RunFolderError, match="not empty"):
        create_run_folder(tmp_path, "run")
