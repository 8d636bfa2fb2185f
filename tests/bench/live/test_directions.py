import numpy as np
import pytest

from gyrobench.bench.live.directions import directions
from gyrobench.bench.live.picture_parts import Attitude
from gyrobench.bench.navigation.positions import POSITIONS

WORDS = {"E": "East", "W": "West", "N": "North", "S": "South", "U": "Up", "D": "Down"}


def told(C_nb):
    return directions(Attitude("", 0.0, tuple(tuple(row) for row in C_nb.tolist())))


@pytest.mark.parametrize("name", POSITIONS)
def test_body_axes_are_named_by_where_they_point(name):
    expected = [WORDS[letter] for letter in POSITIONS[name].directions]
    assert [each.split()[1] for each in told(POSITIONS[name].C_nb()).split(", ")] == expected


@pytest.mark.parametrize(
    ("azimuth_deg", "words"),
    [
        (9.0, "x East, y North, z Up"),
        (40.0, "x East-North, y North-West, z Up"),
        (50.0, "x North-East, y West-North, z Up"),
        (-40.0, "x East-South, y North-East, z Up"),
    ],
)
def test_an_axis_between_two_directions_is_named_after_both_the_nearer_one_first(azimuth_deg, words):
    assert told(POSITIONS["z_up"].C_nb(np.radians(azimuth_deg))) == words
