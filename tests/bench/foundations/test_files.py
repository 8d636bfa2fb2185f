import errno
import os
from pathlib import Path

import pytest

from gyrobench.bench.foundations.errors import DocumentError, RunFolderError, UnusablePathError
from gyrobench.bench.foundations.files import (
    defer_sync,
    file_sha256,
    make_folder,
    make_new_folder,
    parse_json,
    read_limited,
    remove,
    sync_all,
    write_error,
    write_whole,
)


def broken(*_):
    raise OSError(5, "Input/output error")


def test_a_file_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / "table.csv"
    write_whole(path, b"old")
    with pytest.raises(RunFolderError, match="can't be written"):
        write_whole(tmp_path / "absent" / "table.csv", b"new")
    write_whole(path, b"new")
    assert path.read_bytes() == b"new"
    assert [entry.name for entry in tmp_path.iterdir()] == ["table.csv"]


def test_what_is_no_plain_file_is_not_replaced_by_one(tmp_path):
    os.mkfifo(tmp_path / "pipe")  # as a device, such as /dev/null
    for path in (tmp_path / "pipe", tmp_path, Path(), Path("/")):
        with pytest.raises(UnusablePathError, match="can't be written: it is not a plain file"):
            write_whole(path, b"new")
    assert (tmp_path / "pipe").is_fifo()
    assert [entry.name for entry in tmp_path.iterdir()] == ["pipe"]


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_file_stays_as_it_was_where_the_disk_fails(tmp_path, monkeypatch, call):
    path = tmp_path / "table.csv"
    write_whole(path, b"old")
    monkeypatch.setattr(os, call, broken)
    with pytest.raises(RunFolderError, match="Input/output error"):
        write_whole(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_is_there_already_takes_no_folder(tmp_path):
    path = tmp_path / "figures"
    path.write_text("a file")
    with pytest.raises(RunFolderError, match="is a file where a folder should be"):
        make_folder(path)
    with pytest.raises(RunFolderError, match="can't be made: File exists"):
        make_folder(path / "deeper")


def test_a_folder_is_made_with_those_above_it_and_once(tmp_path):
    path = tmp_path / "a" / "b" / "c"
    assert make_new_folder(path)
    assert not make_new_folder(path)
    make_folder(path)
    assert path.is_dir()


def test_a_folder_that_cant_be_made_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "mkdir", broken)
    with pytest.raises(RunFolderError, match="can't be made: Input/output error"):
        make_folder(tmp_path / "new")


def test_removing_what_is_not_there_is_no_error(tmp_path):
    path = tmp_path / "stale.json"
    path.touch()
    remove(path)
    remove(path)
    assert not path.exists()


def test_a_file_that_cant_be_removed_is_an_error(tmp_path, monkeypatch):
    path = tmp_path / "stale.json"
    path.touch()
    monkeypatch.setattr(os, "unlink", broken)
    with pytest.raises(RunFolderError, match="can't be removed: Input/output error"):
        remove(path)


def test_what_need_not_outlive_a_power_cut_is_written_whole_without_a_wait(tmp_path, monkeypatch):
    path = tmp_path / "live.json"
    path.write_bytes(b"old")
    monkeypatch.setattr(os, "fsync", broken)
    write_whole(path, b"new", is_synced=False)
    assert path.read_bytes() == b"new"
    monkeypatch.setattr(os, "replace", broken)
    with pytest.raises(RunFolderError, match="Input/output error"):
        write_whole(path, b"newer", is_synced=False)
    assert path.read_bytes() == b"new"
    assert [entry.name for entry in tmp_path.iterdir()] == ["live.json"]


def test_files_synced_later_are_whole_and_wait_for_no_disk(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", synced.append)
    with defer_sync():
        write_whole(tmp_path / "bias_bins.csv", b"bins")
    assert (tmp_path / "bias_bins.csv").read_bytes() == b"bins"
    assert not synced
    write_whole(tmp_path / "dwells.csv", b"dwells")
    assert synced
    sync_all()


def test_the_hash_of_a_file_is_that_of_its_content(tmp_path):
    (tmp_path / "dwells.csv").write_bytes(b"abc")
    assert file_sha256(tmp_path / "dwells.csv").startswith("ba7816bf8f01cfea")
    with pytest.raises(RunFolderError, match=r"absent\.csv: can't be read"):
        file_sha256(tmp_path / "absent.csv")


def test_a_file_within_the_limit_is_read_whole(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"x" * 10)
    assert read_limited(path, 10, DocumentError) == b"x" * 10


@pytest.mark.parametrize("error_type", [DocumentError, RunFolderError])
def test_a_file_that_is_too_large_is_refused_with_its_name_and_size(tmp_path, error_type):
    path = tmp_path / "file"
    with path.open("wb") as stream:
        stream.truncate(10**12)  # holds no byte on the disk
    with pytest.raises(error_type, match=r"file: 1000000000000 bytes; at most 1000 are allowed"):
        read_limited(path, 1000, error_type)


def test_what_may_have_no_end_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for path, what in ((tmp_path / "pipe", "not a plain file"), (tmp_path, "a folder")):
        with pytest.raises(DocumentError, match=what):
            read_limited(path, 1000, DocumentError)


def test_a_character_of_two_halves_is_read():
    assert parse_json('"\\ud83d\\ude00"') == "\U0001f600"


@pytest.mark.parametrize(
    "text", ['{"a":' * 100_000, "1" * 5000, b"\xff\xfe", '"\\ud800"', b'["\\uDC00"]', "{", ""]
)
def test_what_is_no_json_is_a_value_error(text):
    with pytest.raises(ValueError):
        parse_json(text)


@pytest.mark.parametrize(
    ("number", "advice"),
    [
        (errno.ENOSPC, "Free some space"),
        (errno.EFBIG, "ulimit -f"),
        (errno.EACCES, "Check the permissions"),
        (errno.EIO, ""),
    ],
)
def test_the_advice_fits_the_cause_of_a_failed_write(tmp_path, number, advice):
    error = write_error(tmp_path, OSError(number, os.strerror(number)))
    assert os.strerror(number) in str(error)
    assert advice in str(error)
    assert ("disk" in str(error)) == (number == errno.ENOSPC)
