import itertools

import pytest

from gyrobench.bench.investigation.blocks import catalogue
from tests.bench.investigation.simulated_bench import first_campaign, simulate


@pytest.fixture(scope="module")
def rows():
    return simulate({"unit": "S1", "seed": 3, "effects": {}, "steps": first_campaign([45.0, -20.0])})


def test_the_steps_of_each_block_follow_one_another_from_the_end_of_the_table(rows):
    alone = catalogue(rows)
    for block in [*alone, *catalogue(rows, itertools.permutations([each.name for each in alone], 2))]:
        steps = block.plan.steps
        assert steps[0].start_s == block.plan.start_s == rows[-1].end_s
        assert all(one.end_s == other.start_s for one, other in itertools.pairwise(steps)), block.name
        assert [each.dwell for each in block.plan.dwells] == list(
            range(rows[-1].dwell + 1, rows[-1].dwell + 1 + len(block.plan.dwells))
        )


def test_ramps_last_as_long_as_their_rate_says(rows):
    for block in catalogue(rows):
        at_c = rows[-1].chamber_set_c
        for step in block.plan.steps:
            if step.kind == "chamber":
                hours = (step.end_s - step.start_s) / 3600.0
                assert hours == pytest.approx(abs(step.to_c - at_c) / step.ramp_c_per_h)
                at_c = step.to_c


def test_only_a_power_on_after_the_unit_was_off_begins_a_new_run(rows):
    runs = {block.name: {step.run for step in block.plan.dwells} for block in catalogue(rows)}
    assert runs["power cycle"] == {"B-2"}
    assert runs["power step"] == runs["slow ramp"] == {"B-1"}


def test_the_state_before_a_block_is_that_after_the_last_dwell(rows):
    state, last = catalogue(rows)[0].plan.state, rows[-1]
    assert state.since_power_on_s == pytest.approx(last.since_power_on_s + last.end_s - last.start_s)
    assert (state.position, state.powered) == (last.position, True)
    assert state.gyro_x_c == pytest.approx(last.gyro_c[0], abs=1.0)


def test_long_dwells_are_longer_than_those_of_the_table(rows):
    plan = next(each.plan for each in catalogue(rows) if each.name == "longer dwells")
    assert all(step.end_s - step.start_s == pytest.approx(3600.0) for step in plan.dwells)


def test_headings_in_two_positions_turn_a_horizontal_field_through_all_body_axes(rows):
    """Each block of headings turns the field about the axis that is vertical in it."""
    vertical = {
        block.name: {step.position[0] for step in block.plan.dwells}
        for block in catalogue(rows)
        if sorted({step.azimuth_deg for step in block.plan.dwells}) == [0.0, 90.0, 180.0, 270.0]
    }
    assert vertical == {"four headings": {"z"}, "four headings on the side": {"y"}}
