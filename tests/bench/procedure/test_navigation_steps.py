import pytest
from pydantic import ValidationError

from gyrobench.bench.bias.dwell import MIN_DURATION
from gyrobench.bench.procedure.estimate import BenchEstimate
from gyrobench.bench.procedure.steps import (
    MIN_NAVIGATION_S,
    Align,
    GoTo,
    Navigate,
    PowerOn,
    Step,
    Turn,
    Until,
)

ROOM = BenchEstimate.at_rest()
UNTIL = Until(bias_sigma_below_dph=0.002)


def early(**values: float) -> Navigate:
    return Navigate(until=UNTIL, at_most_s=900, **values)


def test_a_navigation_lasts_its_duration_or_its_longest_time() -> None:
    assert Navigate(duration_s=600).expected_s(ROOM) == Navigate(duration_s=600).max_duration_s == 600.0
    assert early(at_least_s=120).expected_s(ROOM) == early().max_duration_s == 900.0


def test_a_navigation_that_may_end_early_has_time_until_its_longest_duration() -> None:
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
    elapsed_s: float, bias_sigma_dph: float, ends: bool
) -> None:
    assert early(at_least_s=120).is_satisfied(elapsed_s, bias_sigma_dph) is ends


def test_a_navigation_of_fixed_duration_does_not_end_early() -> None:
    assert not Navigate(duration_s=600).is_satisfied(599.0, 1e-9)


def test_the_shortest_navigation_is_that_which_leaves_a_window_long_enough_for_a_bias() -> None:
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
def test_what_a_step_does_is_described_in_a_line(step: Step, text: str) -> None:
    assert step.describe() == text


@pytest.mark.parametrize(
    ("azimuth_deg", "angle_deg", "reached_deg"), [(270, 180, 90), (0, -180, 180), (90, -90, 0), (0, 90, 90)]
)
def test_turn_keeps_the_alignment_and_moves_the_azimuth(
    azimuth_deg: float, angle_deg: float, reached_deg: float
) -> None:
    there = GoTo(position="z_up", azimuth_deg=azimuth_deg).after(PowerOn().after(ROOM, 0), 0)
    turned = Turn(angle_deg=angle_deg).after(Align(duration_s=1).after(there, 1), 23.0)
    assert turned.aligned
    assert turned.azimuth_deg == pytest.approx(reached_deg)


@pytest.mark.parametrize("angle_deg", [180, -180])
def test_turn_takes_its_angle_over_its_rate_and_settles(angle_deg: float) -> None:
    assert Turn(angle_deg=angle_deg, rate_dps=10, settle_s=5).expected_s(ROOM) == pytest.approx(23.0)


WRONG = [
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
    (
        Navigate,
        {"until": UNTIL, "at_least_s": 90, "at_most_s": 89},
        r"at_most_s \(89\) is below at_least_s \(90\)",
    ),
    (Navigate, {"until": UNTIL, "at_most_s": 50}, r"at_most_s \(50\) is below at_least_s \(60\)"),
    (
        Navigate,
        {"until": {"bias_sigma_below_dph": 0.0}, "at_most_s": 900},
        "greater than or equal to 0.00001",
    ),
    (
        Navigate,
        {"until": {"bias_sigma_below_dph": -1.0}, "at_most_s": 900},
        "greater than or equal to 0.00001",
    ),
    (Navigate, {"until": {"bias_sigma_below_dph": 11.0}, "at_most_s": 900}, "less than or equal to 10"),
    (Navigate, {"until": {"bias_sigma_below_dph": "1"}, "at_most_s": 900}, "valid number"),
    (Navigate, {"until": {}, "at_most_s": 900}, "'bias_sigma_below_dph' is missing"),
    (Navigate, {"duration_s": 600, "purpose": "verify"}, "'calibration', 'calibration_check' or 'noise'"),
]


@pytest.mark.parametrize(("kind", "values", "message"), WRONG)
def test_a_wrong_value_is_refused_with_what_is_allowed(
    kind: type[Step], values: dict[str, object], message: str
) -> None:
    with pytest.raises(ValidationError, match=message):
        kind.model_validate(values)


def test_an_end_at_the_shortest_time_is_allowed() -> None:
    assert Navigate(until=UNTIL, at_least_s=60, at_most_s=60).max_duration_s == 60.0
