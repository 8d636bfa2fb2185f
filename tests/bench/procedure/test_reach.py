from collections.abc import Callable
from dataclasses import replace
from itertools import accumulate
from pathlib import Path

import pytest

from gyrobench.bench.foundations.documents import Document
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.checks import StationLimits, check_plan
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.station.station import Station

PlanOf = Callable[[str], tuple[Document, Plan]]

STATION = Path(__file__).parents[3] / "stations" / "emulated.yaml"


def dwell(position: str, angles_deg: list[float], azimuth_deg: float = 0.0) -> str:
    """YAML of one dwell; its go_to stands in line 4, its first turn in line 7 with its angle in column 10."""
    window = "- navigate: {duration_s: 600}\n"
    turns = [f"- turn: {{angle_deg: {angle}}}\n{window}" for angle in angles_deg]
    start = f"- power_on\n- go_to: {{position: {position}, azimuth_deg: {azimuth_deg:g}}}\n"
    return start + "- align: {duration_s: 300}\n" + window + "".join(turns)


@pytest.fixture(scope="module")
def level_outer_axis() -> StationLimits:
    """The emulated station: outer axis level, inner axis up, both with limits."""
    return Station(STATION).limits()


@pytest.fixture(scope="module")
def outer_axis_up(tmp_path_factory: pytest.TempPathFactory) -> StationLimits:
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


def problem(planned: PlanOf, steps: str, limits: StationLimits) -> str:
    document, plan = planned(steps)
    with pytest.raises(DocumentError) as caught:
        check_plan(document, plan, limits)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("position", POSITIONS)
@pytest.mark.parametrize("angle_deg", [180.0, -180.0])
def test_a_level_outer_axis_turns_every_position_by_180_deg_either_way(
    planned: PlanOf, level_outer_axis: StationLimits, position: str, angle_deg: float
) -> None:
    check_plan(*planned(dwell(position, [angle_deg])), level_outer_axis)
    check_plan(*planned(dwell(position, [angle_deg], azimuth_deg=180.0)), level_outer_axis)


@pytest.mark.parametrize("angle_deg", [90.0, -90.0])
def test_four_azimuths_are_planned_where_an_axis_of_the_table_is_vertical(
    planned: PlanOf, level_outer_axis: StationLimits, outer_axis_up: StationLimits, angle_deg: float
) -> None:
    check_plan(*planned(dwell("z_down", 3 * [angle_deg])), level_outer_axis)
    check_plan(*planned(dwell("y_up", 3 * [angle_deg], azimuth_deg=45.0)), outer_axis_up)


def test_a_turn_out_of_reach_is_named_where_it_stands_with_what_can_be_reached(
    planned: PlanOf, level_outer_axis: StationLimits
) -> None:
    message = problem(planned, dwell("x_up", [180.0, 90.0, 90.0]), level_outer_axis)
    assert message.startswith(
        "test.yaml:9:10: x_up at azimuth 0, then turns of 180, 90 deg can't be reached: the table can't reach"
    )
    assert "In x_up the table reaches azimuth 0, 180 deg." in message
    assert message.endswith("This azimuth with its turns can be reached in z_up, z_down")


def test_an_azimuth_out_of_reach_is_named_where_it_stands(
    planned: PlanOf, level_outer_axis: StationLimits
) -> None:
    message = problem(planned, dwell("y_up", [180.0], azimuth_deg=90.0), level_outer_axis)
    assert message.startswith("test.yaml:4:27: y_up at azimuth 90 deg can't be reached")
    assert "In y_up the table reaches azimuth 0, 180 deg." in message


def test_a_position_out_of_reach_is_named_where_it_stands(
    planned: PlanOf, outer_axis_up: StationLimits
) -> None:
    message = problem(planned, dwell("x_up", [180.0], azimuth_deg=90.0), outer_axis_up)
    assert message.startswith("test.yaml:4:11: x_up at azimuth 90 deg can't be reached")
    assert "can stand" not in message
    assert message.endswith("can be reached in z_up, z_down, y_up, y_down")


def test_the_turn_that_leaves_the_range_of_an_axis_is_named(planned: PlanOf, limits: StationLimits) -> None:
    def within_300_deg(position: str, azimuth_deg: float, turns_deg: tuple[float, ...]) -> str | None:
        angles_deg = list(accumulate(turns_deg, initial=0.0))
        return "beyond its limits" if max(angles_deg) - min(angles_deg) > 300.0 else None

    narrow = replace(limits, unreachable_reason=within_300_deg)
    check_plan(*planned(dwell("z_up", [90.0, 90.0, 90.0])), narrow)
    check_plan(*planned(dwell("z_up", [180.0, -180.0, 180.0])), narrow)
    message = problem(planned, dwell("z_up", [90.0, 90.0, 90.0, 90.0, -90.0]), narrow)
    assert message.startswith("test.yaml:13:10: z_up at azimuth 0, then turns of 90, 90, 90, 90 deg can't be")
    assert "beyond its limits" in message


def test_a_turn_of_a_second_alignment_in_the_same_place_counts_as_well(
    planned: PlanOf, level_outer_axis: StationLimits
) -> None:
    again = dwell("z_up", [180.0]).split("\n", 2)[2]
    check_plan(*planned(dwell("z_up", [180.0]) + again), level_outer_axis)
    message = problem(planned, dwell("z_up", [180.0]) + again * 4, level_outer_axis)
    assert "then turns of 180, 180, 180, 180, 180 deg can't be reached" in message
    assert "limits" in message


def test_an_angle_from_a_loop_is_named_where_its_value_stands(
    planned: PlanOf, level_outer_axis: StationLimits
) -> None:
    steps = dwell("y_down", []) + (
        "- repeat:\n    over: {angle: [180, 90]}\n    steps:\n"
        "      - turn: {angle_deg: $angle}\n      - navigate: {duration_s: 600}\n"
    )
    message = problem(planned, steps, level_outer_axis)
    assert message.startswith("test.yaml:8:25: y_down at azimuth 0, then turns of 180, 90 deg")
