import itertools

import numpy as np
import pytest

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.earth import EARTH_RATE, curvature_radii
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.navigation.rotational_ins import (
    DAY_S,
    HALF_TURNS,
    NAUTICAL_MILE_M,
    SIX_POSITIONS,
    RotationScheme,
    bias_by_position,
    navigate_with_drift,
    rotate_for,
    rotate_for_each,
)
from gyrobench.bench.navigation.table_axes import TwoAxisTable
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.drivers.emulators.world.strapdown import navigate, normal_gravity

SITE = Site(np.deg2rad(36.4), 60.0)
SCHEMES = [HALF_TURNS, SIX_POSITIONS]
EAST, NORTH, UP = np.eye(3)


def drifting(direction, drift_dph=0.001, days=1):
    steps_s = np.full(days * 2880, 30.0)
    return navigate_with_drift(steps_s, np.tile(drift_dph * direction, (len(steps_s), 1)), SITE)


def constant(bias_dph):
    return lambda time_s, up_body: np.tile(bias_dph, (len(time_s), 1))


@pytest.mark.parametrize(
    ("direction", "days", "expected_nmi"),
    [(NORTH, 1, 0.95), (NORTH, 3, 2.8), (EAST, 1, 0.32), (-UP, 1, 0.69), (-UP, 3, 2.05)],
)
def test_a_drift_that_nothing_cancels_costs_what_the_error_model_of_others_says(
    direction, days, expected_nmi
):
    assert drifting(direction, days=days).max_nmi == pytest.approx(expected_nmi, rel=0.08)


@pytest.mark.parametrize("direction", [EAST, NORTH, UP])
def test_the_linear_model_agrees_with_a_full_strapdown_navigation_of_a_day(direction):
    rate = EARTH_RATE * np.array([0.0, np.cos(SITE.latitude), np.sin(SITE.latitude)])
    rate += 0.001 * DPH_TO_RADPS * direction
    force = np.array([0.0, 0.0, normal_gravity(SITE.latitude, SITE.height)])
    state = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, SITE.latitude, 0.0])
    states = navigate(state, np.tile(rate, (86400, 1)), np.tile(force, (86400, 1)), 1.0, SITE.height, 29, 30)
    meridian_m, across_m = curvature_radii(SITE.latitude, SITE.height)
    error = drifting(direction)
    limit_m = 0.01 * NAUTICAL_MILE_M
    np.testing.assert_allclose(error.north_m, meridian_m * (states[:, 6] - SITE.latitude), atol=limit_m)
    np.testing.assert_allclose(error.east_m, across_m * np.cos(SITE.latitude) * states[:, 7], atol=limit_m)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_bias_that_stays_the_same_in_the_body_is_cancelled(scheme, axis):
    bias_dph = 0.01 * np.eye(3)[axis]
    assert rotate_for(DAY_S, scheme, constant(bias_dph), SITE).max_nmi < 0.015 * drifting(NORTH, 0.01).max_nmi


@pytest.mark.parametrize(
    ("scheme", "axis", "least_nmi"),
    [(HALF_TURNS, 2, 0.6), *((SIX_POSITIONS, axis, 0.15) for axis in range(3))],
)
def test_a_bias_that_changes_sign_with_attitude_is_not_cancelled(scheme, axis, least_nmi):
    along = 0.001 * np.eye(3)[axis]
    error = rotate_for(DAY_S, scheme, lambda _, up_body: up_body * along, SITE)
    assert error.max_nmi > least_nmi


def test_what_only_the_vertical_gyro_shows_upside_down_is_a_drift_up():
    along = np.array([0.0, 0.0, 0.001])
    error = rotate_for(DAY_S, HALF_TURNS, lambda _, up_body: up_body * along, SITE)
    assert error.max_nmi == pytest.approx(drifting(UP).max_nmi, rel=0.03)


def test_biases_by_position_are_those_of_the_positions_and_weighted_between_them():
    biases = {name: np.arange(3.0) + 10.0 * number for number, name in enumerate(POSITIONS)}
    residual = bias_by_position(biases)
    for name, position in POSITIONS.items():
        np.testing.assert_allclose(residual(np.zeros(1), position.C_nb()[[2]])[0], biases[name])
    halfway = np.array([[0.0, np.sqrt(0.5), np.sqrt(0.5)]])
    np.testing.assert_allclose(residual(np.zeros(1), halfway)[0], 0.5 * (biases["y_up"] + biases["z_up"]))


def test_equal_biases_in_all_positions_count_as_one_constant_bias():
    bias_dph = [0.003, -0.002, 0.004]
    by_position = rotate_for(DAY_S, SIX_POSITIONS, bias_by_position(dict.fromkeys(POSITIONS, bias_dph)), SITE)
    expected = rotate_for(DAY_S, SIX_POSITIONS, constant(bias_dph), SITE)
    np.testing.assert_allclose(by_position.distance_nmi, expected.distance_nmi, atol=1e-9)


def test_a_scheme_asks_only_for_the_positions_that_it_passes():
    two = bias_by_position({"z_up": [0.0, 0.0, 0.001], "z_down": [0.0, 0.0, -0.001]})
    with pytest.raises(MeasurementError, match="finite"):
        rotate_for(DAY_S, SIX_POSITIONS, two, SITE)
    with pytest.raises(MeasurementError, match="no such position: up; there are z_up"):
        bias_by_position({"up": [0.0, 0.0, 0.0]})


def test_a_bias_that_changes_with_time_is_taken_as_it_goes():
    warming = rotate_for(
        DAY_S,
        HALF_TURNS,
        lambda time_s, up_body: 0.001 * up_body * (time_s > 0.5 * DAY_S)[:, np.newaxis],
        SITE,
    )
    half = warming.time_s <= 0.5 * DAY_S
    assert warming.distance_nmi[half].max() < 1e-9
    assert warming.distance_nmi[-1] > 0.1
    assert warming.distance_nmi[-1] <= warming.max_nmi


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_scheme_shows_each_axis_both_ways_for_the_same_time_and_unwinds(scheme):
    outer_deg, inner_deg = np.transpose(scheme.angles_deg())
    assert (outer_deg[-1], inner_deg[-1]) == (0.0, 0.0)
    assert np.abs([outer_deg, inner_deg]).max() <= 360.0
    gimbals = TwoAxisTable(EAST, UP, np.eye(3))
    attitudes = np.array([gimbals.attitude(*angles) for angles in scheme.angles_deg()[:-1]])
    np.testing.assert_allclose(attitudes.mean(axis=0), 0.0, atol=1e-12)
    ups = {tuple(np.rint(attitude[2]).astype(int).tolist()) for attitude in attitudes}
    assert len(ups) == (2 if scheme is HALF_TURNS else 6)


def test_the_error_covers_the_time_asked_for():
    error = rotate_for(3600.0, HALF_TURNS, constant([0.0, 0.0, 0.0]), SITE)
    assert 3600.0 <= error.time_s[-1] < 3660.0
    assert error.max_nmi == 0.0


def test_schemes_that_cannot_go_on_for_ever_are_mistakes():
    with pytest.raises(MeasurementError, match="must lead back to zero"):
        RotationScheme((("outer", 180.0),))
    assert RotationScheme((("outer", 90.0), ("outer", -90.0))).angles_deg()[1] == (90.0, 0.0)


def fig7_limits():
    return load_procedure(find_document("procedures", "six_position_fig7"))[1].acceptance


def worst_nmi(level_dph, vertical_dph):
    """Largest error in a day by each gyro, over all patterns of biases that differ at most by these."""
    worst = []
    for axis in range(3):
        patterns = [
            {
                name: np.eye(3)[axis]
                * (vertical_dph if POSITIONS[name].up_axis == axis else level_dph)
                * (sign - 0.5)
                for name, sign in zip(POSITIONS, signs, strict=True)
            }
            for signs in itertools.product((0, 1), repeat=len(POSITIONS))
        ]
        worst.append(rotate_for_each(DAY_S, SIX_POSITIONS, patterns, SITE).max_nmi)
    return worst


def test_position_differences_at_the_limits_of_fig7_cost_a_gyro_about_one_nautical_mile_in_a_day():
    limits = fig7_limits()
    found = worst_nmi(limits.position_difference_dph, limits.vertical_difference_dph)
    np.testing.assert_allclose(found, [0.53, 0.56, 1.1], rtol=0.03)


def test_a_difference_between_positions_with_the_gyro_level_costs_a_twentieth_of_one_between_up_and_down():
    np.testing.assert_allclose(worst_nmi(0.001, 0.0), [0.006, 0.008, 0.008], atol=0.0006)
    np.testing.assert_allclose(worst_nmi(0.0, 0.001), [0.085, 0.085, 0.17], atol=0.002)
