"""Measuring a run again from its raw log alone gives the very same numbers."""

import json
import shutil

import pytest

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.dwells.marks import DwellMarks
from gyrobench.bench.dwells.replay import recompute_run
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import read_journal

pytestmark = pytest.mark.long


@pytest.mark.parametrize("world", ["ideal", "gyro_a"])
def test_the_tables_are_the_same_to_the_last_digit(shift_runs, tmp_path, world):
    folder, _ = shift_runs[world]
    shutil.copytree(folder.path, tmp_path / "run")
    copy = RunFolder(tmp_path / "run")
    derived = ("dwells.csv", "bias_bins.csv", "joint_biases.csv", "joint.csv", "noise.json")
    for name in derived:
        (copy.path / name).unlink()
    shutil.rmtree(copy.telemetry)
    recompute_run(copy.path)
    for name in derived:
        assert (copy.path / name).read_bytes() == (folder.path / name).read_bytes()


def test_a_log_without_the_frames_of_a_dwell_is_an_error(copied_run):
    parts = sorted(copied_run.can.iterdir())
    for part in parts[1:]:
        part.unlink()
    with pytest.raises(RunFolderError, match="lacks the parts"):
        recompute_run(copied_run.path)


def finished_entries(folder):
    return [entry for entry in read_journal(folder.journal) if entry["event"] == "dwell_finished"]


def add_to_journal(folder, *entries):
    with folder.journal.open("a", encoding="utf-8") as stream:
        stream.writelines(json.dumps(entry) + "\n" for entry in entries)


def test_a_part_that_holds_fewer_frames_than_its_dwell_is_an_error(copied_run):
    (entry,) = finished_entries(copied_run)
    entry["marks"]["windows"][-1]["end_frame"] += 10**6
    add_to_journal(copied_run, entry)
    with pytest.raises(RunFolderError, match="frames, where dwell 1 needs"):
        recompute_run(copied_run.path)


def test_of_a_dwell_finished_twice_the_last_time_counts(copied_run):
    (entry,) = finished_entries(copied_run)
    skipped = {"time_s": 0.0, "event": "dwell_skipped", "dwell": 2}
    given_up = {"time_s": 0.0, "event": "dwell_given_up", "dwell": 3, "why": "cut off"}
    again = entry | {"marks": entry["marks"] | {"disturbances": ["the second time"]}}
    add_to_journal(copied_run, skipped, given_up, again)
    recompute_run(copied_run.path)
    (row,) = read_dwells(copied_run.dwells)
    assert (row.dwell, row.flags) == (1, "the second time")


def test_parts_that_no_finished_dwell_needs_may_be_cut_off(copied_run):
    (entry,) = finished_entries(copied_run)
    expected = copied_run.dwells.read_bytes()
    needed = f"part-{entry['marks']['log_part']:05d}.blf"
    for path in copied_run.can.iterdir():
        if path.name != needed:
            path.write_bytes(path.read_bytes()[:300])
    recompute_run(copied_run.path)
    assert copied_run.dwells.read_bytes() == expected


def test_marks_survive_the_journal():
    with pytest.raises(RunFolderError, match="damaged marks"):
        DwellMarks.from_json({"windows": [{"first_frame": 1}], "disturbances": []})
