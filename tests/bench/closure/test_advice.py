"""Changes that are advised, and whether they help."""

from dataclasses import replace

import pytest

from gyrobench.bench.cli.plan import declared_properties
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.planned_campaign import planned_campaign
from gyrobench.bench.closure.procedure_changes import advise
from gyrobench.bench.closure.separability import searched_dwells, separability
from gyrobench.bench.foundations.documents import DocumentProblem
from tests.bench.closure.plans import shipped, station

TARGET_DPH = 0.001
#: As many as leave some found only after a change, some pairs not distinguished, and lose one on a ramp.
NAMES = {
    "temperature_rate", "thermal_gradient", "thermal_lag", "attitude_thermal", "warm_up", "time_drift",
    "bias_jump", "g_sensitivity",
}  # fmt: skip
EFFECTS = [each for each in all_effects() if each.name in NAMES]


def now_of(plan, unit, effects=EFFECTS):
    return separability(searched_dwells(planned_campaign(plan, unit)), effects)


@pytest.fixture(scope="module")
def fig7():
    document, plan = shipped("six_position_fig7")
    unit = declared_properties(station())
    return document, plan, unit, now_of(plan, unit)


@pytest.fixture(scope="module")
def advice(fig7):
    document, plan, unit, now = fig7
    return advise(document, plan, station().plan_document, unit, now, TARGET_DPH)


def test_every_unresolved_effect_and_pair_gets_one_advice(fig7, advice):
    now = fig7[-1]
    assert sorted(pair for each in advice for pair in each.pairs) == now.not_distinguished(TARGET_DPH)
    assert sorted(name for each in advice for name in each.found) == now.not_found(TARGET_DPH)


def test_the_least_added_time_comes_first(advice):
    hours = [each.added_h for each in advice if each.instructions]
    assert hours == sorted(hours)
    assert hours[0] < 5.0


def test_a_lost_pair_was_distinguished_before(fig7, advice):
    now = fig7[-1]
    lost = {pair for each in advice for pair in each.lost}
    # On a ramp both go with the rate, and no dwell of the shipped procedure sees a ramp.
    assert ("thermal_gradient", "thermal_lag") in lost
    assert not lost & set(now.not_distinguished(TARGET_DPH))


def test_no_advice_if_all_effects_are_distinguished(fig7):
    document, plan, unit, _ = fig7
    campaign = searched_dwells(planned_campaign(plan, unit))
    # The others take a second power cycle, another heading, or something that is logged.
    possible = [each for each in EFFECTS if each.missing_input(campaign) is None]
    now = separability(campaign, possible)
    assert advise(document, plan, station().plan_document, unit, now, target_dph=0.1) == []


def test_a_station_that_can_not_run_any_change_leaves_all_open(fig7):
    document, plan, unit, now = fig7

    def refuse(changed):
        raise changed.error([DocumentProblem((), "the mount is in the way")])

    [open_] = advise(document, plan, refuse, unit, now, TARGET_DPH)
    assert open_.instructions == ()
    assert list(open_.pairs) == now.not_distinguished(TARGET_DPH)


def test_sensors_cost_no_time(fig7):
    document, plan, unit, _ = fig7
    blind = replace(unit, has_boards=False, has_case=False)
    shown_by_sensors = [each for each in EFFECTS if each.name in {"thermal_gradient", "attitude_thermal"}]
    now = now_of(plan, blind, shown_by_sensors)
    first = advise(document, plan, station().plan_document, blind, now, TARGET_DPH)[0]
    assert first.instructions == ("measure the temperature of each gyro's electronics",)
    assert first.added_h == 0.0
    assert "attitude_thermal" in first.found or "thermal_gradient" in first.found
