"""Changes of a procedure, made to its steps and planned; changes that are advised, and whether they help."""

import copy
from dataclasses import replace

import pytest

from gyrobench.bench.cli.plan import declared_properties
from gyrobench.bench.closure.effects import all_effects
from gyrobench.bench.closure.planned_campaign import UnitProperties, planned_campaign
from gyrobench.bench.closure.procedure_changes import CHANGES, ChangeablePlan, advise
from gyrobench.bench.closure.separability import searched_dwells, separability
from gyrobench.bench.foundations.documents import DocumentProblem
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.closure.plans import dwell, planned, shipped, station

BY_NAME = {change.instructions: change for change in CHANGES}
ON_RAMPS = ("measure two positions on each ramp",)
CYCLE = ("add a cycle",)
POWER = ("switch the unit off for an hour between cycles",)
RETURN = ("return to the first position at the end of each plateau",)
MIDDLE = ("return to the middle temperature at the end of each cycle",)
SLOWER = ("run every second cycle at half the ramp rate",)
LEFT_ON = ("leave the unit on for 12 h before the second cycle",)
ALL = ("measure all six positions at each temperature",)


def changed(what, document):
    """Plan of the changed procedure and its campaign; None where there is nothing to change."""
    before = copy.deepcopy(document.data["steps"])
    steps = BY_NAME[what].apply(document.data["steps"])
    assert document.data["steps"] == before
    if steps is None:
        return None
    plan = station().plan_document(replace(document, data=document.data | {"steps": steps}))
    return plan, planned_campaign(plan, UnitProperties())


@pytest.fixture(scope="module")
def fig7():
    return shipped("six_position_fig7")[0]


@pytest.fixture(scope="module")
def shift():
    return shipped("three_temperature_shift")[0]


def test_another_cycle_repeats_the_last_one(fig7):
    _, campaign = changed(CYCLE, fig7)
    assert [*map(int, sorted(set(campaign.cycle.tolist())))] == [1, 2, 3]
    second, third = (campaign.cycle == number for number in (2, 3))
    assert campaign.set_c[third].tolist() == campaign.set_c[second].tolist()


def test_steps_without_cycles_are_done_twice():
    document, _ = planned(f"  - power_on\n{dwell('z_up')}  - power_off\n")
    plan, campaign = changed(CYCLE, document)
    assert campaign.cycle.tolist() == [1, 2]
    assert plan.steps[-1].step.name == "power_off"


def test_a_power_cycle_stands_between_cycles_and_needs_two(fig7, shift):
    _, campaign = changed(POWER, fig7)
    assert campaign.run.tolist() == [0] * 30 + [1] * 30
    assert changed(POWER, shift) is None
    _, both = changed(CYCLE + POWER, shift)
    assert both.run.tolist() == [0] * 12 + [1] * 12


def test_dwells_on_ramps_see_the_temperature_move(fig7):
    _, campaign = changed(ON_RAMPS, fig7)
    assert len(campaign) == 60 + 2 * 10
    fast = abs(campaign.rate_c_per_h[:, 0]) > 10.0
    assert fast.sum() >= 2 * 8


def test_each_plateau_ends_in_its_first_position(fig7):
    _, campaign = changed(RETURN, fig7)
    assert len(campaign) == 60 + 10
    assert campaign.position[0] == campaign.position[6] == "z_up"
    assert campaign.set_c[0] == campaign.set_c[6] == 62.0


def test_each_cycle_returns_to_its_middle_temperature(fig7, shift):
    _, campaign = changed(MIDDLE, shift)
    assert list(dict.fromkeys(campaign.set_c.tolist())) == [57.0, 22.0, -13.0]
    assert campaign.set_c[-4:].tolist() == [22.0] * 4
    assert changed(MIDDLE, fig7)[1].set_c[30:36].tolist() == [20.5] * 6


def test_every_second_cycle_ramps_at_half_the_rate(fig7):
    plan, _ = changed(SLOWER, fig7)
    ramps = [(each.cycle, each.step.ramp_c_per_min) for each in plan.steps if each.step.name == "chamber"]
    assert ramps[:-1] == [(1, 1.0)] * 3 + [(1, 2.0)] * 2 + [(2, 1.0)] * 4 + [(2, 0.5)]


def test_the_unit_stays_on_for_long_before_the_second_cycle(fig7):
    _, campaign = changed(LEFT_ON, fig7)
    second = int((campaign.cycle == 2).argmax())
    assert campaign.start_s[second] - campaign.end_s[second - 1] > 43_200.0
    assert campaign.run.max() == 0


def test_missing_positions_of_a_plateau_are_added_once(fig7, shift):
    _, campaign = changed(ALL, shift)
    assert set(campaign.position[:6]) == set(POSITIONS)
    assert changed(ALL, fig7) is None


@pytest.mark.parametrize("what", sorted(BY_NAME))
@pytest.mark.parametrize("name", ["three_temperature_shift", "ten_minute_check"])
def test_a_changed_procedure_can_be_run(what, name):
    result = changed(what, shipped(name)[0])
    assert result is None or result[0].dwell_count >= len(result[1]) > 0


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
def fig7_now():
    document, plan = shipped("six_position_fig7")
    unit = declared_properties(station())
    return document, plan, unit, now_of(plan, unit)


@pytest.fixture(scope="module")
def advice(fig7_now):
    document, plan, unit, now = fig7_now
    return advise(ChangeablePlan(document, plan, station().plan_document, unit), now, TARGET_DPH)


def test_every_unresolved_effect_and_pair_gets_one_advice(fig7_now, advice):
    now = fig7_now[-1]
    assert sorted(pair for each in advice for pair in each.pairs) == now.not_distinguished(TARGET_DPH)
    assert sorted(name for each in advice for name in each.found) == now.not_found(TARGET_DPH)


def test_the_least_added_time_comes_first(advice):
    hours = [each.added_h for each in advice if each.instructions]
    assert hours == sorted(hours)
    assert hours[0] < 5.0


def test_a_lost_pair_was_distinguished_before(fig7_now, advice):
    now = fig7_now[-1]
    lost = {pair for each in advice for pair in each.lost}
    # On a ramp both go with the rate, and no dwell of the shipped procedure sees a ramp.
    assert ("thermal_gradient", "thermal_lag") in lost
    assert not lost & set(now.not_distinguished(TARGET_DPH))


def test_no_advice_if_all_effects_are_distinguished(fig7_now):
    document, plan, unit, _ = fig7_now
    campaign = searched_dwells(planned_campaign(plan, unit))
    # The others take a second power cycle, another heading, or something that is logged.
    possible = [each for each in EFFECTS if each.missing_input(campaign) is None]
    now = separability(campaign, possible)
    assert advise(ChangeablePlan(document, plan, station().plan_document, unit), now, target_dph=0.1) == []


def test_a_station_that_can_not_run_any_change_leaves_all_open(fig7_now):
    document, plan, unit, now = fig7_now

    def refuse(changed):
        raise changed.error([DocumentProblem((), "the mount is in the way")])

    [open_] = advise(ChangeablePlan(document, plan, refuse, unit), now, TARGET_DPH)
    assert open_.instructions == ()
    assert list(open_.pairs) == now.not_distinguished(TARGET_DPH)


def test_sensors_cost_no_time(fig7_now):
    document, plan, unit, _ = fig7_now
    blind = replace(unit, has_boards=False, has_case=False)
    shown_by_sensors = [each for each in EFFECTS if each.name in {"thermal_gradient", "attitude_thermal"}]
    now = now_of(plan, blind, shown_by_sensors)
    first = advise(ChangeablePlan(document, plan, station().plan_document, blind), now, TARGET_DPH)[0]
    assert first.instructions == ("measure the temperature of each gyro's electronics",)
    assert first.added_h == 0.0
    assert "attitude_thermal" in first.found or "thermal_gradient" in first.found
