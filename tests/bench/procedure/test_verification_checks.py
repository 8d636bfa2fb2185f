from collections.abc import Callable

import pytest

from gyrobench.bench.foundations.documents import Document
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.procedure.checks import check_plan
from gyrobench.bench.procedure.plan import Plan

PlanOf = Callable[[str], tuple[Document, Plan]]

POWER_ON = "- power_on\n"
HOT, COLD = (f"- chamber: {{temperature_c: {c}, ramp_c_per_min: 1}}\n" for c in (60, -20))


def verify(position: str, azimuth_deg: float | str) -> str:
    """Three lines."""
    return (
        f"- go_to: {{position: {position}, azimuth_deg: {azimuth_deg}}}\n"
        "- align: {duration_s: 300}\n"
        "- navigate: {duration_s: 600, purpose: calibration_check}\n"
    )


def loop(variables: str, body: str) -> str:
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
def test_a_verification_without_one_half_a_turn_away_is_reported_with_what_to_add(
    planned: PlanOf, steps: str, expected: list[str]
) -> None:
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
def test_verifications_in_pairs_half_a_turn_apart_are_allowed(planned: PlanOf, steps: str) -> None:
    document, plan = planned(POWER_ON + steps)
    check_plan(document, plan)
