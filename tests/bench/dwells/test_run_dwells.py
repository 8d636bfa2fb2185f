"""Dwells of a run, live and from its raw log."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pytest

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.dwells.measure_dwell import measure_dwell
from gyrobench.bench.dwells.run_dwells import add_dwell
from gyrobench.bench.dwells.run_results import recompute_run
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
    with pytest.raises(RunFolderError, match=r"lacks part \d+, which dwell \d+ needs"):
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


def test_a_dwell_in_which_the_ins_never_navigated_gives_a_flagged_row(copied_run):
    (entry,) = finished_entries(copied_run)
    later_s = entry["marks"]["end_s"] + 60.0
    changes = {"dwell": 2, "log_part": 99, "windows": [], "start_s": later_s, "end_s": later_s + 60.0}
    add_to_journal(copied_run, entry | {"marks": entry["marks"] | changes})
    recompute_run(copied_run.path)
    first, second = read_dwells(copied_run.dwells)
    assert first.flags == ()
    assert second.flags == ("the INS never navigated at rest in this dwell",)


def test_of_a_dwell_finished_twice_the_last_time_counts(copied_run):
    (entry,) = finished_entries(copied_run)
    skipped = {"time_s": 0.0, "event": "dwell_skipped", "dwell": 2}
    given_up = {"time_s": 0.0, "event": "dwell_given_up", "dwell": 3, "why": "cut off"}
    again = entry | {"marks": entry["marks"] | {"disturbances": ["the second time"]}}
    add_to_journal(copied_run, skipped, given_up, again)
    recompute_run(copied_run.path)
    (row,) = read_dwells(copied_run.dwells)
    assert (row.dwell, row.flags) == (1, ("the second time",))


def test_parts_that_no_finished_dwell_needs_may_be_cut_off(copied_run):
    (entry,) = finished_entries(copied_run)
    expected = copied_run.dwells.read_bytes()
    needed = f"part-{entry['marks']['log_part']:05d}.blf"
    for path in copied_run.can.iterdir():
        if path.name != needed:
            path.write_bytes(path.read_bytes()[:300])
    recompute_run(copied_run.path)
    assert copied_run.dwells.read_bytes() == expected


@pytest.fixture(scope="module")
def measured(recorded):
    return measure_dwell(*recorded)


def test_the_navigation_of_a_long_run_is_kept_of_some_dwells_evenly_spread(measured):
    dwells = []
    for number in range(1, 1001):
        add_dwell(dwells, replace(measured, row=replace(measured.row, dwell=number)))
    kept = [index for index, each in enumerate(dwells) if each.windows]
    assert kept == list(range(0, 1000, 8))
    assert [each.row.dwell for each in dwells] == list(range(1, 1001))


def test_the_navigation_of_a_short_run_is_kept_of_all(measured):
    dwells = []
    for number in range(1, 129):
        add_dwell(dwells, replace(measured, row=replace(measured.row, dwell=number)))
    assert all(each.windows for each in dwells)


def test_a_stuck_sensor_flags_the_dwells_since_it_is_stuck_once(measured):
    dwells = []
    x, y, z = measured.row.gyro_c
    for number, moved_k in enumerate((0.0, 30.0, 60.0), start=1):
        row = replace(
            measured.row,
            dwell=number,
            gyro_c=(x, y + moved_k, z + moved_k),
            case_c=measured.row.case_c + moved_k,
            gyro_rate_c_per_h=(0.0, *measured.row.gyro_rate_c_per_h[1:]),
        )
        add_dwell(dwells, replace(measured, row=row))
    assert [str(each.flags).count("its sensor is stuck") for each in dwells] == [1, 1, 1]
    assert all(each.is_disturbed for each in dwells)
