"""A calibration and its verification, in one run and from run to run, over bytes and frames."""

import io
import shutil
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.bias.joint_solution import solve_jointly
from gyrobench.bench.dwells.run_results import recompute_run
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.monitor.terminal_view import LinesView
from gyrobench.bench.navigation.positions import AXES
from gyrobench.bench.report.run_report import write_report
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.tables.calibration_check_table import CALIBRATION_CHECK_TABLE
from gyrobench.bench.station.instruments import Emulation

#: Of the world "ideal".
BIAS_DPH = (0.003, -0.002, 0.004)

POSITIONS = """procedure: short_verification
steps:
  - power_on: {settle_s: 20}
  - repeat:
      over: {position: [z_up, y_up]}
      steps:
"""
CALIBRATION = """
        - go_to: {position: $position}
        - align: {duration_s: 120}
        - navigate: {duration_s: 100}
        - turn: {angle_deg: 180}
        - navigate: {duration_s: 100}
"""
VERIFICATION = """
        - repeat:
            over: {azimuth_deg: [0, 180]}
            steps:
              - go_to: {position: $position, azimuth_deg: $azimuth_deg}
              - align: {duration_s: 180}
              - navigate: {duration_s: 300, purpose: calibration_check}
"""


def run(path, dwells, calibration=None):
    """Run these dwells in two positions; without a chamber the unit warms up all the time."""
    procedure = path / "procedure.yaml"
    procedure.write_text(POSITIONS + dwells)
    job = prepare_job(str(procedure), "emulated", Emulation("ideal", 0), calibration)
    with LinesView(Console(file=io.StringIO(), width=80), job.plan) as progress:
        folder, outcome = run_job(job, path / "run", progress, ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    return folder, outcome


@pytest.fixture(scope="module")
def one_run(tmp_path_factory):
    """Calibration before and after the verification, so that its temperatures lie between theirs."""
    return run(tmp_path_factory.mktemp("one"), CALIBRATION + VERIFICATION + CALIBRATION)


@pytest.fixture(scope="module")
def later_run(tmp_path_factory, one_run):
    """A verification by itself, held against the calibration of the other run."""
    return run(tmp_path_factory.mktemp("later"), VERIFICATION, calibration=one_run[0].path)


def test_each_position_shows_the_gyros_that_point_east_and_north(one_run):
    _, outcome = one_run
    assert [(row.position, row.gyro, row.method) for row in outcome.results.calibration_check] == [
        ("z_up", "x", "alignment"),
        ("z_up", "y", "velocity"),
        ("z_up", "y", "velocity"),
        ("y_up", "x", "alignment"),
        ("y_up", "z", "velocity"),
        ("y_up", "z", "velocity"),
    ]


def test_without_noise_the_biases_are_those_of_the_world_and_of_the_calibration(one_run):
    for row in one_run[1].results.calibration_check:
        truth_dph = BIAS_DPH[AXES.index(row.gyro)]
        assert row.flags == ()
        assert row.bias_dph == pytest.approx(truth_dph, abs=2e-4)
        # The windows of the calibration are short: what the output resolves shows.
        assert row.calibrated_dph == pytest.approx(truth_dph, abs=5e-4)
        assert abs(row.accelerometer_ug) < 3.0
        assert row.accelerometer_sigma_ug < 20.0
        assert row.p_value > 0.8


def test_dwells_of_the_verification_are_no_calibration(one_run):
    folder, outcome = one_run
    assert [row.dwell for row in read_dwells(folder.dwells)] == [1, 4, 5, 8]
    assert len(outcome.check_dwells) == 4
    finished = [entry for entry in read_journal(folder.journal) if entry["event"] == "dwell_finished"]
    assert [entry["marks"]["is_verification"] for entry in finished] == [False, True, True, False] * 2
    assert {entry["flags"] for entry in finished} == {""}


def test_the_temperatures_are_those_of_each_part(one_run):
    check_dwells = one_run[1].check_dwells
    for each in check_dwells:
        assert all(np.less(each.alignment_c, each.temperatures.gyro_c))  # the unit warms up
        assert 180.0 <= each.marks.align_s < 185.0
    alignment = one_run[1].results.calibration_check[0]
    first_c, second_c = (each.alignment_c[0] for each in check_dwells[:2])
    assert first_c < alignment.temperature_c < second_c


def test_the_table_holds_what_was_found(one_run):
    folder, outcome = one_run
    rows = CALIBRATION_CHECK_TABLE.read(folder.calibration_check)
    assert [row.dwell for row in rows] == [row.dwell for row in outcome.results.calibration_check]
    for read, found in zip(rows, outcome.results.calibration_check, strict=True):
        assert read.bias_dph == pytest.approx(found.bias_dph)
        assert read.p_value == pytest.approx(found.p_value)


@pytest.mark.parametrize("name", ["one_run", "later_run"])
def test_measured_again_from_the_log_the_table_is_the_same_to_the_last_digit(request, tmp_path, name):
    folder, _ = request.getfixturevalue(name)
    shutil.copytree(folder.path, tmp_path / "run")
    copy = RunFolder(tmp_path / "run")
    copy.calibration_check.unlink()
    recompute_run(copy.path)
    assert copy.calibration_check.read_bytes() == folder.calibration_check.read_bytes()


def test_gyro_errors_larger_than_declared_count_in_the_comparison(one_run, tmp_path, monkeypatch):
    def solve(*arguments):
        return replace(solve_jointly(*arguments), gyro_error_factor=30.0)

    folder = RunFolder(tmp_path / "run")
    shutil.copytree(one_run[0].path, folder.path)
    monkeypatch.setattr("gyrobench.bench.dwells.run_results.solve_jointly", solve)
    recompute_run(folder.path)
    rows = CALIBRATION_CHECK_TABLE.read(folder.calibration_check)
    for wide, declared in zip(rows, one_run[1].results.calibration_check, strict=True):
        assert wide.bias_dph == pytest.approx(declared.bias_dph)
        assert wide.sigma_dph > 1.4 * declared.sigma_dph
        assert wide.calibrated_sigma_dph > declared.calibrated_sigma_dph
    # The turn of the calibration acts on the gyros in Y-Up.
    assert rows[3].calibrated_sigma_dph > 2.0 * one_run[1].results.calibration_check[3].calibrated_sigma_dph


def test_a_later_run_is_held_against_the_calibration_of_an_earlier_one(one_run, later_run):
    _, outcome = later_run
    assert outcome.dwells == []
    rows = outcome.results.calibration_check
    assert [row.flags for row in rows] == [()] * 6
    calibrated = [row for row in rows if row.is_compared]
    # The later run is as warm as the earlier one was at its beginning.
    assert {row.position for row in calibrated} >= {"z_up"}
    for row in calibrated:
        assert row.difference_dph == pytest.approx(0.0, abs=5e-4)
        assert row.accelerometer_sigma_ug < 50.0


def test_the_report_has_the_calibration_check(later_run):
    folder, _ = later_run
    text = write_report(folder).path.read_text(encoding="utf-8")
    assert "Calibration check" in text
    assert "agree with the calibration" in text


def test_a_calibration_that_is_none_is_refused_before_anything_moves(tmp_path):
    with pytest.raises(DocumentError, match=r"is not a calibration"):
        run(tmp_path, VERIFICATION, calibration=tmp_path)
    assert not (tmp_path / "run").exists()
