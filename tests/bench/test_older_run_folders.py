"""Run folders of version 0.1.0 stay readable: resume, bins, report, close and the Python interface."""

import json
import tarfile
from pathlib import Path

import numpy as np
import pytest

import gyrobench
from gyrobench.bench.bias.dwell_table import read_dwells
from tests.bench.command_line import gyrobench as command

FOLDERS = Path(__file__).parents[1] / "data" / "run_folders"


@pytest.fixture
def unpacked(tmp_path):
    def unpack(name):
        with tarfile.open(FOLDERS / f"{name}.tar.xz") as archive:
            archive.extractall(tmp_path, filter="data")
        return tmp_path / name

    return unpack


@pytest.mark.long
def test_an_interrupted_run_is_resumed_and_keeps_its_finished_dwells(unpacked):
    folder = unpacked("interrupted")
    before = read_dwells(folder / "dwells.csv")
    looked = command("resume", folder, "--look", cwd=folder.parent)
    assert looked.returncode == 0, looked.stderr
    assert f"{len(before)} of 72 dwells are finished" in looked.stdout
    resumed = command("resume", folder, "--view", "lines", cwd=folder.parent)
    assert resumed.returncode == 0, resumed.stderr
    after = read_dwells(folder / "dwells.csv")
    assert len(after) == 72
    for new, old in zip(after, before, strict=False):
        assert (new.dwell, new.start_s, new.end_s, new.flags) == (
            old.dwell,
            old.start_s,
            old.end_s,
            old.flags,
        )
        change_dph = np.abs(np.array(new.bias_dph) - old.bias_dph)
        vertical = "xyz".index(new.position[0])
        assert np.delete(change_dph / old.sigma_dph, vertical).max() < 0.1
        # The station's file states no uncertainty of the latitude, and its default was 0.02 arcmin in 0.1.0:
        # without that knowledge a vertical bias may change by the root of what its variance grew by.
        assert change_dph[vertical] ** 2 < new.sigma_dph[vertical] ** 2 - old.sigma_dph[vertical] ** 2
    measured_again = command("bins", folder, cwd=folder.parent)
    assert measured_again.returncode == 0, measured_again.stderr
    assert [row.bias_dph for row in read_dwells(folder / "dwells.csv")] == [row.bias_dph for row in after]


def test_a_campaign_is_reported_closed_and_read_from_python(unpacked):
    folder = unpacked("campaign")
    found = json.loads((folder / "closure" / "closure.json").read_text())
    dwells = (folder / "dwells.csv").read_bytes()
    assert command("report", folder, cwd=folder.parent).returncode == 0
    assert (folder / "report.html").exists()
    closed = command("close", folder, cwd=folder.parent)
    assert closed.returncode == 0, closed.stderr
    again = json.loads((folder / "closure" / "closure.json").read_text())
    assert again["verdict"] == found["verdict"]
    # The last digits of linear algebra depend on the processor.
    for key in ("noise_dph", "error_before_dph", "error_after_dph", "lack_of_fit_p_before"):
        assert again[key] == pytest.approx(found[key], rel=1e-9)
    assert (folder / "dwells.csv").read_bytes() == dwells
    run = gyrobench.open_run(folder)
    assert len(run.dwells) == 72
    assert run.bias_bins["bias_dph"].notna().any()
