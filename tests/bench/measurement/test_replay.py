"""Measuring a run again from its raw log alone gives the very same numbers."""

import shutil

import pytest

from bench.engine.session import measure_again
from bench.errors import RunFolderError
from bench.measurement.marks import DwellMarks
from bench.run_store.folder import RunFolder


@pytest.mark.parametrize("world", ["ideal", "gyro_a"])
def test_the_tables_are_the_same_to_the_last_digit(shift_runs, tmp_path, world):
    folder, _ = shift_runs[world]
    shutil.copytree(folder.path, tmp_path / "run")
    copy = RunFolder(tmp_path / "run")
    derived = ("dwells.csv", "bias_bins.csv", "joint_biases.csv", "joint.csv", "noise.json")
    for name in derived:
        (copy.path / name).unlink()
    shutil.rmtree(copy.telemetry)
    measure_again(copy.path)
    for name in derived:
        assert (copy.path / name).read_bytes() == (folder.path / name).read_bytes()


def test_a_log_without_the_frames_of_a_dwell_is_an_error(copied_run):
    parts = sorted(copied_run.can.iterdir())
    for part in parts[1:]:
        part.unlink()
    with pytest.raises(RunFolderError, match="lacks the parts"):
        measure_again(copied_run.path)


def test_marks_survive_the_journal():
    with pytest.raises(RunFolderError, match="damaged marks"):
        DwellMarks.from_json({"windows": [{"first_frame": 1}], "disturbances": []})
