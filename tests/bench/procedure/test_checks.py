from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from gyrobench.bench.foundations.documents import Document
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.procedure.checks import StationLimits, check_plan, find_problems
from gyrobench.bench.procedure.plan import Plan, expand
from gyrobench.bench.procedure.procedure_file import load_procedure

PlanOf = Callable[[str], tuple[Document, Plan]]

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
def test_what_cannot_work_is_named_with_its_place(
    planned: PlanOf, limits: StationLimits, steps: str, place: str, message: str
) -> None:
    document, plan = planned(steps)
    with pytest.raises(DocumentError, match=message) as caught:
        check_plan(document, plan, limits)
    assert str(caught.value).startswith(f"test.yaml:{place}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("steps", [steps for steps, _, _ in ORDER.values()], ids=ORDER)
def test_order_and_times_are_checked_without_a_station(planned: PlanOf, steps: str) -> None:
    assert len(find_problems(planned(steps)[1])) == 1


@pytest.mark.parametrize("steps", [steps for steps, _, _ in LIMIT.values()], ids=LIMIT)
def test_limits_are_those_of_the_station(planned: PlanOf, limits: StationLimits, steps: str) -> None:
    wide = replace(
        limits, chamber_low_c=-60.0, chamber_high_c=90.0, ramp_max_c_per_min=10.0, table_rate_max_dps=100.0,
        unreachable_reason=lambda position, azimuth_deg, turns_deg: None,
    )  # fmt: skip
    assert find_problems(planned(steps)[1], wide) == []
    assert find_problems(planned(steps)[1]) == []


def test_everything_wrong_is_listed_at_once(planned: PlanOf, limits: StationLimits) -> None:
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


def test_a_mistake_in_a_loop_is_listed_once(planned: PlanOf, limits: StationLimits) -> None:
    document, plan = planned(
        "- power_on\n- repeat: {over: {n: [1, 2, 3]}, "
        "steps: [{navigate: {duration_s: 600}}, {go_to: {position: z_up}}]}"
    )
    with pytest.raises(DocumentError) as caught:
        check_plan(document, plan, limits)
    assert len(str(caught.value).splitlines()) == 1


def test_a_bracketing_position_and_a_repeated_dwell_are_allowed(
    planned: PlanOf, limits: StationLimits
) -> None:
    window = "{navigate: {duration_s: 60}}"
    dwell = f"{{align: {{duration_s: 300}}}}, {window}, {{turn: {{angle_deg: 180}}}}, {window}"
    document, plan = planned(
        "- power_on\n- repeat:\n    over: {position: [z_up, y_up, z_up]}\n"
        f"    steps: [{{go_to: {{position: $position}}}}, {dwell}, {dwell}]\n"
    )
    check_plan(document, plan, limits)
    assert plan.dwell_count == 6


def test_the_procedure_may_end_cold(planned: PlanOf, limits: StationLimits) -> None:
    document, plan = planned("- chamber: {temperature_c: -40, ramp_c_per_min: 5}")
    check_plan(document, plan, limits)


@pytest.mark.parametrize(
    "name", ["six_position_fig7", "three_temperature_shift", "ten_minute_check", "calibration_check"]
)
def test_shipped_procedures_can_be_run(limits: StationLimits, shipped: Path, name: str) -> None:
    document, procedure = load_procedure(shipped / f"{name}.yaml")
    check_plan(
        document,
        expand(document, procedure),
        replace(limits, unreachable_reason=lambda position, azimuth_deg, turns_deg: None),
    )


def test_a_temperature_at_which_an_interlock_would_trip_is_refused(
    planned: PlanOf, limits: StationLimits
) -> None:
    document, plan = planned(
        "  - power_on\n  - chamber: {temperature_c: 60, ramp_c_per_min: 1}\n  - soak: {for_s: 36000}\n"
    )
    narrow = replace(limits, gyro_low_c=-60.0, gyro_high_c=65.0)
    with pytest.raises(DocumentError, match=r"test.yaml:4:15: the gyros would reach \d+ degC"):
        check_plan(document, plan, narrow)
    check_plan(document, plan, replace(limits, gyro_high_c=95.0))


def test_a_temperature_in_a_loop_is_refused_once(planned: PlanOf, limits: StationLimits) -> None:
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
