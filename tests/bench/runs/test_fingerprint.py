"""Where a file was changed, found without a copy of it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.fingerprint import find_change, fingerprint_of


@given(
    content=st.binary(min_size=1, max_size=20_000),
    suffix=st.sampled_from([".blf", ".csv", ".jsonl"]),
    where=st.floats(0.0, 1.0, exclude_max=True),
    difference=st.integers(1, 255),
)
def test_one_changed_byte_is_found_with_its_former_value(tmp_path, content, suffix, where, difference):
    path = tmp_path / f"file{suffix}"
    path.write_bytes(content)
    fingerprint = fingerprint_of(path)
    assert find_change(path, fingerprint) is None
    at = int(where * len(content))
    changed = bytearray(content)
    changed[at] = (changed[at] + difference) % 256
    path.write_bytes(changed)
    change = find_change(path, fingerprint)
    assert (change.start, change.end) == (at, at + 1)
    assert f"byte {at} is 0x{changed[at]:02x} and was 0x{content[at]:02x}" in change.text


@given(content=st.binary(min_size=2, max_size=20_000), data=st.data())
def test_the_range_of_several_changes_holds_the_first(tmp_path, content, data):
    path = tmp_path / "part.blf"
    path.write_bytes(content)
    fingerprint = fingerprint_of(path)
    at = data.draw(st.integers(0, len(content) - 1))
    path.write_bytes(content[:at] + data.draw(st.binary(max_size=50)) + content[at:][::-1])
    changed = path.read_bytes()
    change = find_change(path, fingerprint)
    if changed == content:
        assert change is None
        return
    pairs = enumerate(zip(changed, content, strict=False))
    first = next((i for i, (now, was) in pairs if now != was), min(len(changed), len(content)))
    assert change.start <= first <= change.end


@pytest.mark.parametrize(
    ("name", "content", "at", "expected"),
    [
        ("t.csv", b'a,b,c\n1,"x,y",3\n4,5,6\n', 14, "line 2, column c"),
        ("t.csv", b"a,b,c\n1,2,3\n4,5,6\n", 14, "line 3, column b"),
        ("t.csv", b"a,b,c\r\n1,2\r,3\r\n", 12, "line 2, column c"),
        ("j.jsonl", b'{"event": "held"}\n{"event": "note", "t": 1}\n', 40, "line 2 (event note)"),
        ("p.yaml", b"a: 1\nb: 2\n", 8, "line 2"),
    ],
)
def test_a_change_of_text_is_named_with_line_and_cell(tmp_path, name, content, at, expected):
    path = tmp_path / name
    path.write_bytes(content)
    fingerprint = fingerprint_of(path)
    path.write_bytes(content[:at] + b"9" + content[at + 1 :])
    change = find_change(path, fingerprint)
    assert change.start == at
    assert change.text.endswith(f", in {expected}")


def test_bytes_cut_off_or_added_at_the_end_are_named(tmp_path):
    path = tmp_path / "part.blf"
    path.write_bytes(b"x" * 5000)
    fingerprint = fingerprint_of(path)
    path.write_bytes(b"x" * 5007)
    assert find_change(path, fingerprint).text == "bytes were added after byte 5000"
    path.write_bytes(b"x" * 4500)
    assert find_change(path, fingerprint).text.startswith("cut off at byte 4500")


def test_a_damaged_fingerprint_is_an_error(tmp_path):
    path = tmp_path / "part.blf"
    path.write_bytes(b"x")
    with pytest.raises(RunFolderError, match="fingerprint is damaged"):
        find_change(path, "not base 85 of a compressed table")
