"""The way back into a plan that was left."""

import pytest

from gyrobench.bench.foundations.documents import parse_document
from gyrobench.bench.procedure.approach import (
    RetainedState,
    approach,
    index_after_dwell,
    remaining_steps,
    restart_index,
    retained_between,
)
from gyrobench.bench.procedure.plan import expand
from gyrobench.bench.procedure.procedure_file import checked_procedure
from gyrobench.bench.procedure.steps import Align, GoTo, PowerOn, SetChamber, Soak, Turn, Wait

PROCEDURE = """
procedure: there_and_back
steps:
  - power_on: {settle_s: 60}
  - repeat:
      over: {temperature_c: [60, 20]}
      steps:
        - chamber: {temperature_c: $temperature_c, ramp_c_per_min: 2}
        - soak: {for_s: 3600}
        - repeat:
            over: {position: [z_up, x_down]}
            steps: &dwell
              - go_to: {position: $position, azimuth_deg: 90}
              - align: {duration_s: 60}
              - navigate: {duration_s: 100}
              - turn: {angle_deg: 180}
              - navigate: {duration_s: 100}
  - chamber: {temperature_c: -20, ramp_c_per_min: 1, within_c: 50}
  - repeat: {over: {position: [z_up, y_up]}, steps: *dwell}
"""
COLD_START = RetainedState(is_ins_on=False, is_at_temperature=False, chamber_c=23.0)


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    document = parse_document(PROCEDURE, tmp_path_factory.mktemp("plan") / "there_and_back.yaml")
    return expand(document, checked_procedure(document))


def index_of(plan, dwell, kind):
    return next(i for i, each in enumerate(plan.steps) if each.dwell == dwell and isinstance(each.step, kind))


def kinds(steps):
    return [type(each.step) for each in steps]


def test_a_dwell_is_begun_again_with_its_alignment(plan):
    last = max(i for i, each in enumerate(plan.steps) if each.dwell == 2)
    assert restart_index(plan, last) == index_of(plan, 2, Align)
    assert plan.steps[index_after_dwell(plan, 2)].step.name == "chamber"


def test_a_step_outside_dwells_is_begun_again_itself(plan):
    assert restart_index(plan, 2) == 2


def test_after_a_power_cut_unit_chamber_soak_and_position_come_first(plan):
    steps = approach(plan, index_of(plan, 1, Align), COLD_START)
    assert kinds(steps) == [PowerOn, SetChamber, Soak, GoTo]
    assert (steps[1].step.temperature_c, steps[3].step.position) == (60, "z_up")
    assert steps[3].step.azimuth_deg == 90


def test_a_dwell_that_begins_turned_is_approached_turned(plan):
    turned = index_of(plan, 1, Turn) + 1
    (go_to,) = approach(plan, turned, RetainedState(True, True, 60.0))
    assert go_to.step.azimuth_deg == 270


def test_what_still_stands_is_not_done_again(plan):
    steps = approach(plan, index_of(plan, 1, Align), RetainedState(True, True, 60.0))
    assert kinds(steps) == [GoTo]


def test_a_temperature_is_reached_from_the_side_from_which_the_plan_comes(plan):
    index = index_of(plan, 3, Align)
    from_above = approach(plan, index, RetainedState(True, False, 40.0))
    assert [each.step.temperature_c for each in from_above if isinstance(each.step, SetChamber)] == [20]
    from_below = approach(plan, index, RetainedState(True, False, 5.0))
    assert kinds(from_below) == [SetChamber, Soak, SetChamber, Soak, GoTo]
    assert [each.step.temperature_c for each in from_below if isinstance(each.step, SetChamber)] == [60, 20]


def test_air_that_is_where_it_was_has_not_come_from_the_wrong_side(plan):
    steps = approach(plan, index_of(plan, 3, Align), RetainedState(True, False, 19.5))
    assert kinds(steps) == [SetChamber, Soak, GoTo]


def test_a_dwell_on_a_ramp_has_its_ramp_repeated_up_to_its_moment(plan):
    index = index_of(plan, 6, Align)
    steps = approach(plan, index, RetainedState(True, False, 0.0))
    assert kinds(steps) == [SetChamber, Soak, SetChamber, Soak, SetChamber, Wait, GoTo]
    assert [each.step.temperature_c for each in steps if isinstance(each.step, SetChamber)] == [60, 20, -20]
    ramp = next(each for each in plan.steps if each.step.name == "chamber" and each.step.temperature_c == -20)
    stay = next(each for each in reversed(plan.steps[:index]) if isinstance(each.step, GoTo))
    assert steps[-2].step.duration_s == pytest.approx(stay.start_s - ramp.end_s)


def test_a_ramp_that_is_followed_by_dwells_begins_at_the_temperature_before(plan):
    index = next(
        i
        for i, each in enumerate(plan.steps)
        if each.step.name == "chamber" and each.step.temperature_c == -20
    )
    steps = approach(plan, index, RetainedState(True, False, 10.0))
    assert kinds(steps) == [SetChamber, Soak, SetChamber, Soak]


def test_a_ramp_that_is_followed_by_a_soak_goes_on_from_where_it_is(plan):
    index = next(i for i, each in enumerate(plan.steps) if isinstance(each.step, SetChamber) and i > 3)
    assert approach(plan, index, RetainedState(True, False, 35.0)) == []
    assert kinds(approach(plan, index, RetainedState(True, False, 5.0))) == [SetChamber, Soak]


def test_the_way_has_time_limits_of_its_own(plan):
    chamber = approach(plan, index_of(plan, 1, Align), RetainedState(False, False, -20.0))[1]
    planned = next(each for each in plan.steps if isinstance(each.step, SetChamber))
    assert chamber.timeout_s > 2 * 80 / 2 * 60 > planned.timeout_s


def test_between_dwells_of_a_plateau_the_temperature_is_kept(plan):
    first, second, third = (index_of(plan, dwell, Align) for dwell in (1, 2, 3))
    kept = RetainedState(True, True, 60.0)
    assert retained_between(plan, first, second, kept) == kept
    assert retained_between(plan, first, third, kept) == RetainedState(True, False, 60.0)
    assert retained_between(plan, 0, first, kept) == RetainedState(False, False, 60.0)


def test_the_remaining_steps_of_a_run_have_each_plateau_once_and_follow_one_another(plan):
    steps = remaining_steps(plan, len(plan.steps), {4, 1, 2}, COLD_START)
    assert kinds(steps)[:4] == [PowerOn, SetChamber, Soak, GoTo]
    temperatures_c = [each.step.temperature_c for each in steps if isinstance(each.step, SetChamber)]
    assert temperatures_c == [60, 20]
    assert [each.dwell for each in steps if isinstance(each.step, Align)] == [1, 2, 4]
    assert [each.end_s for each in steps[:-1]] == pytest.approx([each.start_s for each in steps[1:]])
    assert steps[0].start_s == 0.0


def test_steps_that_remain_follow_those_of_lost_dwells(plan):
    index = index_after_dwell(plan, 4)
    steps = remaining_steps(plan, index, {1}, None)
    assert steps[0].number == plan.steps[index_of(plan, 1, Align)].number
    assert kinds(steps)[-len(plan.steps[index:]) :] == kinds(plan.steps[index:])
    assert remaining_steps(plan, len(plan.steps), (), None) == []
