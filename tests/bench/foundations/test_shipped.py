"""Shipped files by name."""

import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document


def test_the_old_name_of_a_shipped_file_is_accepted_with_a_note(caplog):
    assert find_document("procedures", "verification") == find_document("procedures", "calibration_check")
    assert "verification: this procedure is called calibration_check" in caplog.text


def test_the_name_of_a_shipped_file_of_another_kind_is_named_with_what_to_write():
    with pytest.raises(DocumentError, match="emulated: no such file or shipped name, but a shipped station"):
        find_document("procedures", "emulated")
    with pytest.raises(DocumentError, match=r"a shipped procedure\. Run it with: gyrobench run warm_up"):
        find_document("stations", "warm_up")
    with pytest.raises(
        DocumentError, match=r"a shipped station\. Give it with --station, as in: gyrobench run"
    ):
        find_document("worlds", "example_bench")
    with pytest.raises(DocumentError, match=r"warmup: .*did you mean 'warm_up'"):
        find_document("procedures", "warmup")


def test_the_file_that_was_meant_is_named(tmp_path, monkeypatch):
    (tmp_path / "mine.yaml").touch()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DocumentError, match=r"^mine: not a shipped name\. Give the file as mine\.yaml$"):
        find_document("procedures", "mine")
    with pytest.raises(
        DocumentError, match=r"^mien\.yaml: there is no such file \(did you mean 'mine\.yaml'\?\)$"
    ):
        find_document("procedures", "mien.yaml")


def test_a_run_folder_in_place_of_a_file_is_named_with_the_commands_that_take_it(tmp_path, monkeypatch):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/journal.jsonl").touch()
    monkeypatch.chdir(tmp_path)
    for name in ("mine", "./mine", str(tmp_path / "mine")):
        with pytest.raises(DocumentError, match=r"is a run folder\. Give it to report, close"):
            find_document("procedures", name)
