from collections.abc import Callable
from pathlib import Path

import pytest

from bench.documents import Document
from bench.procedure.document import load_procedure
from bench.procedure.estimate import BenchEstimate, ThermalEstimate
from bench.procedure.plan import Phase, Plan, expand

PlanOf = Callable[[str], tuple[Document, Plan]]

START = "- power_on: {settle_s: 60}\n- go_to: {position: z_up, rate_dps: 10}\n"
PAIR = (
    "- align: {duration_s: 300}\n- navigate: {duration_s: 600}\n"
    "- turn: {angle_deg: 180, rate_dps: 10, settle_s: 5}\n- navigate: {duration_s: 600}\n"
)


def test_steps_are_numbered_and_follow_one_another_in_time(planned: PlanOf) -> None:
    _, plan = planned(START + PAIR)
    assert [one.number for one in plan.steps] == [1, 2, 3, 4, 5, 6]
    assert [one.start_s for one in plan.steps] == pytest.approx([0, 60, 83, 383, 983, 1006])
    assert plan.duration_s == pytest.approx(1606)
    assert all(one.timeout_s > one.duration_s for one in plan.steps)


def test_a_pair_of_navigations_around_a_turn_is_a_dwell(planned: PlanOf) -> None:
    _, plan = planned(START + PAIR)
    assert [(one.dwell, one.phase, one.window) for one in plan.steps] == [
        (None, None, None),
        (None, None, None),
        (1, Phase.ALIGN, None),
        (1, Phase.BEFORE, 0),
        (1, Phase.TURN, None),
        (1, Phase.AFTER, 1),
    ]
    assert plan.dwell_count == 1


def test_four_azimuths_are_one_dwell_with_four_windows(planned: PlanOf) -> None:
    quarter = "- turn: {angle_deg: 90}\n- navigate: {duration_s: 600}\n"
    _, plan = planned(START + "- align: {duration_s: 300}\n- navigate: {duration_s: 600}\n" + 3 * quarter)
    assert {one.dwell for one in plan.steps[2:]} == {1}
    assert [one.window for one in plan.steps if one.window is not None] == [0, 1, 2, 3]
    assert [one.phase for one in plan.steps if one.window] == [Phase.AFTER] * 3


def test_dwells_are_numbered_in_time_order(planned: PlanOf) -> None:
    _, plan = planned(START + PAIR + "- go_to: {position: y_up}\n" + PAIR + PAIR)
    assert [one.dwell for one in plan.steps if one.phase is Phase.ALIGN] == [1, 2, 3]


def test_a_wait_before_the_last_navigation_belongs_to_the_dwell_and_one_after_it_does_not(
    planned: PlanOf,
) -> None:
    wait = "- wait: {duration_s: 5}\n"
    _, plan = planned(
        START + PAIR.replace("- navigate", wait + "- navigate") + wait + "- turn: {angle_deg: 180}\n"
    )
    assert [one.phase for one in plan.steps[2:]] == [
        Phase.ALIGN, Phase.PAUSE, Phase.BEFORE, Phase.TURN, Phase.PAUSE, Phase.AFTER, None, None,
    ]  # fmt: skip


@pytest.mark.parametrize(
    "steps",
    [
        "- align: {duration_s: 300}\n- navigate: {duration_s: 3600}\n",
        "- align: {duration_s: 300}\n- turn: {angle_deg: 180}\n- navigate: {duration_s: 600}\n",
        "- align: {duration_s: 300}\n- navigate: {duration_s: 600}\n- turn: {angle_deg: 180}\n",
        "- align: {duration_s: 300}\n",
    ],
)
def test_without_navigation_on_both_sides_of_a_turn_there_is_no_dwell(planned: PlanOf, steps: str) -> None:
    _, plan = planned(START + steps)
    assert plan.dwell_count == 0
    assert {one.phase for one in plan.steps} == {None}


def test_a_soak_ends_a_dwell(planned: PlanOf) -> None:
    _, plan = planned(START + PAIR.replace("- turn", "- soak: {for_s: 5}\n- turn"))
    assert plan.dwell_count == 0


def test_cycle_is_that_of_the_loop_and_one_elsewhere(planned: PlanOf) -> None:
    _, plan = planned("- power_off\n- repeat: {over: {cycle: [2, 3]}, steps: [power_off]}\n- power_off")
    assert [one.cycle for one in plan.steps] == [1, 2, 3, 1]


def test_label_tells_cycle_temperature_and_position(planned: PlanOf) -> None:
    steps = (
        "- power_on\n- repeat:\n    over: {cycle: [2], temperature_c: [-36]}\n    steps:\n"
        "      - chamber: {temperature_c: $temperature_c, ramp_c_per_min: 1}\n"
        "      - go_to: {position: z_up}\n      - soak: {for_s: 5}\n"
    )
    _, plan = planned(steps)
    assert [one.label for one in plan.steps] == [
        "", "cycle 2, -36 degC", "cycle 2, -36 degC, z_up", "cycle 2, -36 degC",
    ]  # fmt: skip


def test_each_step_starts_in_the_state_that_the_one_before_left(planned: PlanOf) -> None:
    _, plan = planned(START + "- chamber: {temperature_c: 60, ramp_c_per_min: 1}\n- soak: {for_s: 3600}\n")
    for before, after in zip(plan.steps, plan.steps[1:], strict=False):
        assert after.before == before.after
    assert plan.steps[-1].before.powered
    assert plan.steps[-1].before.position == "z_up"
    assert 60.0 < plan.steps[-1].after.gyro_c < 75.0


def test_the_thermal_estimate_of_the_station_changes_the_soaks(planned: PlanOf) -> None:
    steps = START + (
        "- chamber: {temperature_c: 60, ramp_c_per_min: 1}\n"
        "- soak: {until_gyro_rate_below_c_per_h: 2, at_most_s: 100000}\n"
    )
    document, slow = planned(steps)
    nimble = BenchEstimate.at_rest(ThermalEstimate(time_constant_s=600.0))
    fast = expand(document, slow.procedure, nimble)
    assert fast.steps[-1].duration_s < 0.5 * slow.steps[-1].duration_s


def test_the_times_of_the_shipped_procedures(shipped: Path) -> None:
    hours = {}
    for path in sorted(shipped.glob("*.yaml")):
        document, procedure = load_procedure(path)
        assert procedure.procedure == path.stem
        hours[path.stem] = expand(document, procedure).duration_s / 3600.0
    assert 40.0 < hours["six_position_fig7"] < 46.0
    assert 7.0 < hours["three_temperature_shift"] < 8.0
    assert 8.0 < hours["ten_minute_check"] * 60.0 < 11.0
