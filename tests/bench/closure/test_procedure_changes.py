"""Changes of a procedure, made to its steps and planned."""

import copy
from dataclasses import replace

import pytest

from gyrobench.bench.closure.planned_campaign import UnitProperties, planned_campaign
from gyrobench.bench.closure.procedure_changes import CHANGES
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
