"""What a finished run left, ready to be measured again."""

import shutil

import pytest

from bench.measurement.marks import DwellMarks
from bench.measurement.setup import measurement_setup
from bench.run_store.can_log import read_can_log
from bench.run_store.folder import RunFolder
from bench.run_store.journal import read_journal
from bench.station.station import Station
from drivers.ins.frames import FrameBlock


@pytest.fixture
def copied_run(short_run, tmp_path):
    """A copy of the ten-minute check that a test may change."""
    folder, _, _ = short_run
    shutil.copytree(folder.path, tmp_path / "run")
    return RunFolder(tmp_path / "run")


@pytest.fixture(scope="session")
def recorded(short_run):
    """Marks and frames of the ten-minute check's dwell, and what to measure them with."""
    folder, _, _ = short_run
    (entry,) = [entry for entry in read_journal(folder.journal) if entry["event"] == "dwell_finished"]
    marks = DwellMarks.from_json(entry["marks"])
    frames = FrameBlock.from_messages(dict(read_can_log(folder.can))[marks.log_part])
    return marks, frames, measurement_setup(Station(folder.station))
