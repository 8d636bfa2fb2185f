"""Plans that can't be run: order of the steps, limits of the station, reach of the table."""

from dataclasses import replace
from itertools import accumulate
from pathlib import Path

import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.checks import check_plan, find_problems
from gyrobench.bench.procedure.plan import expand
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.station.station import Station

# Lines 3 and 4; what follows begins in line 5.
START = "- power_on\n- go_to: {position: z_up}\n"
ALIGN = "- align: {duration_s: 300}\n"

ORDER = {
    "navigate without align": (START + "- navigate: {duration_s: 600}", "5:3", "Put align before"),
    "turn without align": (START + "- turn: {angle_deg: 180}", "5:3", "Put align before"),
    "navigate after another go_to": (
        START + ALIGN + "- go_to: {position: y_up}\n- navigate: {duration_s: 600}",
        "7:3",
        "after the last go_to",
    ),
    "navigate after power off": (
        START + ALIGN + "- power_off\n- power_on\n- navigate: {duration_s: 600}",
        "8:3",
        "and power_on",
    ),
    "align without position": ("- power_on\n" + ALIGN, "4:3", "Put go_to before"),
    "align without power": ("- go_to: {position: z_up}\n" + ALIGN, "4:3", "Put power_on before"),
    "turn without power": ("- turn: {angle_deg: 180}", "3:3", "turn needs the INS on. Put power_on before"),
    "soak on the gyros without power": (
        "- soak: {until_gyro_rate_below_c_per_h: 2}",
        "3:3",
        "soak needs the INS on. Put power_on before",
    ),
    "power on twice": ("- power_on\n- power_on", "4:3", "already on"),
    "timeout before the end": (
        "- wait: {duration_s: 60, timeout_s: 50}",
        "3:26",
        "shorter than the step, which takes 60 s",
    ),
    "timeout before a soak may end": (
        "- power_on\n- soak: {until_gyro_rate_below_c_per_h: 2, at_most_s: 900, timeout_s: 800}",
        "4:60",
        "shorter than the step, which takes 900 s",
    ),
    "timeout before a navigation may end": (
        START + ALIGN + "- navigate: {duration_s: 60}\n- turn: {angle_deg: 180}\n"
        "- navigate: {until: {bias_sigma_below_dph: 0.002}, at_most_s: 900, timeout_s: 800}",
        "8:68",
        "shorter than the step, which takes 900 s",
    ),
}


@pytest.mark.parametrize(
    ("step", "needs"),
    [
        ("navigate: {duration_s: 600}", True),
        ("navigate: {duration_s: 600, purpose: noise}", False),
        ("soak: {until_gyro_rate_below_c_per_h: 2}", True),
        ("soak: {for_s: 60}", False),
    ],
)
def test_what_needs_the_gyros_temperatures_is_refused_on_a_station_without_them(planned, limits, step, needs):
    _, plan = planned(START + ALIGN + f"- {step}")
    found = [str(each) for each in find_problems(plan, replace(limits, has_gyro_temperatures=False))]
    assert any("Map ins.signals.gyro_optics_temperature" in each for each in found) == needs


LIMIT = {
    "too cold": (
        "- chamber: {temperature_c: -41, ramp_c_per_min: 1}",
        "3:13",
        "-41 degC is outside .* -40 to 70 degC",
    ),
    "too hot": ("- chamber: {temperature_c: 71, ramp_c_per_min: 1}", "3:13", "71 degC is outside"),
    "ramp too fast": ("- chamber: {temperature_c: 20, ramp_c_per_min: 6}", "3:32", "at most 5 degC/min"),
    "go_to too fast": ("- go_to: {position: z_up, rate_dps: 61}", "3:27", "at most 60 deg/s"),
    "turn too fast": (START + ALIGN + "- turn: {angle_deg: 180, rate_dps: 61}", "6:26", "at most 60 deg/s"),
    "position out of reach": (
        "- go_to: {position: x_down}",
        "3:11",
        "x_down at azimuth 0 deg .*the mount is in the way",
    ),
    "loop value too cold": (
        "- repeat: {over: {t: [20, -50]}, steps: [{chamber: {temperature_c: $t, ramp_c_per_min: 1}}]}",
        "3:27",
        "-50 degC is outside",
    ),
}


@pytest.mark.parametrize(
    ("steps", "place", "message"), [*ORDER.values(), *LIMIT.values()], ids=[*ORDER, *LIMIT]
)
def test_what_cannot_work_is_named_with_its_place(planned, limits, steps, place, message):
    document, plan = planned(steps)
    with pytest.raises(DocumentError, match=message) as caught:
        check_plan(document, plan, limits)
    assert str(caught.value).startswith(f"test.yaml:{place}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("steps", [steps for steps, _, _ in ORDER.values()], ids=ORDER)
def test_order_and_times_are_checked_without_a_station(planned, steps):
    assert len(find_problems(planned(steps)[1])) == 1


@pytest.mark.parametrize("steps", [steps for steps, _, _ in LIMIT.values()], ids=LIMIT)
def test_limits_are_those_of_the_station(planned, limits, steps):
    wide = replace(
        limits, chamber_low_c=-60.0, chamber_high_c=90.0, ramp_max_c_per_min=10.0, table_rate_max_dps=100.0,
        unreachable_reason=lambda position, azimuth_deg, turns_deg: None,
    )  # fmt: skip
    assert find_problems(planned(steps)[1], wide) == []
    assert find_problems(planned(steps)[1]) == []


def test_everything_wrong_is_listed_at_once(planned, limits):
    document, plan = planned(
        "- chamber: {temperature_c: 99, ramp_c_per_min: 9}\n" + ALIGN + "- navigate: {duration_s: 5}"
    )
    with pytest.raises(DocumentError) as caught:
        check_plan(document, plan, limits)
    lines = [line.split(": ")[0] for line in str(caught.value).splitlines()]
    assert lines == [
        "test.yaml:3:13", "test.yaml:3:32", "test.yaml:4:3", "test.yaml:4:3",
        "test.yaml:5:3", "test.yaml:5:3", "test.yaml:5:14",
    ]  # fmt: skip


def test_a_mistake_in_a_loop_is_listed_once(planned, limits):
    document, plan = planned(
        "- power_on\n- repeat: {over: {n: [1, 2, 3]}, "
        "steps: [{navigate: {duration_s: 600}}, {go_to: {position: z_up}}]}"
    )
    with pytest.raises(DocumentError) as caught:
        check_plan(document, plan, limits)
    assert len(str(caught.value).splitlines()) == 1


def test_a_bracketing_position_and_a_repeated_dwell_are_allowed(planned, limits):
    window = "{navigate: {duration_s: 60}}"
    dwell = f"{{align: {{duration_s: 300}}}}, {window}, {{turn: {{angle_deg: 180}}}}, {window}"
    document, plan = planned(
        "- power_on\n- repeat:\n    over: {position: [z_up, y_up, z_up]}\n"
        f"    steps: [{{go_to: {{position: $position}}}}, {dwell}, {dwell}]\n"
    )
    check_plan(document, plan, limits)
    assert plan.dwell_count == 6


def test_the_procedure_may_end_cold(planned, limits):
    document, plan = planned("- chamber: {temperature_c: -40, ramp_c_per_min: 5}")
    check_plan(document, plan, limits)


@pytest.mark.parametrize(
    "name", ["six_position_fig7", "three_temperature_shift", "ten_minute_check", "calibration_check"]
)
def test_shipped_procedures_can_be_run(limits, shipped, name):
    document, procedure = load_procedure(shipped / f"{name}.yaml")
    check_plan(
        document,
        expand(document, procedure),
        replace(limits, unreachable_reason=lambda position, azimuth_deg, turns_deg: None),
    )


def test_a_temperature_at_which_an_interlock_would_trip_is_refused(planned, limits):
    document, plan = planned(
        "  - power_on\n  - chamber: {temperature_c: 60, ramp_c_per_min: 1}\n  - soak: {for_s: 36000}\n"
    )
    narrow = replace(limits, gyro_low_c=-60.0, gyro_high_c=65.0)
    with pytest.raises(DocumentError, match=r"test.yaml:4:15: the gyros would reach \d+ degC"):
        check_plan(document, plan, narrow)
    check_plan(document, plan, replace(limits, gyro_high_c=95.0))


def test_a_temperature_in_a_loop_is_refused_once(planned, limits):
    document, plan = planned(
        "  - power_on\n"
        "  - repeat:\n"
        "      over: {cycle: [1, 2], temperature_c: [60, 20]}\n"
        "      steps:\n"
        "        - chamber: {temperature_c: $temperature_c, ramp_c_per_min: 1}\n"
        "        - soak: {for_s: 36000}\n"
    )
    with pytest.raises(DocumentError) as refused:
        check_plan(document, plan, replace(limits, gyro_low_c=-60.0, gyro_high_c=65.0))
    assert str(refused.value).count("the gyros would reach") == 1


STATION = Path(__file__).parents[3] / "stations" / "emulated.yaml"


def dwell(position, angles_deg, azimuth_deg=0.0):
    """YAML of one dwell; its go_to stands in line 4, its first turn in line 7 with its angle in column 10."""
    window = "- navigate: {duration_s: 600}\n"
    turns = [f"- turn: {{angle_deg: {angle}}}\n{window}" for angle in angles_deg]
    start = f"- power_on\n- go_to: {{position: {position}, azimuth_deg: {azimuth_deg:g}}}\n"
    return start + "- align: {duration_s: 300}\n" + window + "".join(turns)


@pytest.fixture(scope="module")
def level_outer_axis():
    """The emulated station: outer axis level, inner axis up, both with limits."""
    return Station(STATION).limits()


@pytest.fixture(scope="module")
def outer_axis_up(tmp_path_factory):
    """The same table tipped by 90 deg: the outer axis up, the inner one level."""
    text = STATION.read_text(encoding="utf-8")
    path = tmp_path_factory.mktemp("station") / "up.yaml"
    path.write_text(
        text.replace("outer_axis: east", "outer_axis: up")
        .replace("inner_axis: up", "inner_axis: east")
        .replace("outer_deg: [-200, 200]", "outer_deg: [-380, 380]"),
        encoding="utf-8",
    )
    return Station(path).limits()


def problem(planned, steps, limits):
    document, plan = planned(steps)
    with pytest.raises(DocumentError) as caught:
        check_plan(document, plan, limits)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("position", POSITIONS)
@pytest.mark.parametrize("angle_deg", [180.0, -180.0])
def test_a_level_outer_axis_turns_every_position_by_180_deg_either_way(
    planned, level_outer_axis, position, angle_deg
):
    check_plan(*planned(dwell(position, [angle_deg])), level_outer_axis)
    check_plan(*planned(dwell(position, [angle_deg], azimuth_deg=180.0)), level_outer_axis)


@pytest.mark.parametrize("angle_deg", [90.0, -90.0])
def test_four_azimuths_are_planned_where_an_axis_of_the_table_is_vertical(
    planned, level_outer_axis, outer_axis_up, angle_deg
):
    check_plan(*planned(dwell("z_down", 3 * [angle_deg])), level_outer_axis)
    check_plan(*planned(dwell("y_up", 3 * [angle_deg], azimuth_deg=45.0)), outer_axis_up)


def test_a_turn_out_of_reach_is_named_where_it_stands_with_what_can_be_reached(planned, level_outer_axis):
    message = problem(planned, dwell("x_up", [180.0, 90.0, 90.0]), level_outer_axis)
    assert message.startswith(
        "test.yaml:9:10: x_up at azimuth 0, then turns of 180, 90 deg can't be reached: the table can't reach"
    )
    assert "In x_up the table reaches azimuth 0, 180 deg." in message
    assert message.endswith("This azimuth with its turns can be reached in z_up, z_down")


def test_an_azimuth_out_of_reach_is_named_where_it_stands(planned, level_outer_axis):
    message = problem(planned, dwell("y_up", [180.0], azimuth_deg=90.0), level_outer_axis)
    assert message.startswith("test.yaml:4:27: y_up at azimuth 90 deg can't be reached")
    assert "In y_up the table reaches azimuth 0, 180 deg." in message


def test_a_position_out_of_reach_is_named_where_it_stands(planned, outer_axis_up):
    message = problem(planned, dwell("x_up", [180.0], azimuth_deg=90.0), outer_axis_up)
    assert message.startswith("test.yaml:4:11: x_up at azimuth 90 deg can't be reached")
    assert "can stand" not in message
    assert message.endswith("can be reached in z_up, z_down, y_up, y_down")


def test_the_turn_that_leaves_the_range_of_an_axis_is_named(planned, limits):
    def within_300_deg(position, azimuth_deg, turns_deg):
        angles_deg = list(accumulate(turns_deg, initial=0.0))
        return "beyond its limits" if max(angles_deg) - min(angles_deg) > 300.0 else None

    narrow = replace(limits, unreachable_reason=within_300_deg)
    check_plan(*planned(dwell("z_up", [90.0, 90.0, 90.0])), narrow)
    check_plan(*planned(dwell("z_up", [180.0, -180.0, 180.0])), narrow)
    message = problem(planned, dwell("z_up", [90.0, 90.0, 90.0, 90.0, -90.0]), narrow)
    assert message.startswith("test.yaml:13:10: z_up at azimuth 0, then turns of 90, 90, 90, 90 deg can't be")
    assert "beyond its limits" in message


def test_a_turn_of_a_second_alignment_in_the_same_place_counts_as_well(planned, level_outer_axis):
    again = dwell("z_up", [180.0]).split("\n", 2)[2]
    check_plan(*planned(dwell("z_up", [180.0]) + again), level_outer_axis)
    message = problem(planned, dwell("z_up", [180.0]) + again * 4, level_outer_axis)
    assert "then turns of 180, 180, 180, 180, 180 deg can't be reached" in message
    assert "limits" in message


def test_an_angle_from_a_loop_is_named_where_its_value_stands(planned, level_outer_axis):
    steps = dwell("y_down", []) + (
        "- repeat:\n    over: {angle: [180, 90]}\n    steps:\n"
        "      - turn: {angle_deg: $angle}\n      - navigate: {duration_s: 600}\n"
    )
    message = problem(planned, steps, level_outer_axis)
    assert message.startswith("test.yaml:8:25: y_down at azimuth 0, then turns of 180, 90 deg")
