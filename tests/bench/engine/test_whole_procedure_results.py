"""What the shipped procedure finds in each shipped world, beside what is true in it."""

import math

import numpy as np
import pytest
from scipy.stats import chi2

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.bias.noise_estimate import compare_noise
from gyrobench.bench.bias.statistics import uniformity_p_value
from gyrobench.bench.dwells.measurement_setup import measurement_setup
from gyrobench.bench.foundations.arrays import DEG_PER_SQRT_H_TO_SI, RADPS_TO_DPH
from gyrobench.bench.runs.tables.joint_table import JOINT_BIASES_TABLE, JOINT_PLATEAUS_TABLE
from gyrobench.bench.runs.tables.noise_file import read_noise
from gyrobench.bench.station.station import Station

pytestmark = pytest.mark.long

WORLDS = ("gyro_a", "gyro_b")
#: At 25 degC; over the run it changes by less than 1 ug.
ACCELEROMETER_UG = {"x": 1.5, "y": -1.0, "z": 2.0}


def chi_square(dwell, true_bias_dph):
    error = (dwell.estimate.bias_dph - true_bias_dph) / RADPS_TO_DPH
    return error @ np.linalg.solve(dwell.estimate.covariance, error)


@pytest.mark.parametrize("world", WORLDS)
def test_errors_of_the_biases_are_as_large_as_their_uncertainties_say(watched_shift_runs, world):
    _, outcome, watcher = watched_shift_runs[world]
    squares = sum(map(chi_square, outcome.dwells, watcher.true_bias_dph))
    assert 0.001 < chi2.cdf(squares, 3 * 12) < 0.999


@pytest.mark.parametrize("world", WORLDS)
def test_fit_tests_of_all_dwells_are_as_chance_would_have_them(shift_runs, world):
    folder, _ = shift_runs[world]
    assert uniformity_p_value([row.fit_p_value for row in read_dwells(folder.dwells)]) > 0.001


def test_the_noise_of_the_run_is_that_of_the_world(shift_runs):
    folder, _ = shift_runs["gyro_a"]
    noise = read_noise(folder.noise)
    for walk in (*noise.angle_random_walks, noise.angle_random_walk):
        assert walk.value / DEG_PER_SQRT_H_TO_SI == pytest.approx(
            0.0006, abs=3.5 * walk.sigma / DEG_PER_SQRT_H_TO_SI
        )
        assert walk.sigma < 0.03 * walk.value
    declared = measurement_setup(Station(folder.station)).noise
    assert all(each.is_consistent for each in compare_noise(noise, declared))


def test_noise_that_is_not_there_is_below_the_limit_that_the_resolution_allows(shift_runs):
    folder, _ = shift_runs["ideal"]
    walk = read_noise(folder.noise).angle_random_walk
    assert walk.value is None
    assert walk.limit < 0.1 * 0.0006 * DEG_PER_SQRT_H_TO_SI


def test_vertical_gyros_that_part_are_not_taken_for_a_rate(shift_runs):
    folder, _ = shift_runs["gyro_a"]
    *stops, together = JOINT_PLATEAUS_TABLE.read(folder.joint)
    assert [row.chamber_set_c for row in stops] == [57.0, 22.0, -13.0]
    assert (together.plateau, together.finding) == (0, "different")
    assert stops[0].finding == "not_contradicted"  # above 50 degC there is nothing to part them
    assert all(math.isnan(row.corrected_dph) for row in JOINT_BIASES_TABLE.iterate(folder.joint_biases))


@pytest.mark.parametrize("world", ["ideal", "gyro_b"])
def test_no_rate_is_found_where_there_is_none(shift_runs, world):
    folder, _ = shift_runs[world]
    *stops, together = JOINT_PLATEAUS_TABLE.read(folder.joint)
    assert {row.finding for row in (*stops, together)} == {"not_contradicted"}
    assert abs(together.up_rate_dph) < 3.5 * together.up_rate_sigma_dph
    assert abs(together.latitude_error_arcmin) < 3.5 * together.latitude_error_sigma_arcmin
    assert together.latitude_error_sigma_arcmin < 0.2


@pytest.mark.parametrize("world", WORLDS)
def test_solving_together_finds_the_accelerometer_biases_of_the_world(shift_runs, world):
    folder, _ = shift_runs[world]
    for stop in JOINT_PLATEAUS_TABLE.read(folder.joint)[:-1]:
        for axis, true_ug in ACCELEROMETER_UG.items():
            found, sigma = (getattr(stop, f"accelerometer_{axis}_{what}ug") for what in ("", "sigma_"))
            assert found == pytest.approx(true_ug, abs=3.5 * sigma)
        assert stop.fit_p_value > 0.001


def test_solving_together_makes_no_bias_worse(shift_runs):
    rows = list(JOINT_BIASES_TABLE.iterate(shift_runs["gyro_a"][0].joint_biases))
    assert len(rows) == 3 * 12
    assert all(row.joint_sigma_dph < 1.0001 * row.single_sigma_dph for row in rows)


def test_biases_are_estimated_during_a_dwell_and_converge_to_the_result(watched_shift_runs):
    _, outcome, watcher = watched_shift_runs["gyro_a"]
    for dwell, received in zip(outcome.dwells, watcher.estimates, strict=True):
        assert len(received) == 9  # every 30 s of the last 300 s, but for the end
        sigmas = np.array([each.sigma_dph for each in received])
        assert (np.diff(sigmas, axis=0) < 0.0).all()
        final = dwell.estimate
        # Of nested estimates the variance of the difference is that of the variances.
        scatter_dph = np.sqrt(sigmas[-1] ** 2 - final.sigma_dph**2)
        assert (np.abs(received[-1].bias_dph - final.bias_dph) < 4.0 * scatter_dph).all()
