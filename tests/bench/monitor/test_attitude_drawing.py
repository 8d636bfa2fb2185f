import numpy as np
import pytest

from gyrobench.bench.monitor.attitude_drawing import SIZE, axes_drawing
from gyrobench.bench.monitor.snapshot import Attitude
from gyrobench.bench.navigation.positions import POSITIONS


def drawing_of(C_nb):
    return axes_drawing(Attitude("", 0.0, tuple(tuple(row) for row in C_nb.tolist())))


def tips(drawing):
    return {arrow.label: arrow.tip for arrow in (*drawing.behind, *drawing.before)}


def test_the_drawing_says_the_same_in_words():
    assert drawing_of(POSITIONS["z_down"].C_nb()).description == "x West, y North, z Down"


def test_the_body_stands_as_the_world_where_it_is_level_and_points_north():
    found = tips(drawing_of(POSITIONS["z_up"].C_nb()))
    middle = np.full(2, SIZE / 2.0)
    for body, world in zip("xyz", "ENU", strict=True):
        along, reference = (np.array(found[label]) - middle for label in (body, world))
        cosine = along @ reference / np.linalg.norm(along) / np.linalg.norm(reference)
        assert cosine > 0.95


def test_up_is_above_east_to_the_right_and_north_away():
    drawing = drawing_of(POSITIONS["z_up"].C_nb())
    found = tips(drawing)
    assert found["U"][1] < SIZE / 4.0
    assert found["E"][0] > SIZE / 2.0
    assert {arrow.label for arrow in drawing.behind} == {"N", "y"}


@pytest.mark.parametrize("position", POSITIONS)
@pytest.mark.parametrize("azimuth_deg", range(0, 360, 30))
def test_all_of_it_is_inside_the_drawing(position, azimuth_deg):
    drawing = drawing_of(POSITIONS[position].C_nb(np.radians(azimuth_deg)))
    arrows = [*drawing.behind, *drawing.before]
    places = [arrow.label_position for arrow in arrows] + [arrow.tip for arrow in arrows]
    shapes = (*drawing.box, *drawing.floor)
    places += [tuple(map(float, point.split(","))) for shape in shapes for point in shape.split()]
    assert all(4.0 < coordinate < SIZE - 4.0 for place in places for coordinate in place)
    assert len(arrows) == 6
    assert len(drawing.box) == 6


@pytest.mark.parametrize("position", POSITIONS)
def test_labels_of_a_position_are_apart(position):
    arrows = drawing_of(POSITIONS[position].C_nb())
    labels = [np.array(arrow.label_position) for arrow in (*arrows.behind, *arrows.before)]
    apart = [np.linalg.norm(one - other) for index, one in enumerate(labels) for other in labels[:index]]
    assert min(apart) > 10.0
