import math

import pytest

from gyrobench.bench.bias.plateaus import group_stops, mean_c, passes_of_stops
from tests.bench.bias.dwell_rows import dwell_row


def numbers(stops):
    return [[row.dwell for row in stop] for stop in stops]


@pytest.mark.parametrize("change", [{"cycle": 2}, {"run": "2"}, {"set_c": 40.0}])
def test_another_cycle_power_on_or_set_point_begins_another_stop(change):
    rows = [dwell_row(1, "z_up", 30.0), dwell_row(2, "z_down", 30.0), dwell_row(3, "y_up", 30.0, **change)]
    assert numbers(group_stops(rows, 5.0)) == [[1, 2], [3]]


def test_a_visit_later_on_is_another_stop():
    rows = [dwell_row(1, "z_up", 30.0), dwell_row(2, "z_up", 50.0, set_c=40.0), dwell_row(3, "z_up", 30.0)]
    assert numbers(group_stops(rows, 5.0)) == [[1], [2], [3]]


def test_a_ramp_is_cut_where_the_gyros_leave_the_range():
    rows = [dwell_row(n, "z_up", gyro_c) for n, gyro_c in enumerate((30.0, 33.0, 34.9, 35.1, 39.0), 1)]
    assert numbers(group_stops(rows, 5.0)) == [[1, 2, 3], [4, 5]]


def test_a_temperature_or_set_point_that_is_not_known_cuts_nothing():
    rows = [
        dwell_row(n, "z_up", gyro_c, set_c=math.nan) for n, gyro_c in enumerate((30.0, math.nan, 31.0), 1)
    ]
    assert numbers(group_stops(rows, 5.0)) == [[1, 2, 3]]


def test_the_rounding_of_a_mean_set_point_cuts_nothing():
    rows = [dwell_row(1, "z_up", 30.0, set_c=20.0), dwell_row(2, "z_down", 30.0, set_c=20.0 + 1e-9)]
    assert numbers(group_stops(rows, 5.0)) == [[1, 2]]


def test_stops_of_one_set_point_and_warmth_with_a_position_in_common_are_passes_of_one():
    first = [dwell_row(1, "z_up", 30.0), dwell_row(2, "z_down", 32.0)]
    again = [dwell_row(3, "z_down", 33.0, cycle=2), dwell_row(4, "y_up", 33.0, cycle=2)]
    third = [dwell_row(5, "y_up", 31.0, cycle=3), dwell_row(6, "x_up", 31.0, cycle=3)]
    assert mean_c(first, 0) == 31.0
    assert sorted(numbers(passes_of_stops([first, third, again], 0)[0])) == [[1, 2], [3, 4], [5, 6]]
    assert len(passes_of_stops([first, third], 0)) == 2


@pytest.mark.parametrize("other", [{"gyro_c": 45.0}, {"gyro_c": 30.0, "set_c": 40.0}])
def test_other_warmth_or_another_set_point_is_another_stop(other):
    stops = [[dwell_row(1, "z_up", 30.0)], [dwell_row(2, "z_up", **other)]]
    assert len(passes_of_stops(stops, 0)) == 2
