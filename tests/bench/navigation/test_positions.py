import numpy as np
import pytest

from gyrobench.bench.navigation.positions import POSITIONS, half_turn_pairs

EAST, NORTH, UP = np.eye(3)

# Body x, y, z at azimuth 0, from the signs of the paper's equations (10), (12) to (16).
EXPECTED = {
    "z_up": (EAST, NORTH, UP),
    "z_down": (-EAST, NORTH, -UP),
    "y_up": (EAST, UP, -NORTH),
    "y_down": (EAST, -UP, NORTH),
    "x_up": (UP, EAST, NORTH),
    "x_down": (-UP, -EAST, NORTH),
}


def test_six_positions_in_the_order_of_the_paper():
    assert list(POSITIONS) == list(EXPECTED)


@pytest.mark.parametrize("name", EXPECTED)
def test_attitude_at_azimuth_zero(name):
    C_nb = POSITIONS[name].C_nb()
    np.testing.assert_array_equal(C_nb, np.array(EXPECTED[name]).T)
    assert np.linalg.det(C_nb) == pytest.approx(1.0)


@pytest.mark.parametrize("name", EXPECTED)
def test_name_says_which_axis_is_vertical(name):
    position = POSITIONS[name]
    axis, way = name.split("_")
    assert "xyz"[position.up_axis] == axis
    assert position.up_sign == (1 if way == "up" else -1)
    assert position.C_nb()[2, position.up_axis] == position.up_sign


@pytest.mark.parametrize("name", EXPECTED)
def test_azimuth_turns_about_up(name):
    quarter = POSITIONS[name].C_nb(np.pi / 2)
    still, turned = POSITIONS[name].C_nb()[2], quarter[2]
    np.testing.assert_allclose(turned, still, atol=1e-15)
    np.testing.assert_allclose(quarter[1], POSITIONS[name].C_nb()[0], atol=1e-15)


def test_each_is_paired_with_the_first_one_half_a_turn_away_that_fits():
    placed = [("a", 0.0), ("a", 10.0), ("b", 180.0), ("a", 540.2), ("a", 180.0), ("a", 191.0)]
    pairs = half_turn_pairs(placed, lambda each: each[1], lambda one, other: one[0] == other[0])
    assert pairs[0] == (placed[0], placed[3])
    assert pairs[1:] == [(each, None) for each in (placed[1], placed[2], placed[4], placed[5])]
    assert half_turn_pairs(placed[:3], lambda each: each[1])[0] == (placed[0], placed[2])
