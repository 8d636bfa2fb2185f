import pytest

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.procedure.estimate import BenchEstimate, ThermalEstimate
from gyrobench.bench.procedure.plan import expand, turns_after
from gyrobench.bench.procedure.procedure_file import load_procedure

START = "- power_on: {settle_s: 60}\n- go_to: {position: z_up, rate_dps: 10}\n"
PAIR = (
    "- align: {duration_s: 300}\n- navigate: {duration_s: 600}\n"
    "- turn: {angle_deg: 180, rate_dps: 10, settle_s: 5}\n- navigate: {duration_s: 600}\n"
)


def test_steps_are_numbered_and_follow_one_another_in_time(planned):
    _, plan = planned(START + PAIR)
    assert [one.number for one in plan.steps] == [1, 2, 3, 4, 5, 6]
    assert [one.start_s for one in plan.steps] == pytest.approx([0, 60, 83, 383, 983, 1006])
    assert plan.duration_s == pytest.approx(1606)
    assert all(one.timeout_s > one.duration_s for one in plan.steps)


def test_a_pair_of_navigations_around_a_turn_is_a_dwell(planned):
    _, plan = planned(START + PAIR)
    assert [(one.dwell, one.step.name) for one in plan.steps] == [
        (None, "power_on"),
        (None, "go_to"),
        (1, "align"),
        (1, "navigate"),
        (1, "turn"),
        (1, "navigate"),
    ]
    assert plan.dwell_count == 1


@pytest.mark.parametrize(("angle_deg", "azimuths_deg"), [(90, [0, 90, 180, 270]), (-90, [0, 270, 180, 90])])
def test_four_azimuths_are_one_dwell_with_four_windows(planned, angle_deg, azimuths_deg):
    quarter = f"- turn: {{angle_deg: {angle_deg}, rate_dps: 10}}\n- navigate: {{duration_s: 600}}\n"
    _, plan = planned(START + "- align: {duration_s: 300}\n- navigate: {duration_s: 600}\n" + 3 * quarter)
    assert {one.dwell for one in plan.steps[2:]} == {1}
    windows = [one for one in plan.steps if one.step.name == "navigate"]
    assert len(windows) == 4
    assert [one.before.azimuth_deg for one in windows] == pytest.approx(azimuths_deg)
    assert [one.start_s for one in windows] == pytest.approx([383 + 614 * count for count in range(4)])
    assert [one.step.name for one in plan.steps[2:]].count("turn") == 3
    assert [turn for _, turn in turns_after(plan, plan.steps[1])] == [angle_deg] * 3


def test_the_turns_of_a_position_are_those_before_the_next_go_to(planned):
    back = PAIR.replace("180", "-180")
    _, plan = planned(START + PAIR + back + "- go_to: {position: y_up}\n" + back)
    moves = [one for one in plan.steps if one.step.name == "go_to"]
    turns = [[(one.number, turn) for one, turn in turns_after(plan, move)] for move in moves]
    assert turns == [[(5, 180), (9, -180)], [(14, -180)]]
    assert plan.steps[9].before.azimuth_deg == pytest.approx(0.0)


def test_dwells_are_numbered_in_time_order(planned):
    _, plan = planned(START + PAIR + "- go_to: {position: y_up}\n" + PAIR + PAIR)
    assert [one.dwell for one in plan.steps if one.step.name == "align"] == [1, 2, 3]


def test_a_wait_before_the_last_navigation_belongs_to_the_dwell_and_one_after_it_does_not(planned):
    wait = "- wait: {duration_s: 5}\n"
    _, plan = planned(
        START + PAIR.replace("- navigate", wait + "- navigate") + wait + "- turn: {angle_deg: 180}\n"
    )
    assert [(one.dwell, one.step.name) for one in plan.steps[2:]] == [
        (1, "align"), (1, "wait"), (1, "navigate"), (1, "turn"), (1, "wait"), (1, "navigate"),
        (None, "wait"), (None, "turn"),
    ]  # fmt: skip


def test_an_alignment_without_navigation_is_no_dwell(planned):
    _, plan = planned(START + "- align: {duration_s: 300}\n- wait: {duration_s: 5}\n")
    assert plan.dwell_count == 0
    assert {one.dwell for one in plan.steps} == {None}


def test_a_soak_ends_a_dwell(planned):
    _, plan = planned(START + PAIR.replace("- turn", "- soak: {for_s: 5}\n- turn"))
    assert [one.dwell for one in plan.steps[2:]] == [1, 1, None, None, None]


def test_one_navigation_straight_from_the_alignment_is_a_dwell_with_its_purpose(planned):
    verify = "- align: {duration_s: 600}\n- navigate: {duration_s: 600, purpose: calibration_check}\n"
    _, plan = planned(START + verify + "- go_to: {position: z_up, azimuth_deg: 180}\n" + verify + PAIR)
    check, calibration = DwellPurpose.CALIBRATION_CHECK, DwellPurpose.CALIBRATION
    assert [(one.dwell, one.purpose) for one in plan.steps[2:]] == [
        *[(1, check)] * 2, (None, calibration), *[(2, check)] * 2, *[(3, calibration)] * 4,
    ]  # fmt: skip
    azimuths = {one.dwell: one.before.azimuth_deg for one in plan.steps if one.step.name == "align"}
    assert azimuths == {1: 0.0, 2: 180.0, 3: 180.0}


def test_a_navigation_that_may_end_early_is_planned_at_its_longest(planned):
    until = "- navigate: {until: {bias_sigma_below_dph: 0.002}, at_most_s: 900}\n"
    _, plan = planned(START + PAIR + "- turn: {angle_deg: 180, rate_dps: 10, settle_s: 5}\n" + until)
    last = plan.steps[-1]
    assert (last.start_s, last.duration_s, last.dwell) == (pytest.approx(1629), 900, 1)
    assert last.timeout_s > 900
    assert plan.duration_s == pytest.approx(2529)


def test_cycle_is_that_of_the_loop_and_one_elsewhere(planned):
    _, plan = planned("- power_off\n- repeat: {over: {cycle: [2, 3]}, steps: [power_off]}\n- power_off")
    assert [one.cycle for one in plan.steps] == [1, 2, 3, 1]


def test_label_has_cycle_temperature_and_position(planned):
    steps = (
        "- power_on\n- repeat:\n    over: {cycle: [2], temperature_c: [-36]}\n    steps:\n"
        "      - chamber: {temperature_c: $temperature_c, ramp_c_per_min: 1}\n"
        "      - go_to: {position: z_up}\n      - soak: {for_s: 5}\n"
    )
    _, plan = planned(steps)
    assert [one.label for one in plan.steps] == [
        "", "cycle 2, -36 degC", "cycle 2, -36 degC, z_up", "cycle 2, -36 degC",
    ]  # fmt: skip


def test_each_step_starts_in_the_state_that_the_one_before_left(planned):
    _, plan = planned(START + "- chamber: {temperature_c: 60, ramp_c_per_min: 1}\n- soak: {for_s: 3600}\n")
    for before, after in zip(plan.steps, plan.steps[1:], strict=False):
        assert after.before == before.after
    assert plan.steps[-1].before.powered
    assert plan.steps[-1].before.position == "z_up"
    assert 60.0 < plan.steps[-1].after.gyro_c < 75.0


def test_the_thermal_estimate_of_the_station_changes_the_soaks(planned):
    steps = START + (
        "- chamber: {temperature_c: 60, ramp_c_per_min: 1}\n"
        "- soak: {until_gyro_rate_below_c_per_h: 2, at_most_s: 100000}\n"
    )
    document, slow = planned(steps)
    nimble = BenchEstimate.at_rest(ThermalEstimate(time_constant_s=600.0))
    fast = expand(document, slow.procedure, nimble)
    assert fast.steps[-1].duration_s < 0.5 * slow.steps[-1].duration_s


def test_the_times_of_the_shipped_procedures(shipped):
    hours = {}
    for path in sorted(shipped.glob("*.yaml")):
        document, procedure = load_procedure(path)
        assert procedure.procedure == path.stem
        hours[path.stem] = expand(document, procedure).duration_s / 3600.0
    assert 40.0 < hours["six_position_fig7"] < 46.0
    assert 7.0 < hours["three_temperature_shift"] < 8.0
    assert 9.0 < hours["calibration_check"] < 10.5
    assert 8.0 < hours["ten_minute_check"] * 60.0 < 11.0
