"""Measuring a run again from its raw log alone gives the very same numbers."""

import dataclasses
import shutil

import numpy as np
import pytest

from bench.engine.session import measure_again
from bench.errors import RunFolderError
from bench.measurement.dwell import measure_dwell
from bench.measurement.marks import DwellMarks
from bench.measurement.setup import measurement_setup
from bench.run_store.can_log import read_can_log
from bench.run_store.folder import RunFolder
from bench.run_store.journal import read_journal
from bench.station.station import Station
from drivers.ins.frames import FrameBlock


@pytest.fixture
def copied_run(short_run, tmp_path):
    folder, _, _ = short_run
    shutil.copytree(folder.path, tmp_path / "run")
    return RunFolder(tmp_path / "run")


@pytest.mark.parametrize("world", ["ideal", "gyro_a"])
def test_the_tables_are_the_same_to_the_last_digit(shift_runs, tmp_path, world):
    folder, _ = shift_runs[world]
    shutil.copytree(folder.path, tmp_path / "run")
    copy = RunFolder(tmp_path / "run")
    for derived in (copy.dwells, copy.bias_bins):
        derived.unlink()
    shutil.rmtree(copy.telemetry)
    measure_again(copy.path)
    assert copy.dwells.read_bytes() == folder.dwells.read_bytes()
    assert copy.bias_bins.read_bytes() == folder.bias_bins.read_bytes()


def marks_and_frames(folder):
    entries = [entry for entry in read_journal(folder.journal) if entry["event"] == "dwell_finished"]
    marks = DwellMarks.from_json(entries[0]["marks"])
    return marks, FrameBlock.from_messages(dict(read_can_log(folder.can))[marks.log_part])


def test_a_dwell_whose_ins_fell_back_to_alignment_has_no_bias_and_says_why(copied_run):
    marks, frames = marks_and_frames(copied_run)
    setup = measurement_setup(Station(copied_run.station))
    early = dataclasses.replace(marks.windows[0], first_frame=0)
    row = measure_dwell(dataclasses.replace(marks, windows=(early, marks.windows[1])), frames, setup).row
    assert row.bias_dph[0] != row.bias_dph[0]
    assert "left navigation" in row.flags


def test_a_dwell_without_frames_has_no_bias_and_says_why(copied_run):
    marks, frames = marks_and_frames(copied_run)
    setup = measurement_setup(Station(copied_run.station))
    row = measure_dwell(marks, frames.take(slice(0, 0)), setup).row
    assert row.bias_dph[0] != row.bias_dph[0]
    assert "no navigation frames" in row.flags


def test_a_gap_of_some_seconds_flags_the_dwell(copied_run):
    marks, frames = marks_and_frames(copied_run)
    setup = measurement_setup(Station(copied_run.station))
    middle = (marks.windows[0].first_frame + marks.windows[0].end_frame) // 2
    gap = np.flatnonzero(frames.timestamp_s > frames.timestamp_s[middle] + 3.0)[0] - middle
    kept = np.ones(len(frames), dtype=bool)
    kept[middle : middle + gap] = False
    before = dataclasses.replace(marks.windows[0], end_frame=marks.windows[0].end_frame - gap)
    after = dataclasses.replace(
        marks.windows[1],
        first_frame=marks.windows[1].first_frame - gap,
        end_frame=marks.windows[1].end_frame - gap,
    )
    measured = measure_dwell(dataclasses.replace(marks, windows=(before, after)), frames.take(kept), setup)
    assert "nothing from the INS for 3" in measured.row.flags
    assert measured.counts.lost in (29, 30, 31)


def test_three_windows_are_not_the_papers_method(copied_run):
    marks, frames = marks_and_frames(copied_run)
    setup = measurement_setup(Station(copied_run.station))
    row = measure_dwell(
        dataclasses.replace(marks, windows=(*marks.windows, marks.windows[1])), frames, setup
    ).row
    assert "3 windows" in row.flags


def test_a_disturbed_dwell_keeps_its_flag(copied_run):
    marks, frames = marks_and_frames(copied_run)
    setup = measurement_setup(Station(copied_run.station))
    row = measure_dwell(dataclasses.replace(marks, disturbances=("door opened",)), frames, setup).row
    assert row.flags == "door opened"
    assert row.bias_dph[0] == row.bias_dph[0]


def test_marks_survive_the_journal():
    with pytest.raises(RunFolderError, match="damaged marks"):
        DwellMarks.from_json({"windows": [{"first_frame": 1}], "disturbances": []})


def test_time_stamps_that_do_not_start_at_the_epoch_or_step_back_change_nothing(copied_run):
    marks, frames = marks_and_frames(copied_run)
    setup = measurement_setup(Station(copied_run.station))
    expected = measure_dwell(marks, frames, setup).row
    since_power_up = frames.timestamp_s - frames.timestamp_s[0] + 5.0
    stepped = np.where(np.arange(len(frames)) < len(frames) // 2, since_power_up, since_power_up - 30.0)
    for stamps in (since_power_up, stepped):
        assert measure_dwell(marks, dataclasses.replace(frames, timestamp_s=stamps), setup).row == expected


def test_one_wild_velocity_flags_the_dwell(copied_run):
    marks, frames = marks_and_frames(copied_run)
    setup = measurement_setup(Station(copied_run.station))
    data = frames.data.copy()
    inside = slice(marks.windows[0].first_frame, marks.windows[0].end_frame)
    velocity_rows = np.flatnonzero(frames.arbitration_id[inside] == 0x004) + inside.start
    data[velocity_rows[100]] = 0x11
    row = measure_dwell(marks, dataclasses.replace(frames, data=data), setup).row
    assert "times the residual" in row.flags
