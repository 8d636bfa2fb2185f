import pytest

from gyrobench.bench.characteristics.results import Coefficient, TestResult
from gyrobench.bench.report.characteristic_sections import characteristics_sections


@pytest.mark.parametrize(
    ("value", "low", "high", "cells"),
    [
        (1853.2, 1366.0, 2404.0, ["1850", "1370 to 2400"]),
        (0.0071234, 0.000224, None, ["0.00712", "above 0.000224"]),
        (2.5e7, None, 3.1e7, ["2.5e+07", "below 3.1e+07"]),
        (None, None, None, ["not determined", ""]),
    ],
)
def test_a_coefficient_and_its_interval_have_three_digits_and_an_exponent_only_if_large(
    value, low, high, cells
):
    coefficient = Coefficient(gyro="x", name="time constant", unit="s", value=value, low=low, high=high)
    [section] = characteristics_sections([TestResult(test="warm_up", coefficients=[coefficient])])
    assert section.tables[0].rows == [["time constant", "X", "s", *cells]]
