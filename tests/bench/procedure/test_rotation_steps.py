"""Steps that rotate about the table's axes: durations, limits, order, rooms within the limits of the axes."""

import pytest

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.procedure.checks import find_problems
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.station.station import Station

HEAD = """  - power_on
  - go_to: {position: z_up}
  - align: {duration_s: 60}
"""
ROTATE = (
    "  - rotate: {rotations: [{axis: outer, angle_deg: 90}, {axis: inner, angle_deg: -180}], rate_dps: 10}\n"
)
SPIN = "  - spin: {axis: inner, turns: 2, rates_dps: [5, 20]}\n"


def test_rotations_and_spins_after_one_alignment_are_one_dwell(planned):
    _, plan = planned(HEAD + ROTATE + SPIN + "  - power_off\n")
    assert [each.dwell for each in plan.steps] == [None, None, 1, 1, 1, None]
    assert [each.purpose for each in plan.steps[2:5]] == [DwellPurpose.ROTATIONS] * 3
    rotate, spin = plan.steps[3:5]
    assert rotate.duration_s == pytest.approx(9.0 + 18.0 + 2 * (5.0 + 3.0) + 3 * 60.0)
    assert spin.duration_s == pytest.approx(2 * 720.0 / 5.0 + 2 * 720.0 / 20.0 + 4 * 8.0 + 5 * 60.0)
    assert spin.after.position is None


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ("  - power_on\n  - go_to: {position: z_up}\n" + SPIN, "spin needs an aligned INS"),
        (HEAD + "  - navigate: {duration_s: 600}\n" + ROTATE, "navigate has no place beside rotate and spin"),
        (HEAD + ROTATE + "  - align: {duration_s: 60}\n" + SPIN, "align needs a position"),
        (HEAD + SPIN.replace("20]", "61]"), "a rate of 61 deg/s is too fast for the table"),
        (HEAD + ROTATE.replace("rate_dps: 10", "rate_dps: 61"), "a rate of 61 deg/s is too fast"),
    ],
)
def test_what_can_not_work_is_found_before_anything_moves(planned, limits, steps, message):
    _, plan = planned(steps)
    found = [problem.message for problem in find_problems(plan, limits)]
    assert any(message in text for text in found), found


@pytest.mark.parametrize(
    ("steps", "problem"),
    [
        (SPIN, ""),
        (SPIN.replace("turns: 2", "turns: 3"), "turns of inner 1080 deg can't be reached"),
        (SPIN.replace("inner", "outer"), "turns of outer 720 deg can't be reached"),
        ("  - rotate: {rotations: [{axis: inner, angle_deg: 270}, {axis: inner, angle_deg: 270}]}\n", ""),
        (
            "  - rotate: {rotations: [{axis: outer, angle_deg: 270}, {axis: outer, angle_deg: 180}]}\n",
            "outer 270",
        ),
    ],
)
def test_an_axis_starts_where_all_rotations_stay_within_its_limits(planned, steps, problem):
    station = Station(find_document("stations", "emulated"))
    _, plan = planned(HEAD + steps)
    found = [each.message for each in find_problems(plan, station.limits())]
    assert (not found) == (not problem), found
    assert problem in " ".join(found)


@pytest.mark.parametrize("text", ["angle_deg: 0", "angle_deg: 400", "axis: third, angle_deg: 90"])
def test_a_rotation_that_is_none_is_refused_with_its_place(planned, text):
    axis = "" if "axis" in text else "axis: inner, "
    with pytest.raises(Exception, match=r"test.yaml:6:\d+"):
        planned(HEAD + f"  - rotate: {{rotations: [{{{axis}{text}}}]}}\n")


def test_the_shipped_rotations_suit_the_emulated_station():
    station = Station(find_document("stations", "emulated"))
    document, model = load_procedure(find_document("procedures", "rotations"))
    plan = station.plan(document, model)
    assert [
        len(each.step.moves())
        for each in plan.steps
        if each.purpose is DwellPurpose.ROTATIONS and each.step.name in ("rotate", "spin")
    ] == [18, 6]
