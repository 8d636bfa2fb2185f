"""Procedures run with INS that speak other frames than the shipped ones of gyrobench_ins.dbc."""

import pytest
import yaml

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.folder import RunFolder
from tests.bench.command_line import gyrobench

LONG = pytest.mark.long
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


def test_an_ins_that_sends_no_mode_is_measured(tmp_path):
    text = find_document("stations", "emulated").read_text()
    mode = "    mode: {signal: INS_STATUS.MODE, standby: 1, align: 2, navigate: 3, fault: 4}\n"
    assert mode in text
    (tmp_path / "no_mode.yaml").write_text(text.replace(mode, ""))
    options = ("--world", "ideal", "--station", "no_mode.yaml", "--out", "run")
    result = gyrobench("run", "ten_minute_check", *options, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    [row] = read_dwells(RunFolder(tmp_path / "run").dwells)
    assert row.flags == ()


@pytest.mark.parametrize(
    ("position", "declared", "fault"),
    [
        ("z_up", "w: Q3, x: Q0, y: Q1, z: Q2",
         "w is EKF_QUAT.Q3 in place of EKF_QUAT.Q0, the scalar sent first"),
        pytest.param("z_up", "w: Q1, x: Q2, y: Q3, z: Q0",
                     "w is EKF_QUAT.Q1 in place of EKF_QUAT.Q0, the scalar sent last", marks=LONG),
        pytest.param("y_up", "w: Q0, x: Q2, y: Q1, z: Q3",
                     "x and ins.signals.attitude.quaternion.y are exchanged", marks=LONG),
        pytest.param("y_up", "w: Q0, x: {signal: Q1, sign: -1}, y: Q2, z: Q3",
                     "x has the wrong sign", marks=LONG),
    ],
)  # fmt: skip
def test_a_wrong_map_of_the_quaternion_ends_the_run_and_is_named(tmp_path, position, declared, fault):
    text = find_document("stations", "emulated_sbg").read_text()
    right = "w: EKF_QUAT.Q0, x: EKF_QUAT.Q1, y: EKF_QUAT.Q2, z: EKF_QUAT.Q3"
    assert right in text
    (tmp_path / "wrong.yaml").write_text(text.replace(right, declared.replace("Q", "EKF_QUAT.Q")))
    procedure = find_document("procedures", "ten_minute_check").read_text()
    (tmp_path / "check.yaml").write_text(procedure.replace("z_up", position))
    options = ("--world", "ideal", "--station", "wrong.yaml", "--out", "run")
    result = gyrobench("run", "check.yaml", *options, cwd=tmp_path)
    assert result.returncode == 1, result.stderr
    assert f"ins.signals.attitude.quaternion.{fault}: the attitude deviates" in " ".join(
        result.stdout.split()
    )


def test_an_output_that_is_too_coarse_is_reported_before_anything_moves(finished):
    name, _, printed = finished
    assert ("too coarse" in " ".join(printed.split())) == (name == "emulated_sbg")
