import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.attitude import UP, rotation_matrix
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.navigation.table_axes import TwoAxisTable

EAST, NORTH, _ = np.eye(3)
CARDAN = TwoAxisTable(EAST, UP, np.eye(3))
AZIMUTH = TwoAxisTable(UP, EAST, np.eye(3))
NARROW = TwoAxisTable(EAST, UP, np.eye(3), (-185.0, 185.0), (-185.0, 185.0))


def turned(C_nb, angle_deg):
    return rotation_matrix(UP, np.deg2rad(angle_deg)) @ C_nb


@pytest.mark.parametrize(
    ("position", "expected"),
    [
        ("z_up", (0.0, 0.0)),
        ("z_down", (180.0, 180.0)),
        ("y_up", (90.0, 0.0)),
        ("y_down", (-90.0, 0.0)),
        ("x_up", (-90.0, -90.0)),
        ("x_down", (-90.0, 90.0)),
    ],
)
def test_level_outer_axis_reaches_all_six_positions(position, expected):
    C_nb = POSITIONS[position].C_nb()
    assert CARDAN.angles(C_nb) == expected
    np.testing.assert_allclose(CARDAN.attitude(*expected), C_nb, atol=1e-12)


@pytest.mark.parametrize("angle_deg", [180.0, -180.0])
@pytest.mark.parametrize("table", [CARDAN, NARROW], ids=["unlimited", "narrow"])
@pytest.mark.parametrize("position", POSITIONS)
def test_turned_positions_are_reached_from_a_start_that_leaves_room(table, position, angle_deg):
    C_nb = POSITIONS[position].C_nb()
    start = table.angles(C_nb, turns_deg=[angle_deg])
    end = table.turn(start, angle_deg)
    np.testing.assert_allclose(table.attitude(*start), C_nb, atol=1e-12)
    np.testing.assert_allclose(table.attitude(*end), turned(C_nb, angle_deg), atol=1e-12)
    if table is NARROW:
        assert max(map(abs, (*start, *end))) <= 185.0


@pytest.mark.parametrize(
    ("start", "angle_deg", "end"),
    [
        ((0.0, 0.0), 180.0, (0.0, 180.0)),
        ((0.0, 0.0), -180.0, (0.0, -180.0)),
        ((0.0, 0.0), 37.0, (0.0, 37.0)),
        ((180.0, 180.0), 180.0, (180.0, 0.0)),
        ((180.0, 180.0), -180.0, (180.0, 360.0)),
        ((90.0, 0.0), 180.0, (-90.0, 180.0)),
        ((90.0, 0.0), -180.0, (-90.0, -180.0)),
        ((-90.0, -90.0), 180.0, (90.0, 90.0)),
        ((-90.0, -90.0), -180.0, (90.0, -270.0)),
    ],
)
def test_turn_moves_the_inner_axis_in_the_sense_asked(start, angle_deg, end):
    assert CARDAN.turn(start, angle_deg) == end


def test_level_axes_turn_the_other_way_where_the_limits_want_it():
    assert NARROW.turn((-90.0, -90.0), -180.0) == (90.0, 90.0)


def test_vertical_axis_never_turns_the_other_way():
    with pytest.raises(DocumentError, match="turn of -180 deg from outer 180 deg, inner 180 deg leaves"):
        NARROW.turn((180.0, 180.0), -180.0)
    start = NARROW.angles(POSITIONS["z_down"].C_nb(), turns_deg=[-180.0])
    assert start == (180.0, -180.0)
    assert NARROW.turn(start, -180.0) == (180.0, 0.0)


def test_azimuth_table_turns_by_its_outer_axis_alone():
    for position in ("z_up", "z_down", "y_up", "y_down"):
        for angle_deg in (180.0, -180.0, 90.0, 12.5):
            start = AZIMUTH.angles(POSITIONS[position].C_nb())
            end = AZIMUTH.turn(start, angle_deg)
            assert end == pytest.approx((start[0] + angle_deg, start[1]))
            np.testing.assert_allclose(
                AZIMUTH.attitude(*end), POSITIONS[position].C_nb(np.deg2rad(angle_deg)), atol=1e-9
            )


@pytest.mark.parametrize("position", ["x_up", "x_down"])
def test_azimuth_table_says_which_positions_its_mounting_reaches(position):
    with pytest.raises(DocumentError) as caught:
        AZIMUTH.angles(POSITIONS[position].C_nb())
    message = str(caught.value)
    assert "inner axis (x)" in message
    assert "outer axis (Up)" in message
    assert "reaches z_up, z_down, y_up, y_down;" in message


def test_another_mounting_reaches_the_rest():
    on_edge = TwoAxisTable(UP, EAST, POSITIONS["y_up"].C_nb(np.pi / 2))
    reached = {name for name, position in POSITIONS.items() if on_edge.reaches(position.C_nb())}
    assert {"x_up", "x_down", "y_up", "y_down"} == reached


def test_level_outer_axis_cannot_reach_other_azimuths_with_the_inner_axis_level():
    with pytest.raises(DocumentError, match=r"have to lie at .* deg to the outer axis \(East\)"):
        CARDAN.turn((90.0, 0.0), 45.0)


def test_refuses_angles_beyond_the_limits():
    table = TwoAxisTable(EAST, UP, np.eye(3), (-100.0, 100.0))
    assert table.angles(POSITIONS["y_up"].C_nb()) == (90.0, 0.0)
    with pytest.raises(DocumentError, match=r"can't reach .* within the limits \(outer -100 to 100 deg"):
        table.angles(POSITIONS["z_down"].C_nb())


@pytest.mark.parametrize(
    ("start", "end", "count"),
    [
        ((0.0, 0.0), (0.0, 180.0), 19),
        ((90.0, 0.0), (-90.0, 180.0), 19),
        ((-90.0, -90.0), (90.0, -270.0), 19),
        ((5.0, 7.0), (5.0, -8.0), 3),
        ((5.0, 7.0), (5.0, 7.0), 2),
    ],
)
def test_path_goes_from_attitude_to_attitude_with_both_axes_moving_at_once(start, end, count):
    path = CARDAN.path(start, end)
    assert path.shape == (count, 3, 3)
    for attitude, share in zip(path, np.linspace(0.0, 1.0, count), strict=True):
        expected = CARDAN.attitude(*(a + share * (b - a) for a, b in zip(start, end, strict=True)))
        np.testing.assert_allclose(attitude, expected, atol=1e-12)


@pytest.mark.parametrize("angle_deg", [180.0, -180.0])
def test_path_of_a_turn_about_an_axis_that_is_vertical_is_that_turn(angle_deg):
    path = CARDAN.path((0.0, 0.0), CARDAN.turn((0.0, 0.0), angle_deg))
    for attitude, turned_deg in zip(path, np.linspace(0.0, angle_deg, len(path)), strict=True):
        np.testing.assert_allclose(attitude, turned(np.eye(3), turned_deg), atol=1e-12)


@given(st.floats(-179.9, 180.0), st.floats(-179.9, 180.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_angles_undo_the_attitude_of_any_mounting(outer_deg, inner_deg, heading, mounting):
    frame = rotation_matrix(UP, heading)
    table = TwoAxisTable(frame @ EAST, frame @ UP, rotation_matrix([0.6, 0.0, 0.8], mounting))
    angles = table.angles(table.attitude(outer_deg, inner_deg))
    np.testing.assert_allclose(table.attitude(*angles), table.attitude(outer_deg, inner_deg), atol=1e-9)
    assert all(-180.0 < angle <= 180.0 for angle in angles)
    assert angles == pytest.approx((outer_deg, inner_deg), abs=1e-6)


@pytest.mark.parametrize(
    ("outer", "inner", "C_mount", "message"),
    [
        (EAST, EAST, np.eye(3), "perpendicular unit vectors"),
        (2 * EAST, NORTH, np.eye(3), "perpendicular unit vectors"),
        (EAST, NORTH, -np.eye(3), "right-handed rotation"),
        (EAST, NORTH, np.ones((3, 3)), "right-handed rotation"),
    ],
)
def test_refuses_axes_and_mountings_that_are_none(outer, inner, C_mount, message):
    with pytest.raises(DocumentError, match=message):
        TwoAxisTable(outer, inner, C_mount)
