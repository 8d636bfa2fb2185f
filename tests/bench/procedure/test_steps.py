import math

import pytest
from pydantic import ValidationError

from gyrobench.bench.bias.dwell import MIN_DURATION
from gyrobench.bench.procedure.estimate import BenchEstimate, ThermalEstimate
from gyrobench.bench.procedure.procedure_file import STEP_KINDS
from gyrobench.bench.procedure.rotation_steps import Rotate, Rotation, Spin
from gyrobench.bench.procedure.steps import (
    MIN_NAVIGATION_S,
    RATE_SPAN_S,
    Align,
    AskOperator,
    ChamberOff,
    GoTo,
    Navigate,
    PowerOff,
    PowerOn,
    SetChamber,
    Soak,
    Step,
    Turn,
    Until,
    Wait,
    span,
)

THERMAL = ThermalEstimate(time_constant_s=2000.0, self_heating_c=10.0, air_lag_s=100.0, room_c=20.0)
ROOM = BenchEstimate.at_rest(THERMAL)

UNTIL = Until(bias_sigma_below_dph=0.002)

EVERY_KIND: list[Step] = [
    PowerOn(settle_s=120),
    PowerOff(),
    SetChamber(temperature_c=60, ramp_c_per_min=1.0),
    ChamberOff(),
    Soak(for_s=3600),
    Soak(until_gyro_rate_below_c_per_h=2.0, at_least_s=1800, at_most_s=5400),
    GoTo(position="z_up"),
    Align(duration_s=300),
    Align(until_fine=True, at_most_s=900),
    Navigate(duration_s=600),
    Navigate(until=Until(bias_sigma_below_dph=0.002), at_most_s=900),
    Navigate(duration_s=600, purpose="calibration_check"),
    Turn(angle_deg=180),
    Rotate(rotations=[Rotation(axis="outer", angle_deg=-90)]),
    Spin(axis="inner", rates_dps=[5, 20], turns=2),
    Wait(duration_s=10),
    AskOperator(question="Is the cover closed?"),
]


def test_the_examples_cover_every_kind():
    assert {type(step) for step in EVERY_KIND} == set(STEP_KINDS.values())


@pytest.mark.parametrize("step", EVERY_KIND, ids=lambda step: step.describe())
def test_every_step_has_a_description_and_a_time_limit_beyond_its_expected_end(step):
    expected_s = step.expected_s(ROOM)
    assert 0.0 <= expected_s < step.time_limit_s(expected_s)
    assert len(step.describe()) > 3
    assert "\n" not in step.describe()


@pytest.mark.parametrize("step", EVERY_KIND, ids=lambda step: step.describe())
def test_a_timeout_of_the_procedure_replaces_the_usual_one(step):
    assert step.model_copy(update={"timeout_s": 7.0}).time_limit_s(step.expected_s(ROOM)) == 7.0


@pytest.mark.parametrize("kind", STEP_KINDS.values(), ids=STEP_KINDS)
def test_every_key_is_described(kind):
    assert all(field.description for field in kind.model_fields.values())
    assert kind.__doc__


def test_chamber_takes_its_ramp_and_the_time_for_the_air_to_come_near():
    step = SetChamber(temperature_c=80, ramp_c_per_min=3.0, within_c=1.0)
    # In the ramp the air is 3 degC/min * 100 s = 5 degC behind.
    assert step.expected_s(ROOM) == pytest.approx(20.0 * 60.0 + 100.0 * math.log(5.0))


def test_a_chamber_step_that_is_content_far_from_its_temperature_ends_on_the_ramp():
    half_way = SetChamber(temperature_c=80, ramp_c_per_min=2.0, within_c=30.0).expected_s(ROOM)
    # In the ramp the air is 2 degC/min * 100 s behind.
    assert half_way == pytest.approx(60.0 * (30.0 + 2.0 * 100.0 / 60.0) / 2.0)
    assert SetChamber(temperature_c=60, ramp_c_per_min=2.0, within_c=50.0).expected_s(ROOM) == 0.0


def test_chamber_already_at_its_temperature_takes_no_time():
    assert SetChamber(temperature_c=20, ramp_c_per_min=1.0).expected_s(ROOM) == 0.0


def test_chamber_half_way_is_half_way():
    half_way = SetChamber(temperature_c=80, ramp_c_per_min=1.0).after(ROOM, 1800.0)
    assert half_way.chamber_c == pytest.approx(50.0)


def test_chamber_off_goes_back_to_room_temperature():
    cold = SetChamber(temperature_c=-40, ramp_c_per_min=1.0).after(ROOM, 4000.0)
    off = ChamberOff().after(cold, 0.0)
    assert off.set_point_c is None
    assert off.passed(1e5).gyro_c == pytest.approx(20.0)


def test_soak_lasts_until_the_gyros_settle_within_its_bounds():
    hot = PowerOn().after(SetChamber(temperature_c=80, ramp_c_per_min=100.0).after(ROOM, 36.0), 0.0)
    settling_s = hot.time_until_gyro_rate_s(2.0)
    assert 3600.0 < settling_s < 14_400.0
    assert Soak(until_gyro_rate_below_c_per_h=2.0).expected_s(hot) == settling_s + 0.5 * RATE_SPAN_S
    assert Soak(until_gyro_rate_below_c_per_h=2.0, at_most_s=3600).expected_s(hot) == 3600.0
    assert Soak(until_gyro_rate_below_c_per_h=2.0, at_least_s=14_400).expected_s(hot) == 14_400.0
    assert Soak(for_s=100).expected_s(hot) == 100.0


def test_soak_without_a_fitted_rate_yet_goes_on():
    on = PowerOn().after(ROOM, 0.0)
    assert on.time_until_gyro_rate_s(100.0) == 0.0
    assert Soak(until_gyro_rate_below_c_per_h=100.0).expected_s(on) == 0.9 * RATE_SPAN_S


def test_soak_has_time_until_its_longest_duration():
    step = Soak(until_gyro_rate_below_c_per_h=2.0, at_most_s=5000)
    assert step.time_limit_s(step.expected_s(ROOM)) > 5000.0


def test_power_on_and_align_and_go_to_predict_what_they_leave():
    on = PowerOn().after(ROOM, 0.0)
    there = GoTo(position="y_up", azimuth_deg=90).after(on, 20.0)
    aligned = Align(duration_s=300).after(there, 300.0)
    assert aligned.powered
    assert aligned.aligned
    assert (aligned.position, aligned.azimuth_deg) == ("y_up", 90.0)
    assert not GoTo(position="y_up").after(aligned, 0.0).aligned
    assert not PowerOff().after(aligned, 0.0).aligned
    assert not PowerOff().after(aligned, 0.0).powered


@pytest.mark.parametrize("rate_dps", [0.5, 10.0])
def test_go_to_has_time_to_unwind_two_full_circles(rate_dps):
    step = GoTo(position="z_up", rate_dps=rate_dps, settle_s=5.0)
    assert step.time_limit_s(step.expected_s(ROOM)) > 720.0 / rate_dps + 5.0


WRONG = [
    (Soak, {}, "either for_s or until_gyro_rate_below_c_per_h"),
    (Soak, {"for_s": 5, "until_gyro_rate_below_c_per_h": 2}, "either for_s or until"),
    (Soak, {"for_s": 5, "at_most_s": 9}, "not with for_s"),
    (Soak, {"until_gyro_rate_below_c_per_h": 2, "at_least_s": 9, "at_most_s": 8}, "below at_least_s"),
    (GoTo, {"position": "z_upp"}, "did you mean 'z_up'"),
    (GoTo, {"position": "north"}, "z_up, z_down, y_up, y_down, x_up, x_down"),
    (Wait, {"duration_s": 0}, "greater than 0"),
    (Wait, {"duration_s": -5}, "greater than 0"),
    (Wait, {"duration_s": "600"}, "valid number"),
    (Wait, {"duration_s": 1e7}, "less than or equal to 604800"),
    (Wait, {"duration_s": float("nan")}, "finite"),
    (AskOperator, {"question": "", "answers": ["a"]}, "at least 1"),
    (AskOperator, {"question": "?", "answers": ["a", "a"]}, "must differ"),
    (AskOperator, {"question": "?", "answers": []}, "at least 1"),
    (SetChamber, {"temperature_c": -300, "ramp_c_per_min": 1}, "greater than -273.15"),
    (SetChamber, {"temperature_c": 20, "ramp_c_per_min": 0}, "greater than or equal to 0.001"),
    (Wait, {"duration_s": 5, "timeout_s": 0}, "greater than 0"),
    (Align, {}, "give duration_s"),
    (Align, {"until_fine": True}, "go together"),
    (Align, {"duration_s": 5, "at_most_s": 9}, "go together"),
    (Align, {"duration_s": 9, "until_fine": True, "at_most_s": 5}, "below duration_s"),
    (Align, {"duration_s": 9, "euler_sequence": "xyz"}, "rpy_321"),
    (Turn, {"angle_deg": 0}, "has no effect"),
    (Turn, {"angle_deg": -361}, "greater than or equal to -360"),
    (Navigate, {}, "either duration_s, or until with at_most_s"),
    (Navigate, {"duration_s": 0}, "greater than 0"),
    (Navigate, {"duration_s": 600, "until": UNTIL}, "either duration_s, or until"),
    (Navigate, {"duration_s": 600, "until": UNTIL, "at_most_s": 900}, "either duration_s, or until"),
    (Navigate, {"duration_s": 600, "at_most_s": 900}, "go with until, not with duration_s"),
    (Navigate, {"duration_s": 600, "at_least_s": 60}, "go with until, not with duration_s"),
    (Navigate, {"until": UNTIL}, "needs at_most_s"),
    (Navigate, {"until": UNTIL, "at_least_s": 90}, "needs at_most_s"),
    (Navigate, {"until": UNTIL, "at_least_s": 90, "at_most_s": 89}, r"\(89\) is below at_least_s \(90\)"),
    (Navigate, {"until": UNTIL, "at_most_s": 50}, r"at_most_s \(50\) is below at_least_s \(60\)"),
    (Navigate, {"until": {"bias_sigma_below_dph": 0.0}, "at_most_s": 900}, "or equal to 0.00001"),
    (Navigate, {"until": {"bias_sigma_below_dph": 11.0}, "at_most_s": 900}, "less than or equal to 10"),
    (Navigate, {"until": {"bias_sigma_below_dph": "1"}, "at_most_s": 900}, "valid number"),
    (Navigate, {"until": {}, "at_most_s": 900}, "'bias_sigma_below_dph' is missing"),
    (Navigate, {"duration_s": 600, "purpose": "verify"}, "'calibration', 'calibration_check' or 'noise'"),
]


@pytest.mark.parametrize(("kind", "values", "message"), WRONG)
def test_a_wrong_value_is_refused_with_what_is_allowed(kind, values, message):
    with pytest.raises(ValidationError, match=message):
        kind.model_validate(values)


@pytest.mark.parametrize(
    ("duration_s", "text"), [(45.0, "45 s"), (600.0, "10 min"), (9000.0, "2.5 h"), (0.0, "0 s")]
)
def test_durations_are_written_for_people(duration_s, text):
    assert span(duration_s) == text


def early(**values):
    return Navigate(until=UNTIL, at_most_s=900, **values)


def test_a_navigation_lasts_its_duration_or_its_longest_time():
    assert Navigate(duration_s=600).expected_s(ROOM) == Navigate(duration_s=600).max_duration_s == 600.0
    assert early(at_least_s=120).expected_s(ROOM) == early().max_duration_s == 900.0
    assert Navigate(until=UNTIL, at_least_s=60, at_most_s=60).max_duration_s == 60.0


def test_a_navigation_that_may_end_early_has_time_until_its_longest_duration():
    assert (
        early().time_limit_s(early().expected_s(ROOM)) == Navigate(duration_s=900).time_limit_s(900.0) > 900.0
    )


@pytest.mark.parametrize(
    ("elapsed_s", "bias_sigma_dph", "ends"),
    [
        (119.9, 0.0001, False),
        (120.0, 0.0019, True),
        (120.0, 0.002, False),
        (899.0, 0.5, False),
        (899.0, float("nan"), False),
    ],
)
def test_a_navigation_ends_once_it_was_long_enough_and_the_biases_are_known_well_enough(
    elapsed_s, bias_sigma_dph, ends
):
    assert early(at_least_s=120).is_satisfied(elapsed_s, bias_sigma_dph) is ends


def test_a_navigation_of_fixed_duration_does_not_end_early():
    assert not Navigate(duration_s=600).is_satisfied(599.0, 1e-9)


def test_the_shortest_navigation_is_that_which_leaves_a_window_long_enough_for_a_bias():
    assert MIN_DURATION < MIN_NAVIGATION_S == 60.0
    assert early().at_least_s == MIN_NAVIGATION_S
    assert not early().is_satisfied(MIN_NAVIGATION_S - 1.0, 1e-9)


@pytest.mark.parametrize(
    ("step", "text"),
    [
        (Navigate(duration_s=600), "navigate 10 min"),
        (early(), "navigate until bias sigma below 0.002 deg/h, 15 min at most"),
        (Navigate(duration_s=600, purpose="calibration_check"), "navigate 10 min for a calibration check"),
        (Align(duration_s=300), "align 5 min"),
        (Align(until_fine=True, at_most_s=900), "align until fine, 15 min at most"),
        (Turn(angle_deg=-180), "turn -180 deg"),
    ],
)
def test_what_a_step_does_is_described_in_a_line(step, text):
    assert step.describe() == text


@pytest.mark.parametrize(
    ("azimuth_deg", "angle_deg", "reached_deg"), [(270, 180, 90), (0, -180, 180), (90, -90, 0), (0, 90, 90)]
)
def test_turn_keeps_the_alignment_and_moves_the_azimuth(azimuth_deg, angle_deg, reached_deg):
    there = GoTo(position="z_up", azimuth_deg=azimuth_deg).after(PowerOn().after(ROOM, 0), 0)
    turned = Turn(angle_deg=angle_deg).after(Align(duration_s=1).after(there, 1), 23.0)
    assert turned.aligned
    assert turned.azimuth_deg == pytest.approx(reached_deg)


@pytest.mark.parametrize("angle_deg", [180, -180])
def test_turn_takes_its_angle_over_its_rate_and_settles(angle_deg):
    assert Turn(angle_deg=angle_deg, rate_dps=10, settle_s=5).expected_s(ROOM) == pytest.approx(23.0)
