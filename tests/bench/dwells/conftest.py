"""What a finished run left, ready to be measured again."""

import shutil

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
