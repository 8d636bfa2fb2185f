import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.surroundings import CHAMBER_STATE
from tests.bench.closure.thermal_bench import measure
from tests.benchmarks.closure_courses import STEP_H, lagged

FORM, HEAT = CHAMBER_STATE.forms
COLD_BELOW_C = 5.0
#: Walls four times as well coupled to the air as the room, and settling within an hour.
WALLS = (COLD_BELOW_C, 4.0, 3600.0)


@pytest.fixture(scope="module")
def measured():
    return measure(cycles=2)


@pytest.fixture(scope="module")
def columns(measured):
    return FORM.columns(campaign_of(measured.rows), (COLD_BELOW_C,))


def shares(measured, state):
    return np.array(
        [state[round(row.start_s / 60.0) : round(row.end_s / 60.0)].mean() for row in measured.rows]
    )


def test_cooling_is_the_share_of_a_dwell_with_a_falling_set_point(measured, columns):
    falling = np.diff(measured.course.set_c, prepend=20.0) < 0.0
    np.testing.assert_allclose(columns[1:, 0, 0], shares(measured, falling)[1:], atol=0.07)


def test_holding_cold_is_the_share_of_a_dwell_below_the_limit(measured, columns):
    cold = measured.course.set_c < COLD_BELOW_C
    np.testing.assert_allclose(columns[1:, 0, 1], shares(measured, cold)[1:], atol=0.07)


def test_heat_is_removed_until_the_walls_have_cooled(measured):
    set_c = measured.course.set_c[:, None]
    walls_above_c = (lagged(set_c, WALLS[2] / 3600.0) - set_c)[:, 0]
    runs = set_c[:, 0] - WALLS[1] * walls_above_c < COLD_BELOW_C
    found = HEAT.columns(campaign_of(measured.rows), WALLS)[:, 0, 0]
    assert np.sqrt(np.mean((found - shares(measured, runs)) ** 2)) < 0.07
    after_a_ramp = runs & (set_c[:, 0] > COLD_BELOW_C) & (np.diff(set_c[:, 0], prepend=20.0) == 0.0)
    assert after_a_ramp.sum() * STEP_H > 0.5


def test_all_gyros_see_the_same(columns):
    np.testing.assert_array_equal(columns[:, 0], columns[:, 1])
    np.testing.assert_array_equal(columns[:, 0], columns[:, 2])


def test_a_set_point_that_only_rises_cools_nothing():
    rows = measure(profile=((60.0, 0.5, 3.0),), cycles=1).rows
    assert np.all(FORM.columns(campaign_of(rows), (COLD_BELOW_C,)) == 0.0)
    assert np.all(HEAT.columns(campaign_of(rows), WALLS) == 0.0)


def test_an_unmeasured_set_point_is_a_missing_input():
    assert (
        FORM.missing_input(campaign_of(measure(cycles=2, sensors=("air",)).rows)) == "the chamber's set point"
    )
