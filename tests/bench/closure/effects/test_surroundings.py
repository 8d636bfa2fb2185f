from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.effects.surroundings import CHAMBER_STATE, SUPPLY_POWER
from gyrobench.bench.closure.loop import close_loop
from tests.bench.closure.thermal_bench import STEP_S, measure
from tests.benchmarks.closure_courses import STEP_H, lagged

STATE, HEAT = CHAMBER_STATE.forms
COLD_BELOW_C = 5.0
#: Walls four times as well coupled to the air as the room, and settling within an hour.
WALLS = (COLD_BELOW_C, 4.0, 3600.0)


@pytest.fixture(scope="module")
def of_two_cycles():
    return measure(cycles=2)


@pytest.fixture(scope="module")
def columns(of_two_cycles):
    return STATE.columns(campaign_of(of_two_cycles.rows), (COLD_BELOW_C,))


def shares(of_two_cycles, state):
    return np.array(
        [state[round(row.start_s / 60.0) : round(row.end_s / 60.0)].mean() for row in of_two_cycles.rows]
    )


def test_cooling_is_the_share_of_a_dwell_with_a_falling_set_point(of_two_cycles, columns):
    falling = np.diff(of_two_cycles.course.set_c, prepend=20.0) < 0.0
    np.testing.assert_allclose(columns[1:, 0, 0], shares(of_two_cycles, falling)[1:], atol=0.07)


def test_holding_cold_is_the_share_of_a_dwell_below_the_limit(of_two_cycles, columns):
    cold = of_two_cycles.course.set_c < COLD_BELOW_C
    np.testing.assert_allclose(columns[1:, 0, 1], shares(of_two_cycles, cold)[1:], atol=0.07)


def test_heat_is_removed_until_the_walls_have_cooled(of_two_cycles):
    set_c = of_two_cycles.course.set_c[:, None]
    walls_above_c = (lagged(set_c, WALLS[2] / 3600.0) - set_c)[:, 0]
    runs = set_c[:, 0] - WALLS[1] * walls_above_c < COLD_BELOW_C
    found = HEAT.columns(campaign_of(of_two_cycles.rows), WALLS)[:, 0, 0]
    assert np.sqrt(np.mean((found - shares(of_two_cycles, runs)) ** 2)) < 0.07
    after_a_ramp = runs & (set_c[:, 0] > COLD_BELOW_C) & (np.diff(set_c[:, 0], prepend=20.0) == 0.0)
    assert after_a_ramp.sum() * STEP_H > 0.5


def test_all_gyros_see_the_same_chamber(columns):
    np.testing.assert_array_equal(columns[:, 0], columns[:, 1])
    np.testing.assert_array_equal(columns[:, 0], columns[:, 2])


def test_a_set_point_that_only_rises_cools_nothing():
    rows = measure(profile=((60.0, 0.5, 3.0),), cycles=1).rows
    assert np.all(STATE.columns(campaign_of(rows), (COLD_BELOW_C,)) == 0.0)
    assert np.all(HEAT.columns(campaign_of(rows), WALLS) == 0.0)


def test_an_unmeasured_set_point_is_a_missing_input():
    assert (
        STATE.missing_input(campaign_of(measure(cycles=2, sensors=("air",)).rows))
        == "the chamber's set point"
    )


AT_ONCE, LAGGING = SUPPLY_POWER.forms
TAU_H = 0.1
OFF_STEPS = 10
OPTIONS = {
    "cycles": 3, "pause_s": OFF_STEPS * STEP_S, "power_on_each_cycle": True,
    "sensors": ("set", "air", "board", "supply"),
}  # fmt: skip


def lagging_w(course):
    """Power (m, 1) behind a lag that begins with zero; the last pause of each run is without power."""
    after = np.r_[course.run[OFF_STEPS:], course.run[-OFF_STEPS:]]
    power_w = np.where(after == course.run, course.supply_w, 0.0)
    return lagged(np.append(0.0, power_w)[:, None], TAU_H)[1:]


def test_the_lag_begins_with_zero_at_each_power_on_and_at_the_first_as_stated():
    measured = measure(**OPTIONS)
    campaign = campaign_of(measured.rows)
    whole_w = lagging_w(measured.course)[:, 0]
    means_w = [
        whole_w[round(row.start_s / STEP_S) : round(row.end_s / STEP_S)].mean() for row in measured.rows
    ]
    cold, warm = (LAGGING.columns(campaign, (3600.0 * TAU_H, share))[:, 0, 0] for share in (0.0, 1.0))
    first = campaign.since_power_on_s < 1.0
    assert first.sum() == OPTIONS["cycles"]
    assert np.sqrt(np.mean((cold - means_w) ** 2)) < 0.3
    # Dwells have steps of the power within, of which the form knows the mean.
    np.testing.assert_allclose(cold[first], np.array(means_w)[first], rtol=0.04)
    assert warm[0] - cold[0] > 5.0
    np.testing.assert_allclose(warm[3:], cold[3:], atol=1e-3)


def test_dwells_that_are_held_out_do_not_change_the_others():
    campaign = campaign_of(measure(**OPTIONS).rows).holding_out([2])
    other = {name: values + 9.0 * campaign.held_out for name, values in campaign.columns.items()}
    found, changed = (
        LAGGING.columns(each, (3600.0 * TAU_H, 0.0))[~campaign.held_out]
        for each in (campaign, replace(campaign, columns=other))
    )
    np.testing.assert_array_equal(found, changed)


@pytest.mark.parametrize(
    "among",
    [
        pytest.param(("supply_power", "warm_up", "thermal_lag"), id="some"),
        pytest.param((), id="all", marks=pytest.mark.long),
    ],
)
def test_a_supply_that_lags_is_no_warm_up(among):
    candidates = [each for each in all_effects() if each.name in among] or None
    closure = close_loop(campaign_of(measure({lagging_w: 3.0}, **OPTIONS).rows), effects=candidates)
    assert [each.effect.name for each in closure.effects] == ["supply_power"]
    assert closure.effects[0].candidate.form.name == "lagging"


def test_a_power_that_never_changes_shows_no_lag():
    rows = measure(**OPTIONS).rows
    assert LAGGING.missing_input(campaign_of(rows)) is None
    constant = [replace(row, other=(("supply_w", 40.0),)) for row in rows]
    assert "change of the supply's power" in LAGGING.missing_input(campaign_of(constant))
    assert AT_ONCE.missing_input(campaign_of(constant)) is None
