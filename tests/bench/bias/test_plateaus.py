import math

import pytest

from gyrobench.bench.bias.plateaus import PlannedDwell, group_plateaus, mean_c, passes_of_plateaus
from tests.bench.bias.dwell_rows import dwell_row


def numbers(plateaus):
    return [[row.dwell for row in plateau] for plateau in plateaus]


def rows_at(*gyro_c):
    return [dwell_row(number, "z_up", each) for number, each in enumerate(gyro_c, 1)]


@pytest.mark.parametrize("change", [{"cycle": 2}, {"run": "2"}, {"set_c": 40.0}])
def test_another_cycle_power_cycle_or_set_point_begins_another_plateau(change):
    rows = [dwell_row(1, "z_up", 30.0), dwell_row(2, "z_down", 30.0), dwell_row(3, "y_up", 30.0, **change)]
    assert numbers(group_plateaus(rows)) == [[1, 2], [3]]


def test_a_later_visit_is_another_plateau():
    rows = [dwell_row(1, "z_up", 30.0), dwell_row(2, "z_up", 50.0, set_c=40.0), dwell_row(3, "z_up", 30.0)]
    assert numbers(group_plateaus(rows)) == [[1], [2], [3]]


def test_a_ramp_is_divided_where_the_gyros_leave_the_mean_of_the_plateau():
    assert numbers(group_plateaus(rows_at(30.0, 33.0, 34.9, 35.1, 39.0))) == [[1, 2, 3, 4], [5]]


def test_planned_temperatures_belong_together_within_a_narrower_range():
    planned = [PlannedDwell(each.dwell, 1, "z_up", 20.0, each.gyro_c) for each in rows_at(30.0, 32.0, 36.0)]
    assert numbers(group_plateaus(planned)) == [[1, 2, 3]]
    assert numbers(group_plateaus(planned, 3.0)) == [[1, 2], [3]]


def test_an_unknown_temperature_or_set_point_divides_nothing():
    rows = [
        dwell_row(n, "z_up", gyro_c, set_c=math.nan) for n, gyro_c in enumerate((30.0, math.nan, 31.0), 1)
    ]
    assert numbers(group_plateaus(rows)) == [[1, 2, 3]]


def test_dwells_without_a_set_point_are_grouped_by_temperature():
    rows = [dwell_row(n, "z_up", gyro_c, set_c=math.nan) for n, gyro_c in enumerate((30.0, 31.0, 50.0), 1)]
    assert numbers(group_plateaus(rows)) == [[1, 2], [3]]


def test_the_rounding_of_a_mean_set_point_divides_nothing():
    rows = [dwell_row(1, "z_up", 30.0, set_c=20.0), dwell_row(2, "z_down", 30.0, set_c=20.0 + 1e-9)]
    assert numbers(group_plateaus(rows)) == [[1, 2]]


def test_dwells_on_a_ramp_are_on_one_plateau_only_where_the_gyros_have_settled():
    """Pairs 6 K apart were one by a range of 8 K, and the whole ramp by the set point alone."""
    rows = rows_at(28.4, 36.5, 42.6, 67.1, 68.4, 69.2)
    assert numbers(group_plateaus(rows)) == [[1], [2], [3], [4, 5, 6]]


def test_a_slow_drift_keeps_one_plateau_beyond_8_k():
    """The mean of the plateau follows the drift; a range of 8 K from the first dwell divided it."""
    rows = rows_at(40.0, 37.5, 35.0, 33.5, 32.0, 31.0)
    assert numbers(group_plateaus(rows)) == [[1, 2, 3, 4, 5, 6]]


def test_plateaus_of_one_set_point_and_temperature_with_a_common_position_are_passes_of_one():
    first = [dwell_row(1, "z_up", 30.0), dwell_row(2, "z_down", 32.0)]
    again = [dwell_row(3, "z_down", 33.0, cycle=2), dwell_row(4, "y_up", 33.0, cycle=2)]
    third = [dwell_row(5, "y_up", 31.0, cycle=3), dwell_row(6, "x_up", 31.0, cycle=3)]
    assert mean_c(first, 0) == 31.0
    assert sorted(numbers(passes_of_plateaus([first, third, again], 0)[0])) == [[1, 2], [3, 4], [5, 6]]
    assert len(passes_of_plateaus([first, third], 0)) == 2


@pytest.mark.parametrize("other", [{"gyro_c": 45.0}, {"gyro_c": 30.0, "set_c": 40.0}])
def test_another_temperature_or_set_point_is_another_pass(other):
    plateaus = [[dwell_row(1, "z_up", 30.0)], [dwell_row(2, "z_up", **other)]]
    assert len(passes_of_plateaus(plateaus, 0)) == 2
