import os

import pytest

from gyrobench.bench.foundations.errors import DocumentError, RunFolderError
from gyrobench.bench.foundations.reading import parse_json, read_limited


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
    for path, what in ((tmp_path / "pipe", "no plain file"), (tmp_path, "a directory")):
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
