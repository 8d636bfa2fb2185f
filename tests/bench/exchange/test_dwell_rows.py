import pytest

from gyrobench.bench.exchange.log_import import cycle_numbers


@pytest.mark.parametrize(
    ("temperatures_c", "expected"),
    [
        ([20, 10, 0, 10, 20, 10, 0], [1, 1, 1, 2, 2, 3, 3]),
        ([0, 10, 20, 18, 20, 30], [1, 1, 1, 1, 1, 1]),
        ([5, 8, 5, 2, -10, 10], [1, 1, 1, 1, 1, 2]),
        ([20, 20, 20], [1, 1, 1]),
        ([], []),
    ],
)
def test_a_leg_ends_where_the_temperature_turned_by_enough(temperatures_c, expected):
    assert cycle_numbers(temperatures_c, 5.0) == expected
