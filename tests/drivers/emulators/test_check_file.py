"""The program that checks the emulators' own files."""

import json

import pytest

from gyrobench.bench.foundations.shipped import find_document
from gyrobench.drivers.emulators.check_file import main


@pytest.mark.parametrize(
    ("kind", "folder", "name"), [("world", "worlds", "gyro_a"), ("faults", "faults", "every_kind")]
)
def test_a_right_file_is_passed_without_a_word(kind, folder, name, capsys):
    assert main(["check", kind, str(find_document(folder, name))]) == 0
    assert capsys.readouterr() == ("", "")


def test_all_mistakes_are_reported_with_exit_code_2(tmp_path, capsys):
    path = tmp_path / "f.yaml"
    path.write_text("faults:\n  - {fault: lost_reply, target: table}\n  - {fault: lost}\n")
    assert main(["check", "faults", str(path)]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(": ")[0] for line in lines] == [f"{path}:2:5", f"{path}:3:6"]


@pytest.mark.parametrize("kind", ["world", "faults"])
def test_a_schema_is_printed_as_json(kind, capsys):
    assert main(["schema", kind]) == 0
    assert json.loads(capsys.readouterr().out)["additionalProperties"] is False
