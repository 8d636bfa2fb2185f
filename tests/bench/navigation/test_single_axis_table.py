import numpy as np
import pytest

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.navigation.table_axes import SingleAxisTable
from gyrobench.bench.station.station import Station

UP, EAST = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
LIMITS = (-380.0, 380.0)


def test_a_table_that_turns_about_up_reaches_the_mounted_position_at_every_azimuth():
    table = SingleAxisTable.about(UP, np.eye(3), LIMITS)
    for azimuth_deg in (0.0, 37.0, 180.0):
        C_nb = POSITIONS["z_up"].C_nb(np.deg2rad(azimuth_deg))
        outer_deg, inner_deg = table.angles(C_nb, (180.0,))
        assert outer_deg == 0.0
        np.testing.assert_allclose(table.attitude(outer_deg, inner_deg), C_nb, atol=1e-12)


@pytest.mark.parametrize("angle_deg", [180.0, -180.0, 90.0])
def test_it_turns_about_up_in_the_sense_asked(angle_deg):
    assert SingleAxisTable.about(UP, np.eye(3), LIMITS).turn((0.0, 10.0), angle_deg) == (
        0.0, pytest.approx(10.0 + angle_deg),
    )  # fmt: skip


@pytest.mark.parametrize("position", ["z_down", "x_up", "x_down", "y_up", "y_down"])
def test_other_positions_need_another_mounting_and_the_message_says_so(position):
    table = SingleAxisTable.about(UP, np.eye(3), LIMITS)
    with pytest.raises(
        DocumentError,
        match=r"a single axis, which points Up\. With .* reaches z_up .*rate_table\.mounting changed",
    ):
        table.angles(POSITIONS[position].C_nb())


@pytest.mark.parametrize("position", POSITIONS)
def test_each_position_is_reached_by_some_mounting(position):
    table = SingleAxisTable.about(UP, POSITIONS[position].C_nb(), LIMITS)
    assert table.angles(POSITIONS[position].C_nb(), (180.0,)) == (0.0, 0.0)


def test_about_a_level_axis_it_reaches_positions_and_can_not_turn_about_up():
    table = SingleAxisTable.about(EAST, np.eye(3), LIMITS)
    assert table.angles(POSITIONS["z_down"].C_nb(np.pi) @ np.eye(3)) is not None
    with pytest.raises(DocumentError, match=r"points East.*no turn about Up"):
        table.turn((0.0, 0.0), 90.0)


def test_a_station_without_an_outer_axis_has_such_a_table():
    station = Station(find_document("stations", "single_axis"))
    assert isinstance(station.table, SingleAxisTable)
    assert station.by_axis_number((0.0, 30.0)) == {2: 30.0}
    assert station.table_axes_of((30.0,)) == (0.0, 30.0)
    limits = station.limits()
    assert limits.unreachable_reason("z_up", 45.0, (180.0,)) is None
    assert "single axis" in limits.unreachable_reason("x_up", 0.0, ())
