import numpy as np
import pytest

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.foundations.text import hours_minutes
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.estimate import BenchEstimate, ThermalEstimate
from gyrobench.bench.procedure.plan import expand
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.procedure.timeline import (
    ROTATIONS,
    is_cycle_unnumbered,
    position_spans,
    temperature_profile,
    timeline_rows,
    unsettled_soaks,
)
from gyrobench.bench.report.figures.temperatures import plan_figure

ONE_STOP = """\
- power_on: {settle_s: 60}
- chamber: {temperature_c: 53, ramp_c_per_min: 1}
- soak: {for_s: 3600}
- repeat:
    over: {position: [z_up, x_down]}
    steps:
      - go_to: {position: $position, rate_dps: 10}
      - align: {duration_s: 300}
      - navigate: {duration_s: 600}
      - turn: {angle_deg: 180, rate_dps: 10, settle_s: 5}
      - wait: {duration_s: 60}
      - navigate: {duration_s: 600}
- power_off
"""


def test_a_stop_has_a_row_for_the_way_there_and_one_for_its_positions(planned):
    _, plan = planned(ONE_STOP)
    rows = timeline_rows(plan)
    assert [(row.steps_text, row.positions_text, row.dwells) for row in rows] == [
        ("power on, settle 60 s", "", 0),
        ("chamber to 53 degC at 1 degC/min; soak 60 min", "53 degC", 0),
        ("align 5 min; 2 x navigate 10 min; turn 180 deg; wait 60 s", "53 degC, z_up, x_down", 2),
        ("power off", "53 degC", 0),
    ]
    assert [hours_minutes(row.start_s) for row in rows] == ["0:00", "0:01", "1:32", "2:26"]


def test_rows_follow_one_another_and_cover_the_plan(planned):
    _, plan = planned(ONE_STOP)
    rows = timeline_rows(plan)
    ends = [row.start_s + row.duration_s for row in rows]
    assert [row.start_s for row in rows] == pytest.approx([0.0, *ends[:-1]])
    assert ends[-1] == pytest.approx(plan.duration_s)


def test_a_row_of_moves_alone_names_them(planned):
    _, plan = planned("- go_to: {position: y_up}")
    assert [(row.steps_text, row.positions_text) for row in timeline_rows(plan)] == [
        ("go to y_up, azimuth 0 deg", "y_up")
    ]


@pytest.mark.parametrize(
    ("cycle", "set_points", "is_unnumbered"),
    [
        ("cycle: [1, 2]", [60, 20], False),
        ("pass: [1, 2]", [60, 20], True),
        ("pass: [1, 2]", [60], False),
        ("pass: [1]", [20, 40, 60, 40, 20], False),
        ("pass: [1]", [20, 60], False),
    ],
)
def test_repeated_temperatures_and_positions_need_a_numbered_cycle(planned, cycle, set_points, is_unnumbered):
    _, plan = planned(
        "- power_on\n"
        "- repeat:\n"
        f"    over: {{{cycle}, temperature_c: {set_points}}}\n"
        "    steps:\n"
        "      - chamber: {temperature_c: $temperature_c, ramp_c_per_min: 1}\n"
        "      - go_to: {position: z_up}\n"
        "      - align: {duration_s: 300}\n"
        "      - navigate: {duration_s: 600}\n"
        "      - turn: {angle_deg: 180}\n"
        "      - navigate: {duration_s: 600}\n"
    )
    assert is_cycle_unnumbered(plan) is is_unnumbered


def test_a_plan_without_dwells_needs_no_cycle(planned):
    _, plan = planned("- go_to: {position: y_up}")
    assert not is_cycle_unnumbered(plan)


def test_a_soak_that_will_end_by_its_time_is_named_with_the_rate_that_is_left(planned):
    steps = (
        "- power_on: {settle_s: 60}\n"
        "- chamber: {temperature_c: 60, ramp_c_per_min: 1}\n"
        "- soak: {until_gyro_rate_below_c_per_h: 4, at_most_s: %d}\n"
    )
    _, plan = planned(steps % 3600)
    rate_c_per_h = plan.steps[-1].after.settling_c_per_h
    assert rate_c_per_h > 4.0
    assert unsettled_soaks(plan) == [f"60 degC: {rate_c_per_h:.2g} degC/h after 60 min, limit 4 degC/h"]
    _, plan = planned(steps % 14400)
    assert plan.steps[-1].duration_s < 14400
    assert unsettled_soaks(plan) == []


DWELL = "- go_to: {position: z_up}\n- align: {duration_s: 300}\n- navigate: {duration_s: 600}\n"


def test_a_row_states_how_often_a_dwell_navigates_and_turns(planned):
    quarter = "- turn: {angle_deg: 90}\n- navigate: {duration_s: 600}\n"
    four = DWELL + 3 * quarter
    _, plan = planned("- power_on\n" + four + four.replace("z_up", "z_down"))
    row = timeline_rows(plan)[-1]
    assert (row.steps_text, row.positions_text, row.dwells) == (
        "align 5 min; 4 x navigate 10 min; 3 x turn 90 deg", "z_up, z_down", 2,
    )  # fmt: skip


def test_a_row_states_what_may_end_early(planned):
    until = "- turn: {angle_deg: 180}\n- navigate: {until: {bias_sigma_below_dph: 0.002}, at_most_s: 900}\n"
    _, plan = planned("- power_on\n" + DWELL + until)
    assert timeline_rows(plan)[-1].steps_text == (
        "align 5 min; navigate 10 min; turn 180 deg; "
        "navigate until bias sigma below 0.002 deg/h, 15 min at most"
    )


def test_visits_of_one_position_in_succession_stand_together_with_their_azimuths(planned):
    moves = [("z_up", 0), ("z_up", 180), ("y_up", 90), ("z_up", 0), ("z_up", 0)]
    steps = [f"- go_to: {{position: {position}, azimuth_deg: {azimuth}}}\n" for position, azimuth in moves]
    _, plan = planned("".join(steps) + "- power_off\n")
    assert timeline_rows(plan)[0].positions_text == "z_up 0/180 deg, y_up 90 deg, z_up"


def test_the_shipped_calibration_check_visits_both_azimuths_of_two_positions_at_each_temperature(shipped):
    plan = expand(*load_procedure(shipped / "calibration_check.yaml"))
    measured = [row for row in timeline_rows(plan) if row.dwells]
    assert [(row.positions_text, row.steps_text, row.dwells) for row in measured] == [
        (
            f"cycle 1, {temperature} degC, z_up 0/180 deg, y_up 0/180 deg",
            "align 10 min; navigate 10 min for a calibration check",
            4,
        )
        for temperature in ("54", "20.5", "-23")
    ]
    assert all(one.purpose is DwellPurpose.CALIBRATION_CHECK for one in plan.steps if one.dwell)


def test_the_calibration_check_is_hot_and_cold_where_the_paper_procedure_was_not_and_at_room_where_it_was(
    shipped,
):
    bench = BenchEstimate.at_rest(ThermalEstimate(self_heating_c=12.0))

    def gyro_c(name):
        plan = expand(*load_procedure(shipped / f"{name}.yaml"), bench)
        return np.array([one.before.gyro_c for one in plan.steps if one.step.name == "navigate"])

    distance_c = np.abs(gyro_c("calibration_check")[:, None] - gyro_c("six_position_fig7")).min(axis=1)
    hot, room, cold = distance_c.reshape(3, 4)
    assert min(*hot, *cold) > 2.0
    assert max(room) < 2.0


def test_a_plan_of_two_days_stays_readable(shipped):
    rows = timeline_rows(expand(*load_procedure(shipped / "six_position_fig7.yaml")))
    assert len(rows) < 30
    assert sum(row.dwells for row in rows) == 60
    assert all(len(row.steps_text) < 100 and len(row.positions_text) < 80 for row in rows)


@pytest.mark.parametrize(
    ("time_s", "text"),
    [(0, "0:00"), (59, "0:01"), (3600, "1:00"), (3569, "0:59"), (3571, "1:00"), (216_000, "60:00")],
)
def test_times_are_hours_and_minutes(time_s, text):
    assert hours_minutes(time_s) == text


def test_temperatures_start_at_room_ramp_and_settle(planned):
    _, plan = planned(ONE_STOP)
    time_s, chamber_c, gyro_c = temperature_profile(plan)
    assert time_s[0] == 0.0
    assert time_s[-1] == pytest.approx(plan.duration_s)
    assert np.all(np.diff(time_s) >= 0.0)
    assert np.max(np.diff(time_s)) < 61.0
    half_way = np.interp(60.0 + 900.0, time_s, chamber_c)
    assert half_way == pytest.approx(23.0 + 15.0)
    assert chamber_c[-1] == pytest.approx(53.0)
    assert 65.0 < gyro_c[-1] < 68.0
    assert np.all(np.abs(np.diff(gyro_c)) < 1.0)


def test_gyros_of_the_paper_procedure_are_on_both_sides_of_50_degc_down_to_minus_20(shipped):
    plan = expand(*load_procedure(shipped / "six_position_fig7.yaml"))
    means = [
        0.5 * (one.before.gyro_c + one.after.gyro_c)
        for one in plan.steps
        if one.dwell and one.step.name == "navigate"
    ]
    assert min(means) < -20.0
    assert sum(mean > 52.0 for mean in means) >= 48
    assert sum(mean < 48.0 for mean in means) >= 72


def test_each_middle_temperature_of_the_paper_procedure_is_met_from_above_and_from_below(shipped):
    plan = expand(*load_procedure(shipped / "six_position_fig7.yaml"))
    arrivals = [
        (one.after.set_point_c, one.after.set_point_c > one.before.chamber_c)
        for one in plan.steps
        if one.step.name == "chamber"
    ][:-1]
    visited = {temperature for temperature, _ in arrivals}
    for temperature in visited - {max(visited), min(visited)}:
        assert {rising for reached, rising in arrivals if reached == temperature} == {True, False}


def test_the_paper_procedure_measures_all_positions_at_every_temperature_of_both_cycles(shipped):
    plan = expand(*load_procedure(shipped / "six_position_fig7.yaml"))
    cells = {(one.cycle, one.before.set_point_c, one.before.position) for one in plan.steps if one.dwell}
    temperatures = {temperature for _, temperature, _ in cells}
    assert cells == {(cycle, c, name) for cycle in (1, 2) for c in temperatures for name in POSITIONS}


def test_positions_span_from_their_go_to_to_their_last_step(planned):
    _, plan = planned(ONE_STOP)
    (first_start_s, first_end_s, first), (second_start_s, second_end_s, second) = position_spans(plan)
    assert (first, second) == ("z_up", "x_down")
    assert first_end_s == second_start_s
    assert first_end_s - first_start_s == pytest.approx(1606.0)
    assert second_end_s - second_start_s == pytest.approx(1606.0)
    assert second_end_s == pytest.approx(plan.duration_s)


def test_a_stay_with_rotations_is_in_no_position(shipped):
    plan = expand(*load_procedure(shipped / "full_calibration.yaml"))
    names = [name for _, _, name in position_spans(plan)]
    assert names == ["z_up", *4 * [*POSITIONS, ROTATIONS, ROTATIONS]]
    lanes = [label.get_text() for label in plan_figure(plan).axes[1].get_yticklabels()]
    assert lanes[-2:] == ["X-Down", "Rotations"]


def test_a_plan_without_positions_has_no_spans(planned):
    assert position_spans(planned("- wait: {duration_s: 5}")[1]) == []
