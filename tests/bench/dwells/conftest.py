"""What a finished run left, ready to be measured again."""

import shutil

import numpy as np
import pytest

from gyrobench.bench.dwells.measurement_setup import measurement_setup
from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.bench.station.station import Station


@pytest.fixture
def copied_run(short_run, tmp_path):
    """A copy of the ten-minute check that a test may change."""
    folder, _ = short_run
    shutil.copytree(folder.path, tmp_path / "run")
    return RunFolder(tmp_path / "run")


@pytest.fixture(scope="session")
def recorded(short_run):
    """Marks and frames of the ten-minute check's dwell, and what to measure them with."""
    folder, _ = short_run
    (entry,) = [entry for entry in read_journal(folder.journal) if entry["event"] == "dwell_finished"]
    marks = DwellMarks.from_json(entry["marks"])
    frames = dict(read_can_log(folder.can))[marks.log_part].data_frames()
    return marks, frames, measurement_setup(Station(folder.station))


def with_wild_velocity(marks, frames):
    """Frames with one wild velocity in the first window, in an epoch that falls on a whole second."""
    data = frames.data.copy()
    inside = slice(marks.windows[0].first_frame, marks.windows[0].end_frame)
    velocity_rows = np.flatnonzero(frames.arbitration_id[inside] == 0x004) + inside.start
    data[velocity_rows[100]] = 0x11
    return frames.with_fields(data=data)
