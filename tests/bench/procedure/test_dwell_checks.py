"""Dwells that give no result, and calibration checks without a partner."""

import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.procedure.checks import check_plan

# Lines 3 to 5; what follows begins in line 6.
GO_TO = "- go_to: {position: z_up}\n"
ALIGN = "- align: {duration_s: 300}\n"
START = "- power_on\n" + GO_TO + ALIGN
WINDOW = "- navigate: {duration_s: 600}\n"
SHORT = "- navigate: {duration_s: 59}\n"
VERIFY = "- navigate: {duration_s: 600, purpose: calibration_check}\n"
UNTIL = "- navigate: {until: {bias_sigma_below_dph: 0.002}, at_least_s: 120, at_most_s: 900}\n"
TURN = "- turn: {angle_deg: 180}\n"
QUARTER = "- turn: {angle_deg: 90}\n"
WAIT = "- wait: {duration_s: 5}\n"
#: What a calibration check at azimuth 0 needs beside it.
OPPOSITE = GO_TO.replace("z_up", "z_up, azimuth_deg: 180") + ALIGN + VERIFY

NO_TURN = (
    "no turn: biases and initial errors can't be separated. "
    "Add a turn and a second navigation, or set purpose: calibration_check"
)
TURNED_CHECK = "directly after the alignment, without a turn before or after it"

WRONG = {
    "too short": (WINDOW + TURN + SHORT, "8:14", "59 s is too short .* 60 s or more"),
    "may end too soon": (WINDOW + TURN + UNTIL.replace("120", "30"), "8:52", "30 s is too short"),
    "calibration check too short": (VERIFY.replace("600", "30") + OPPOSITE, "6:14", "30 s is too short"),
    "loop value too short": (
        "- repeat: {over: {t: [90, 30]}, steps: [{navigate: {duration_s: $t}}, {turn: {angle_deg: 180}}]}",
        "6:27",
        "30 s is too short",
    ),
    "no turn": (WINDOW, "6:3", NO_TURN),
    "purpose calibration, no turn": (
        "- navigate: {duration_s: 600, purpose: calibration}", "6:3", "no turn: .*calibration_check",
    ),
    "no turn before another dwell": (WINDOW + GO_TO + ALIGN + WINDOW + TURN + WINDOW, "6:3", NO_TURN),
    "nothing after the turn": (WINDOW + TURN, "6:3", "one side of the turn only"),
    "nothing after the turn and a wait": (WINDOW + WAIT + TURN, "6:3", "one side of the turn only"),
    "nothing before the turn": (TURN + WINDOW, "7:3", "Navigate before and after the turn"),
    "two navigations": (WINDOW + WINDOW + TURN + WINDOW, "7:3", "Put a turn between them, or make"),
    "a wait between two": (WINDOW + TURN + WINDOW + WAIT + WINDOW, "10:3", "or make one longer$"),
    "two navigations without any turn": (WINDOW + WINDOW, "7:3", "succession. Put a turn between them$"),
    "full circle": (
        WINDOW + "- turn: {angle_deg: 360}\n" + WINDOW, "7:10", "all navigations are at azimuth 0 deg",
    ),
    "there and back": (WINDOW + TURN + "- turn: {angle_deg: -180}\n" + WINDOW, "8:10", "full circle"),
    "calibration check before a turn": (VERIFY + TURN + OPPOSITE, "6:31", TURNED_CHECK),
    "calibration check before a wait and a turn": (VERIFY + WAIT + TURN + OPPOSITE, "6:31", TURNED_CHECK),
    "calibration check before a turn and a navigation": (VERIFY + TURN + WINDOW, "6:31", TURNED_CHECK),
    "calibration check after a turn": (WINDOW + TURN + VERIFY, "8:31", TURNED_CHECK),
    "calibration check after a turn alone": (TURN + VERIFY, "7:31", TURNED_CHECK),
    "calibration check twice": (VERIFY + VERIFY, "7:3", "a calibration check has a single one"),
    "until before the turn": (UNTIL + TURN + WINDOW, "6:14", "until needs a navigation and a turn before it"),
    "until in a calibration check": (
        "- navigate: {purpose: calibration_check, until: {bias_sigma_below_dph: 1}, at_most_s: 900}\n"
        + OPPOSITE,
        "6:42",
        "Use duration_s",
    ),
    "alignment interrupted": ("- soak: {for_s: 5}\n" + WINDOW, "7:3", "belongs to no dwell"),
}  # fmt: skip


@pytest.mark.parametrize(("steps", "place", "message"), WRONG.values(), ids=WRONG)
def test_what_gives_no_bias_is_named_with_its_place(planned, steps, place, message):
    document, plan = planned(START + steps)
    with pytest.raises(DocumentError, match=message) as caught:
        check_plan(document, plan)
    assert str(caught.value).startswith(f"test.yaml:{place}: ")
    assert "\n" not in str(caught.value)


def test_a_dwell_that_is_interrupted_is_reported_on_both_sides(planned):
    document, plan = planned(START + WINDOW + "- soak: {for_s: 5}\n" + TURN + WINDOW)
    with pytest.raises(DocumentError) as caught:
        check_plan(document, plan)
    first, second = str(caught.value).splitlines()
    assert first == f"test.yaml:6:3: {NO_TURN}"
    assert second.startswith("test.yaml:9:3: this navigation belongs to no dwell")


GOOD = {
    "the paper's": WINDOW + TURN + WINDOW,
    "turned back": WINDOW + TURN.replace("180", "-180") + WINDOW,
    "four azimuths": WINDOW + 3 * (QUARTER + WINDOW),
    "four azimuths, the other way": WINDOW + 3 * (QUARTER.replace("90", "-90") + WINDOW),
    "there and back": WINDOW + TURN + WINDOW + TURN.replace("180", "-180") + WINDOW,
    "until after the turn": WINDOW + TURN + UNTIL,
    "until in each window after a turn": WINDOW + 3 * (QUARTER + UNTIL),
    "two turns between": WINDOW + QUARTER + QUARTER + WINDOW,
    "a turn before and one between": QUARTER + WINDOW + TURN + WINDOW,
    "a turn back at the end": WINDOW + TURN + WINDOW + TURN,
    "waits": WAIT + WINDOW + WAIT + TURN + WAIT + WINDOW + WAIT,
    "calibration check": VERIFY + OPPOSITE,
    "calibration check with waits": WAIT + VERIFY + WAIT + OPPOSITE,
    "an alignment without navigation": "",
}


@pytest.mark.parametrize("steps", GOOD.values(), ids=GOOD)
def test_what_gives_a_bias_or_verifies_one_is_allowed(planned, steps):
    document, plan = planned(START + steps)
    check_plan(document, plan)


POWER_ON = "- power_on\n"
HOT, COLD = (f"- chamber: {{temperature_c: {c}, ramp_c_per_min: 1}}\n" for c in (60, -20))


def verify(position, azimuth_deg):
    """Three lines."""
    return (
        f"- go_to: {{position: {position}, azimuth_deg: {azimuth_deg}}}\n"
        "- align: {duration_s: 300}\n"
        "- navigate: {duration_s: 600, purpose: calibration_check}\n"
    )


def loop(variables, body):
    """Put steps into a loop that begins in the line after it."""
    return f"- repeat:\n    over: {{{variables}}}\n    steps:\n" + "".join(
        f"      {line}\n" for line in body.splitlines()
    )


IN_LOOP = verify("$position", "$azimuth_deg")

ALONE = {
    "one": (verify("z_up", 0), ["6:31 z_up 180"]),
    "the way back is not half a turn": (
        verify("z_up", 30) + verify("z_up", -30),
        ["6:31 z_up 210", "9:31 z_up 150"],
    ),
    "a quarter of a turn": (verify("z_up", 0) + verify("z_up", 90), ["6:31 z_up 180", "9:31 z_up 270"]),
    "twice the same": (verify("z_up", 0) + verify("z_up", 0), ["6:31 z_up 180", "9:31 z_up 180"]),
    "the third of three": (verify("z_up", 0) + verify("z_up", 180) + verify("z_up", 0), ["12:31 z_up 180"]),
    "another position": (verify("z_up", 0) + verify("y_up", 180), ["6:31 z_up 180", "9:31 y_up 0"]),
    "another temperature": (verify("z_up", 0) + HOT + verify("z_up", 180), ["6:31 z_up 180", "10:31 z_up 0"]),
    "there and back to the same temperature": (
        HOT + verify("z_up", 0) + COLD + HOT + verify("z_up", 180),
        ["7:31 z_up 180", "12:31 z_up 0"],
    ),
    "another power-on": (
        verify("z_up", 0) + "- power_off\n- power_on\n" + verify("z_up", 180),
        ["6:31 z_up 180", "11:31 z_up 0"],
    ),
    "another cycle": (
        loop("cycle: [1]", verify("z_up", 0)) + loop("cycle: [2]", verify("z_up", 180)),
        ["9:37 z_up 180", "15:37 z_up 0"],
    ),
    "one side in a loop": (
        loop("position: [z_up, y_up], azimuth_deg: [0]", IN_LOOP),
        ["9:37 y_up 180", "9:37 z_up 180"],
    ),
}


@pytest.mark.parametrize(("steps", "expected"), ALONE.values(), ids=ALONE)
def test_a_verification_without_one_half_a_turn_away_is_reported_with_what_to_add(planned, steps, expected):
    document, plan = planned(POWER_ON + steps)
    with pytest.raises(DocumentError) as caught:
        check_plan(document, plan)
    lines = str(caught.value).splitlines()
    for line, place_position_azimuth in zip(lines, expected, strict=True):
        place, position, azimuth_deg = place_position_azimuth.split()
        assert line.startswith(f"test.yaml:{place}: a single alignment includes the table's azimuth error")
        assert f"Add the same position ({position}) at azimuth {azimuth_deg} deg" in line


PAIRED = {
    "two": verify("z_up", 0) + verify("z_up", 180),
    "the other way round": verify("z_up", -90) + verify("z_up", 90),
    "near enough": verify("z_up", 0.2) + verify("z_up", 180),
    "two pairs across": verify("z_up", 0) + verify("z_up", 90) + verify("z_up", 180) + verify("z_up", 270),
    "another position between": verify("z_up", 0)
    + verify("y_up", 0)
    + verify("z_up", 180)
    + verify("y_up", 180),
    "the chamber set to the same again": HOT + verify("z_up", 0) + HOT + verify("z_up", 180),
    "cycles inside the azimuths": loop(
        "azimuth_deg: [0, 180], cycle: [1, 2]", verify("z_up", "$azimuth_deg")
    ),
    "azimuths of each position": loop("position: [z_up, y_up], azimuth_deg: [0, 180]", IN_LOOP),
    "positions at each azimuth": loop("azimuth_deg: [0, 180], position: [z_up, y_up]", IN_LOOP),
}


@pytest.mark.parametrize("steps", PAIRED.values(), ids=PAIRED)
def test_verifications_in_pairs_half_a_turn_apart_are_allowed(planned, steps):
    document, plan = planned(POWER_ON + steps)
    check_plan(document, plan)
