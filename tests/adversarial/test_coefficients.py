"""Rows of the table of wrong coefficients."""

import pytest

from tests.adversarial.coefficients import ROWS, measure


@pytest.mark.parametrize(
    ("name", "expected"),
    [("nothing", ["1", "0", "0", ""]), ("encoder scale wrong by 20 ppm", ["1", "1", "0", "1"])],
)
def test_only_what_is_wrong_is_flagged_and_named(name, expected):
    [row] = [each for each in ROWS if each.name == name]
    assert measure(row, runs=1)[1:5] == expected
