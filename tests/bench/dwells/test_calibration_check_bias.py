from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gyrobench.bench.bias.bias_filter import navigation_fit
from gyrobench.bench.bias.dwell import NavigationWindow
from gyrobench.bench.bias.parameters import ErrorModel, PriorKnowledge
from gyrobench.bench.bias.statistics import uniformity_p_value
from gyrobench.bench.dwells.calibration_check import (
    AccelerometerBiases,
    bias_from_alignments,
    bias_from_velocity,
    bias_from_velocity_slope,
)
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.bias.emulated_dwells import DPH, UG, emulate, noise_model, sensors, site

NOISE = noise_model(0.0006)
# As the simulated accelerometers are, which do not drift.
PRIOR = PriorKnowledge.from_datasheet(latitude_arcmin=0.02, accelerometer_drift_ug_per_h=2.0)
BIAS_DPH, ACCELEROMETER_UG = np.array([0.012, -0.02, 0.016]), np.array([60.0, -40.0, 50.0])
KNOWN = AccelerometerBiases(ACCELEROMETER_UG * UG, np.full(3, 2.0 * UG))
UNKNOWN = AccelerometerBiases(np.zeros(3), np.full(3, PRIOR.accelerometer_bias))
ALIGN_S = 600.0
#: A tenth of what a rotational INS of 1 nmi in 24 h bears.
EXACT_DPH = 1e-4


@cache
def dwell_at(position, azimuth_deg, seed=None, **errors):
    """An alignment and a navigation straight after it; with a seed also noise."""
    noise = None if seed is None else NOISE
    random = None if seed is None else np.random.default_rng([seed, round(azimuth_deg)])
    return emulate(
        position,
        sensors(BIAS_DPH, ACCELEROMETER_UG, noise, **errors),
        noise=noise,
        random=random,
        stops_deg=(azimuth_deg,),
        align_s=ALIGN_S,
    )


def velocity(dwell, known=KNOWN):
    return bias_from_velocity(dwell, ALIGN_S, ErrorModel(site(), NOISE, PRIOR), known)


def slope(dwell, known=KNOWN):
    return bias_from_velocity_slope(dwell, ErrorModel(site(), NOISE), known)


def alignments(first, second, known=KNOWN):
    return bias_from_alignments(first, second, ALIGN_S, ErrorModel(site(), NOISE, PRIOR), known)


def error_dph(found):
    return found.bias_dph - found.direction @ BIAS_DPH


def along(found):
    """Body axis, with its sign, that a bias was found along."""
    axis = int(np.argmax(np.abs(found.direction)))
    return f"{'+' if found.direction[axis] > 0.0 else '-'}{'xyz'[axis]}"


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 180.0, 270.0])
@pytest.mark.parametrize("position", POSITIONS)
def test_velocity_after_alignment_shows_the_gyro_along_north(position, azimuth_deg):
    found = velocity(dwell_at(position, azimuth_deg))
    north = POSITIONS[position].C_nb(np.radians(azimuth_deg)).T @ [0.0, 1.0, 0.0]
    np.testing.assert_allclose(found.direction, north, atol=2e-3)
    assert abs(error_dph(found)) < EXACT_DPH


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0])
@pytest.mark.parametrize("position", POSITIONS)
def test_two_alignments_half_a_turn_apart_show_the_gyro_along_east(position, azimuth_deg):
    found = alignments(dwell_at(position, azimuth_deg), dwell_at(position, azimuth_deg + 180.0))
    east = POSITIONS[position].C_nb(np.radians(azimuth_deg)).T @ [1.0, 0.0, 0.0]
    np.testing.assert_allclose(found.direction, east, atol=1e-3)
    assert abs(error_dph(found)) < EXACT_DPH


@pytest.mark.parametrize("latitude_deg", [-45.0, 5.0, 65.0])
def test_both_ways_hold_at_other_latitudes(latitude_deg):
    ins = sensors(BIAS_DPH, ACCELEROMETER_UG)
    place = {"latitude_deg": latitude_deg, "align_s": ALIGN_S}
    first, second = (emulate("y_down", ins, stops_deg=(stop,), **place) for stop in (0.0, 180.0))
    there = site(latitude_deg)
    aligned = bias_from_alignments(first, second, ALIGN_S, ErrorModel(there, NOISE, PRIOR), KNOWN)
    navigated = bias_from_velocity(first, ALIGN_S, ErrorModel(there, NOISE, PRIOR), KNOWN)
    assert abs(error_dph(aligned)) < EXACT_DPH
    assert abs(error_dph(navigated)) < EXACT_DPH


def test_both_ways_and_four_azimuths_show_all_level_gyros_with_both_signs():
    dwells = [dwell_at("z_up", azimuth) for azimuth in (0.0, 90.0, 180.0, 270.0)]
    assert {along(velocity(dwell)) for dwell in dwells} == {"+x", "-x", "+y", "-y"}
    pairs = [(0, 2), (1, 3), (2, 0), (3, 1)]
    assert {along(alignments(dwells[i], dwells[j])) for i, j in pairs} == {"+x", "-x", "+y", "-y"}


def test_the_slope_alone_reads_the_bias_wrong_by_what_it_leaves_out():
    errors = [abs(error_dph(slope(dwell_at(position, 0.0)))) for position in POSITIONS]
    assert min(errors) > 5e-4
    assert max(errors) < 0.2 * np.abs(BIAS_DPH).max()


def test_accelerometers_that_are_not_known_pass_for_bias_and_the_uncertainty_says_so():
    first, second = dwell_at("z_up", 0.0), dwell_at("z_up", 180.0)
    for found, axis in (
        (alignments(first, second, UNKNOWN), 0),
        (velocity(first, UNKNOWN), 1),
        (slope(first, UNKNOWN), 1),
    ):
        hidden_dph = error_dph(found)
        assert hidden_dph == pytest.approx(-0.9e-3 * ACCELEROMETER_UG[axis] / 100.0, rel=0.1, abs=0.0025)
        assert found.sigma_dph == pytest.approx(9e-3, rel=0.1)
    assert alignments(first, second).sigma_dph < 1.2e-3
    assert velocity(first).sigma_dph < 1.7e-3


def test_an_accelerometer_bias_that_is_known_leaves_no_trace():
    shift_ug = np.array([500.0, -300.0, 0.0])
    ins = sensors(BIAS_DPH, ACCELEROMETER_UG + shift_ug)
    known = replace(KNOWN, bias=KNOWN.bias + shift_ug * UG)
    first, second = (emulate("z_up", ins, stops_deg=(stop,), align_s=ALIGN_S) for stop in (0.0, 180.0))
    assert abs(error_dph(alignments(first, second, known))) < EXACT_DPH
    assert abs(error_dph(velocity(first, known))) < EXACT_DPH


def test_misalignment_towards_the_vertical_is_in_the_uncertainty_of_the_alignments():
    matrix = np.zeros((3, 3))
    matrix[0, 2] = 20.0 * DPH  # 20 arcsec
    ins = sensors(BIAS_DPH, ACCELEROMETER_UG, gyro_matrix=matrix)
    first, second = (emulate("z_up", ins, stops_deg=(stop,), align_s=ALIGN_S) for stop in (0.0, 180.0))
    loose = replace(PRIOR, gyro_misalignment=20.0 * DPH)
    found = bias_from_alignments(first, second, ALIGN_S, ErrorModel(site(), NOISE, loose), KNOWN)
    assert error_dph(found) == pytest.approx(8.7e-4, rel=0.1)
    tight = alignments(first, second)
    assert found.sigma_dph**2 - tight.sigma_dph**2 == pytest.approx(8.7e-4**2, rel=0.1)


@pytest.mark.long
def test_the_uncertainties_are_those_of_the_scatter():
    pulls, fits = [], []
    for seed in range(100):
        first, second = dwell_at("x_down", 0.0, seed), dwell_at("x_down", 180.0, seed)
        found = [alignments(first, second), velocity(first), velocity(second)]
        pulls.append([error_dph(each) / each.sigma_dph for each in found])
        fits += [
            navigation_fit(each.windows[0], ErrorModel(site(), NOISE, PRIOR)).p_value
            for each in (first, second)
        ]
    # 100 alignments and 200 navigations: the chance of less or of more is below 1e-3.
    alignment_pulls, velocity_pulls = np.array(pulls)[:, 0], np.array(pulls)[:, 1:].ravel()
    assert 0.79 < np.sqrt(np.mean(alignment_pulls**2)) < 1.23
    assert 0.85 < np.sqrt(np.mean(velocity_pulls**2)) < 1.16
    assert uniformity_p_value(fits) > 1e-3


def test_the_bias_is_that_at_the_mean_temperature_of_the_navigation():
    slope_dph_per_s = 0.01 / 600.0
    ins = sensors(
        BIAS_DPH,
        gyro_bias_change=lambda time_s: np.outer(np.maximum(time_s, 0.0), [0.0, slope_dph_per_s * DPH, 0.0]),
    )
    dwell = emulate(
        "z_up",
        ins,
        stops_deg=(0.0,),
        align_s=ALIGN_S,
        gyro_c=lambda time_s: np.outer(20.0 + 10.0 * time_s / 600.0, np.ones(3)),
    )
    loose = replace(PRIOR, bias_slope=0.01 * DPH)
    flat = AccelerometerBiases(np.zeros(3), np.full(3, 2.0 * UG))
    found = bias_from_velocity(
        dwell, ALIGN_S, ErrorModel(site(), replace(NOISE, angle_random_walk=1e-9), loose), flat
    )
    assert found.bias_dph == pytest.approx(BIAS_DPH[1] + 0.005, abs=EXACT_DPH)


@pytest.mark.parametrize(("step_mps", "rows"), [(1.0, slice(200, 201)), (0.05, slice(300, None))])
def test_a_navigation_that_was_disturbed_does_not_fit(step_mps, rows):
    (window,) = dwell_at("y_up", 0.0, seed=1).windows
    velocity_mps = window.velocity_enu_mps.copy()
    velocity_mps[rows, 0] += step_mps
    disturbed = NavigationWindow(window.time_s, velocity_mps, window.C_nb)
    assert navigation_fit(window, ErrorModel(site(), NOISE, PRIOR)).p_value > 1e-3
    assert navigation_fit(disturbed, ErrorModel(site(), NOISE, PRIOR)).p_value < 1e-9


def test_alignments_that_are_not_half_a_turn_apart_determine_nothing():
    with pytest.raises(MeasurementError, match=r"z_up: two alignments .* half a turn apart"):
        alignments(dwell_at("z_up", 0.0), dwell_at("z_up", 90.0))
    with pytest.raises(MeasurementError, match="half a turn apart"):
        alignments(dwell_at("z_up", 0.0), dwell_at("y_up", 180.0))


@pytest.mark.parametrize("method", [velocity, slope])
def test_a_navigation_with_a_turn_is_no_calibration_check(method):
    with pytest.raises(MeasurementError, match="2 navigations; a calibration check has one"):
        method(emulate("z_up", window_s=60.0))
