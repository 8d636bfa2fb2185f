"""Procedures run with INS that speak other frames than the shipped ones of gyrobench_ins.dbc."""

import pytest
import yaml

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.folder import RunFolder
from tests.bench.command_line import gyrobench

#: True bias of each gyro, deg/h, of the world without noise.
TRUE_DPH = [
    yaml.safe_load(find_document("worlds", "ideal").read_text())["gyro"]["bias_dph"][axis] for axis in "xyz"
]


@pytest.fixture(scope="module", params=["emulated_sbg", "emulated_canaerospace"])
def finished(request, tmp_path_factory):
    cwd = tmp_path_factory.mktemp("run")
    result = gyrobench(
        "run", "ten_minute_check", "--world", "ideal", "--station", request.param, "--out", "run", cwd=cwd
    )
    assert result.returncode == 0, result.stderr
    return request.param, RunFolder(cwd / "run"), result.stdout


def test_the_biases_are_the_true_ones_within_what_the_resolution_allows(finished):
    _, folder, _ = finished
    [row] = read_dwells(folder.dwells)
    assert row.flags == ()
    for bias_dph, true_dph, sigma_dph in zip(row.bias_dph, TRUE_DPH, row.sigma_dph, strict=True):
        assert abs(bias_dph - true_dph) < 2.0 * sigma_dph


def test_an_output_that_is_too_coarse_is_reported_before_anything_moves(finished):
    name, _, printed = finished
    assert ("too coarse" in " ".join(printed.split())) == (name == "emulated_sbg")
