"""Effects that a bench finds only where it varies or measures what they follow."""

from dataclasses import replace
from itertools import accumulate

import numpy as np
import pytest

from gyrobench.bench.bias.dwell_table import format_dwells, parse_dwells
from gyrobench.bench.closure.campaign import campaign_of
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.loop import close_loop
from tests.bench.closure.conftest import EQUIPPED
from tests.bench.closure.thermal_bench import measure

EFFECTS = {each.name: each for each in all_effects()}
HEADINGS = EQUIPPED["headings_deg"]
LONG = pytest.mark.long


def closed(effect, *others, size=6.0, **options):
    """A search among some effects, or all."""
    rows = measure({effect: size}, **options).rows
    return close_loop(campaign_of(rows), effects=among(effect, *others))


def among(effect, *others):
    """Some effects; None, which is all, without others."""
    return [EFFECTS[each] for each in (effect, *others)] if others else None


#: What an effect needs of the bench.
SHOWN = {
    "magnetic_sensitivity": {"headings_deg": HEADINGS},
    "supply_power": {"sensors": ("set", "air", "board", "supply")},
    "thermal_g_sensitivity": {"headings_deg": HEADINGS},
    "daily_course": {"sensors": ("set", "air", "board", "room"), "cycles": 3},
    "neighbouring_unit": {"sensors": ("set", "air", "board", "neighbours")},
    "ageing": {"power_on_each_cycle": True, "cycles": 4},
}


@pytest.mark.parametrize(
    ("effect", "others"),
    [
        *((each, ("g_sensitivity", "temperature_rate", "warm_up")) for each in SHOWN),
        *(pytest.param(each, (), marks=LONG) for each in SHOWN),
    ],
)
def test_an_effect_is_found_where_the_bench_shows_it(effect, others):
    closure = closed(effect, *others, **({"cycles": 2} | SHOWN[effect]))
    assert [each.effect.name for each in closure.effects] == [effect]
    assert closure.error_after_dph < 1.3 * closure.noise_dph


def test_at_one_heading_a_g_sensitivity_may_be_magnetic():
    closure = closed("g_sensitivity", "magnetic_sensitivity", cycles=2)
    [found] = closure.effects
    assert found.effect.name == "g_sensitivity"
    assert found.tied_with == ("magnetic_sensitivity",)
    assert "coil or a magnetic shield" in closure.separating_measurement


def test_at_several_headings_it_is_not():
    [found] = closed("g_sensitivity", "magnetic_sensitivity", cycles=2, headings_deg=HEADINGS).effects
    assert found.effect.name == "g_sensitivity"
    assert "magnetic_sensitivity" not in found.tied_with


def test_opposite_headings_are_one_pair():
    form = EFFECTS["magnetic_sensitivity"].forms[0]
    for headings, can_be_fitted in (((0.0, 180.0), False), ((0.0, 180.0, 90.0), True)):
        campaign = campaign_of(measure(cycles=2, headings_deg=headings).rows)
        assert (form.missing_input(campaign) is None) == can_be_fitted


def test_a_drift_in_less_than_two_days_may_be_the_room():
    short = closed("time_drift", "daily_course", cycles=2, size=8.0)
    assert "daily_course" in short.effects[0].tied_with
    longer = closed("time_drift", "daily_course", cycles=3, size=8.0)
    assert "daily_course" not in longer.effects[0].tied_with


@pytest.mark.parametrize(
    "others",
    [
        pytest.param(("temperature_rate", "time_drift"), id="two others"),
        pytest.param((), id="all", marks=LONG),
    ],
)
def test_what_the_room_warms_may_follow_it_later(others):
    def behind_the_room(course):
        step_h = course.time_h[1] - course.time_h[0]
        share = 1.0 - np.exp(-step_h / 1.5)
        return np.array([*accumulate(course.room_c, lambda was, now: was + share * (now - was))])[:, None]

    rows = measure({behind_the_room: 8.0}, cycles=3, sensors=("set", "air", "board", "room")).rows
    [found] = close_loop(campaign_of(rows), effects=among("daily_course", *others)).effects
    assert (found.effect.name, found.candidate.form.name) == ("daily_course", "lagging")
    assert found.candidate.values[0] == pytest.approx(1.5 * 3600.0, rel=0.3)


@pytest.mark.parametrize(
    "name", ["supply_power", "daily_course", "magnetic_sensitivity", "ageing", "neighbouring_unit"]
)
def test_what_the_bench_lacks_is_named(name):
    campaign = campaign_of(measure(cycles=2).rows)
    assert len(EFFECTS[name].missing_input(campaign).split()) > 3


def test_other_columns_are_read_and_written():
    rows = measure(**EQUIPPED).rows
    again = parse_dwells(format_dwells(rows), "table")
    for before, after in zip(rows, again, strict=True):
        assert dict(after.other) == pytest.approx(dict(before.other), rel=1e-8)
    campaign = campaign_of(again)
    np.testing.assert_allclose(
        campaign.columns["room_c"][:2], [dict(each.other)["room_c"] for each in again[:2]]
    )


def test_a_neighbour_without_heat_is_not_named():
    closure = close_loop(campaign_of(measure(cycles=3, sensors=("set", "air", "board", "neighbours")).rows))
    assert closure.verdict == "clean"


def test_a_neighbour_that_is_always_on_is_no_candidate():
    rows = [replace(row, other=(("neighbours_on", 1.0),)) for row in measure(cycles=2).rows]
    missing = EFFECTS["neighbouring_unit"].missing_input(campaign_of(rows))
    assert missing == "dwells with the unit beside it on, and others with it off"
