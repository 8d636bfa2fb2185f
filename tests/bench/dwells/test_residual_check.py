"""What a compensation leaves, measured with and without it on the emulated bench."""

import io

import numpy as np
import pytest
from rich.console import Console

from gyrobench.bench.dwells.residual_check import check_residuals
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.monitor.terminal_view import LinesView
from gyrobench.bench.station.instruments import Emulation
from gyrobench.drivers.ins import Compensation

#: Of the world "ideal".
BIAS_DPH = np.array([0.003, -0.002, 0.004])
PROCEDURE = """procedure: residuals
steps:
  - power_on
  - repeat:
      over: {position: [z_up, z_down, y_up, y_down, x_up, x_down]}
      steps:
        - go_to: {position: $position}
        - align: {duration_s: 60}
        - navigate: {duration_s: 120}
        - turn: {angle_deg: 180}
        - navigate: {duration_s: 120}
  - repeat:
      over: {azimuth_deg: [0, 180]}
      steps:
        - go_to: {position: z_up, azimuth_deg: $azimuth_deg}
        - align: {duration_s: 60}
        - navigate: {duration_s: 200, purpose: verification}
"""


def run(path, compensation=None):
    procedure = path / "residuals.yaml"
    procedure.write_text(PROCEDURE)
    job = prepare_job(str(procedure), "emulated", Emulation("ideal", 0), compensation=compensation)
    with LinesView(Console(file=io.StringIO(), width=80), job.plan) as progress:
        _, outcome = run_job(job, path / "run", progress, ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    return [dwell.row for dwell in outcome.dwells], outcome.verifications, job.station.site


@pytest.fixture(scope="module")
def uncompensated(tmp_path_factory):
    return run(tmp_path_factory.mktemp("without"))


@pytest.fixture(scope="module")
def compensated(tmp_path_factory):
    biases = Compensation(BIAS_DPH[:, np.newaxis], np.full(3, -40.0), np.full(3, 80.0))
    return run(tmp_path_factory.mktemp("with"), biases)


def test_the_biases_of_a_unit_show_in_all_but_the_position_of_a_rotational_ins(uncompensated):
    (check,) = check_residuals(*uncompensated)
    assert (check.cycle, check.chamber_set_c) == (1, None)
    assert check.bias_rms_dph == pytest.approx(np.sqrt(np.mean(BIAS_DPH**2)), rel=0.1)
    assert check.spread_dph < 0.002
    assert check.velocity_east_mps > 0.001
    # Alike in all positions, so the rotation cancels them: alone they would cost some 5 nmi.
    assert check.day.error.max_nmi < 0.5


def test_a_compensation_leaves_less(uncompensated, compensated):
    (before,), (after,) = check_residuals(*uncompensated), check_residuals(*compensated)
    assert after.bias_rms_dph < 0.2 * before.bias_rms_dph
    assert after.velocity_east_mps < 0.5 * before.velocity_east_mps
    assert after.day.noise_nmi == pytest.approx(before.day.noise_nmi, rel=0.05)


def test_what_was_not_measured_is_left_open(uncompensated):
    rows, verifications, site = uncompensated
    (without_dwells,) = check_residuals([], verifications, site)
    assert np.isnan([without_dwells.bias_rms_dph, without_dwells.spread_dph]).all()
    assert without_dwells.day is None
    (without_navigations,) = check_residuals(rows, [], site)
    assert np.isnan(without_navigations.velocity_east_mps)
    (some_positions,) = check_residuals(rows[:1], [], site)
    assert some_positions.day is None
    assert np.isnan(some_positions.spread_dph)
    assert check_residuals([], [], site) == []
