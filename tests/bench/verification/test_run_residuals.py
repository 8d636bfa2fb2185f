"""Residual biases of a plateau, and a day of navigation with them."""

import io

import numpy as np
import pytest
from rich.console import Console

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.monitor.terminal_view import LinesView
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.navigation.rotational_ins import DAY_S, SIX_POSITIONS, bias_by_position, rotate_for
from gyrobench.bench.station.instruments import Emulation
from gyrobench.bench.verification.run_residuals import day_of_navigation
from gyrobench.drivers.ins.compensation import Compensation
from tests.bench.verification.runs_alone import check_residuals

#: Of the world "ideal".
BIAS_DPH = np.array([0.003, -0.002, 0.004])
PROCEDURE = """procedure: residuals
steps:
  - power_on: {settle_s: 20}
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
        - navigate: {duration_s: 200, purpose: calibration_check}
"""


def run(path, compensation=None):
    procedure = path / "residuals.yaml"
    procedure.write_text(PROCEDURE)
    job = prepare_job(str(procedure), "emulated", Emulation("ideal", 0), compensation=compensation)
    with LinesView(Console(file=io.StringIO(), width=80), job.plan) as progress:
        _, outcome = run_job(job, path / "run", progress, ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    return [dwell.row for dwell in outcome.dwells], outcome.check_dwells, job.station.site


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


SITE = Site(np.deg2rad(36.4), 60.0)
EQUAL = dict.fromkeys(POSITIONS, (0.003, -0.002, 0.004))


def rows_of(biases_dph, sigma_dph=0.001, flags=()):
    return [
        DwellRow(
            unit="1001",
            run="1",
            dwell=number,
            cycle=1,
            position=position,
            start_s=0.0,
            end_s=1200.0,
            since_power_on_s=3600.0,
            chamber_set_c=20.0,
            chamber_c=20.0,
            case_c=25.0,
            gyro_c=(30.0, 30.0, 30.0),
            gyro_rate_c_per_h=(0.0, 0.0, 0.0),
            board_c=(42.0, 42.0, 42.0),
            bias_dph=tuple(bias_dph),
            sigma_dph=(sigma_dph,) * 3,
            flags=flags,
        )
        for number, (position, bias_dph) in enumerate(biases_dph.items(), start=1)
    ]


def test_biases_that_are_the_same_in_all_positions_average_out():
    day = day_of_navigation(rows_of(EQUAL, sigma_dph=1e-6), SITE)
    assert day.error.max_nmi < 0.1
    assert day.noise_nmi < 0.001


def test_the_error_is_that_of_the_scheme_with_the_measured_biases():
    biases = {name: np.array([0.01, -0.005, 0.002]) * number for number, name in enumerate(POSITIONS)}
    expected = rotate_for(DAY_S, SIX_POSITIONS, bias_by_position(biases), SITE)
    day = day_of_navigation(rows_of(biases), SITE)
    np.testing.assert_array_equal(day.error.distance_nmi, expected.distance_nmi)


def test_several_dwells_in_a_position_are_averaged_and_flagged_ones_left_out():
    twice = {
        name: np.array([0.01, 0.0, 0.0]) * sign for name, sign in zip(POSITIONS, [1, -1] * 3, strict=True)
    }
    nothing = {name: -bias for name, bias in twice.items()}
    assert day_of_navigation(rows_of(twice) + rows_of(nothing), SITE).error.max_nmi == pytest.approx(
        0.0, abs=1e-9
    )
    flagged = rows_of(twice) + rows_of(nothing, flags=("the table moved",))
    alone = day_of_navigation(rows_of(twice), SITE)
    assert day_of_navigation(flagged, SITE).error.max_nmi == alone.error.max_nmi > 0.5
    assert day_of_navigation(rows_of(twice) * 4, SITE).noise_nmi == pytest.approx(0.5 * alone.noise_nmi)


def test_the_noise_is_the_rms_distance_of_many_noisy_days():
    random = np.random.default_rng(8)
    squares = []
    for _ in range(30):
        noisy = {name: random.normal(0.0, 0.001, 3) for name in POSITIONS}
        day = day_of_navigation(rows_of(noisy), SITE)
        squares.append(day.error.distance_nmi**2)
    assert np.sqrt(np.mean(squares, axis=0).max()) == pytest.approx(day.noise_nmi, rel=0.35)


def test_a_position_that_was_not_measured_is_a_mistake():
    rows = rows_of(EQUAL)
    with pytest.raises(MeasurementError, match="all six positions; no bias in y_down, z_up"):
        day_of_navigation([row for row in rows if row.position not in ("z_up", "y_down")], SITE)
