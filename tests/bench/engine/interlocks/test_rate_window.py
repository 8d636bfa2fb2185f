import math

import pytest

from gyrobench.bench.engine.interlocks.checks import RateWindow


def test_there_is_no_rate_before_half_the_window_is_filled():
    window = RateWindow(60.0, 1.0)
    assert window.per_s() is None
    window.add(0.0, 20.0)
    window.add(29.0, 40.0)
    assert window.per_s() is None
    window.add(30.0, 23.0)
    assert window.per_s() == pytest.approx(0.1)


def test_the_change_is_that_over_the_window():
    window = RateWindow(60.0, 1.0)
    for time_s in range(0, 600, 10):
        window.add(float(time_s), 0.0 if time_s < 300 else 0.05 * (time_s - 300))
    assert window.per_s() == pytest.approx(0.05)


def test_values_that_are_no_numbers_or_not_new_are_left_out():
    window = RateWindow(60.0, 1.0)
    for time_s, value in ((0.0, 1.0), (20.0, math.nan), (40.0, 5.0), (40.0, 9.0), (30.0, 9.0)):
        window.add(time_s, value)
    assert window.per_s() == pytest.approx(0.1)


def test_a_gap_discards_older_values():
    window = RateWindow(60.0, 1.0)
    window.add(0.0, 20.0)
    window.add(40.0, 20.0)
    window.add(5000.0, 60.0)
    assert window.per_s() is None


def test_a_window_holds_three_readings_at_least():
    window = RateWindow(10.0, 60.0)
    for time_s in (0.0, 61.0, 121.0):
        window.add(time_s, time_s)
    assert window.per_s() == pytest.approx(1.0)
