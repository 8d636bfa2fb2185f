"""What a plan would decide of the ties of a closure: simulated campaigns stand for plans."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects.laws import (
    G_SENSITIVITY,
    TEMPERATURE_RATE,
    THERMAL_GRADIENT,
    TIME_DRIFT,
    WARM_UP,
)
from gyrobench.bench.closure.effects.surroundings import MAGNETIC_SENSITIVITY
from gyrobench.bench.closure.loop import close_loop
from gyrobench.bench.closure.posterior import TIE_ODDS
from gyrobench.bench.closure.separability import searched_dwells, separability
from gyrobench.bench.closure.tie_forecast import measured_properties, tie_forecasts
from gyrobench.bench.procedure.estimate import ThermalEstimate
from tests.bench.closure.thermal_bench import measure


def slow_warm_up(course):
    return np.exp(-course.since_power_on_h / 12.0)[:, np.newaxis]


#: Campaigns that leave a tie: effects hidden, sensors, candidates.
TIES = {
    "one power-on": ({slow_warm_up: 2.5}, ("set",), (TIME_DRIFT, WARM_UP)),
    "one heading": ({"g_sensitivity": 1.5}, ("set",), (G_SENSITIVITY, MAGNETIC_SENSITIVITY)),
    "no sensor at the electronics": (
        {"temperature_rate": 2.0},
        ("set",),
        (TEMPERATURE_RATE, THERMAL_GRADIENT),
    ),
}


@cache
def closed(name):
    effects, sensors, candidates = TIES[name]
    rows = measure(effects, cycles=2, sensors=sensors).rows
    return close_loop(campaign_of(rows), effects=candidates)


def plan(cycles=2, sensors=("set",), **options):
    return campaign_of(measure(cycles=cycles, sensors=sensors, seed=9, **options).rows)


@pytest.mark.parametrize("name", TIES)
def test_the_same_procedure_again_leaves_by_itself_the_tie_that_the_closure_found(name):
    closure = closed(name)
    assert closure.verdict == "ambiguous"
    ties = {(each.effect.name, other) for each in closure.effects for other in each.tied_with}
    forecasts = tie_forecasts(closure, plan())
    assert {(each.found, each.other) for each in forecasts} == ties
    for each in forecasts:
        assert 1.0 / TIE_ODDS < each.now < TIE_ODDS
        assert each.missing_input or each.plan_only < TIE_ODDS
        assert not each.missing_input or not each.is_settled


def test_the_power_cycle_of_a_held_out_cycle_alone_has_no_dwells():
    effects, sensors, candidates = TIES["one heading"]
    rows = measure(effects, cycles=2, sensors=sensors, power_on_each_cycle=True).rows
    closure = close_loop(campaign_of(rows), effects=candidates)
    ties = {(each.effect.name, other) for each in closure.effects for other in each.tied_with}
    assert {(each.found, each.other) for each in tie_forecasts(closure, plan())} == ties != set()


def test_separability_sees_an_effect_that_takes_the_place_of_another_for_lack_of_an_input():
    closure = closed("one heading")
    seen = separability(searched_dwells(plan()), [each.effect for each in closure.evidence], closure.effects)
    assert ("g_sensitivity", "magnetic_sensitivity") in seen.not_distinguished(0.002)
    assert seen.expected_dph["g_sensitivity"] == pytest.approx(closure.effects[0].rms_dph, rel=0.2)
    boards = separability(
        searched_dwells(plan(sensors=("set", "board"))), TIES["no sensor at the electronics"][2]
    )
    assert np.isfinite(boards.distinguished_dph["temperature_rate", "thermal_gradient"])


def test_an_effect_found_is_assumed_with_the_parameters_found():
    """A warm-up of 12 h is harder to distinguish from a drift than one of the typical two."""
    closure = closed("one power-on")
    effects = [each.effect for each in closure.evidence]
    usual, found = (
        separability(searched_dwells(plan()), effects, each).distinguished_dph["warm_up", "time_drift"]
        for each in ((), closure.effects)
    )
    assert found > 1.5 * usual


def test_another_power_on_with_the_dwells_so_far_settles_warm_up_against_drift():
    [forecast] = tie_forecasts(closed("one power-on"), plan())
    assert forecast.is_settled
    assert min(forecast.if_found, forecast.if_other) > 1e4


def test_sensors_settle_what_their_lack_left_tied():
    [forecast] = tie_forecasts(closed("no sensor at the electronics"), plan(sensors=("set", "board")))
    assert forecast.missing_input is None
    assert forecast.if_found > TIE_ODDS
    assert forecast.is_settled


def test_the_noise_is_that_of_the_closure():
    closure = closed("one power-on")
    unit = measured_properties(closure, ThermalEstimate())
    hours = (closure.campaign.end_s - closure.campaign.start_s)[0] / 3600.0
    expected = closure.noise_scale * closure.campaign.sigma_dph[0] * np.sqrt(hours)
    np.testing.assert_allclose(unit.angle_random_walk_deg_per_sqrt_h, expected)
    assert (unit.has_boards, unit.has_case) == (False, False)
    assert unit.thermal.rms_k < 1.0


def test_noise_that_gyros_share_counts_once_in_forecasts_too():
    closure = closed("one power-on")
    correlated = replace(closure, noise=replace(closure.noise, correlation_factor=3.0))
    [once], [alone] = (tie_forecasts(each, plan()) for each in (correlated, closure))
    assert 1.0 < math.log(once.if_found) < 0.6 * math.log(alone.if_found)


def test_outliers_count_as_in_the_search():
    effects, sensors, candidates = TIES["one power-on"]
    rows = measure(effects, cycles=2, sensors=sensors).rows
    rows[7] = replace(
        rows[7], bias_dph=tuple(each + 60.0 * rows[7].sigma_dph[0] for each in rows[7].bias_dph)
    )
    closure = close_loop(campaign_of(rows), effects=candidates)
    assert {each.dwell for each in closure.noise.outliers} == {rows[7].dwell}
    [disturbed], [usual] = (tie_forecasts(each, plan()) for each in (closure, closed("one power-on")))
    for name in ("if_found", "if_other"):
        odds = [math.log(getattr(each, name)) for each in (disturbed, usual)]
        assert odds[0] == pytest.approx(odds[1], rel=0.2)
