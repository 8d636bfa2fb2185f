"""Turn-on repeatability from power cycles whose scatter is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.characteristics.turn_on import turn_on_repeatability, variance_interval
from gyrobench.bench.foundations.errors import MeasurementError
from tests.bench.characteristics.simulated_rows import holds, power_cycles

STD = "turn-on standard deviation"


@pytest.mark.long
@pytest.mark.parametrize("scatter_dph", [0.001, 0.0003])
def test_the_interval_holds_the_scatter_in_95_percent_of_records(scatter_dph: float) -> None:
    random = np.random.default_rng(1)
    held = [
        holds(each, scatter_dph)
        for _ in range(80)
        for each in turn_on_repeatability(power_cycles(random, 8, scatter_dph, 0.001)).coefficients
        if each.name == STD
    ]
    assert 0.915 <= np.mean(held) <= 0.985  # 240 intervals: 0.95 +- 0.014


def test_without_scatter_the_interval_begins_at_zero() -> None:
    random = np.random.default_rng(2)
    found = turn_on_repeatability(power_cycles(random, 10, 0.0, 0.001)).coefficients
    assert all(each.low == 0.0 and each.high < 0.0025 for each in found if each.name == STD)


def test_values_that_scatter_less_than_their_uncertainties_leave_room_for_a_scatter() -> None:
    alike = 0.01 * np.resize([1.0, -1.0], 12)
    low, high = variance_interval(alike, np.ones(12), np.ones((12, 1)))
    assert low == 0.0
    assert high == pytest.approx(
        11.0 / 3.816 - 1.0, rel=1e-3
    )  # 0.025 quantile of chi2 with 11 degrees of freedom


def test_a_power_cycle_with_a_flagged_dwell_is_left_out() -> None:
    random = np.random.default_rng(3)
    rows = power_cycles(random, 8, 0.001, 0.001)
    rows[3] = replace(rows[3], flags=("disturbed",), bias_dph=(9.0, 9.0, 9.0))
    result = turn_on_repeatability(rows)
    assert result.notes[0].startswith("1 power cycle left out")
    assert max(each.value for each in result.coefficients) < 0.1


def test_few_power_cycles_and_unequal_temperatures_are_noted() -> None:
    random = np.random.default_rng(4)
    rows = power_cycles(random, 4, 0.001, 0.001)
    rows[0] = replace(rows[0], gyro_c=(33.0, 30.0, 30.0))
    notes = " ".join(turn_on_repeatability(rows).notes)
    assert "fewer than 7" in notes
    assert "differ by 3.0 K" in notes


def test_a_single_power_cycle_has_no_repeatability() -> None:
    with pytest.raises(MeasurementError, match="two or more"):
        turn_on_repeatability(power_cycles(np.random.default_rng(5), 1, 0.001, 0.001))
