"""Lateness of ticks: percentiles from bins, missed ticks from the grid."""

import numpy as np
import pytest

from gyrobench.bench.engine.live_bench import TickLateness


def counted(late_s, period_s=1.0):
    lateness = TickLateness()
    for number, each_s in enumerate(late_s, start=1):
        lateness.add(number * period_s, number * period_s + each_s, period_s)
    return lateness.summary()


def test_percentiles_are_those_of_the_lateness_to_the_width_of_a_bin():
    late_s = np.random.default_rng(0).exponential(0.003, 5000)
    summary = counted(late_s)
    assert summary["count"] == 5000
    assert summary["late_median_s"] == pytest.approx(np.median(late_s), rel=0.06)
    assert summary["late_99_percent_s"] == pytest.approx(np.percentile(late_s, 99), rel=0.06)
    assert summary["late_max_s"] == pytest.approx(late_s.max(), abs=1e-6)


def test_ticks_on_time_are_not_late():
    summary = counted([0.0] * 10)
    assert (summary["late_median_s"], summary["late_99_percent_s"], summary["late_max_s"]) == (0.0, 0.0, 0.0)


def test_a_tick_that_is_hours_late_is_counted_too():
    assert counted([0.0, 20_000.0])["late_max_s"] == 20_000.0


def test_ticks_left_out_since_the_one_before_took_long_are_missed():
    lateness = TickLateness()
    for due_s in (2.0, 4.0, 10.0, 12.0):
        lateness.add(due_s, due_s, 2.0)
    assert lateness.summary()["missed"] == 2


def test_a_run_without_ticks_has_a_summary():
    assert TickLateness().summary()["count"] == 0
