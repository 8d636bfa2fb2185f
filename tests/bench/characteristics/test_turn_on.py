"""Turn-on repeatability from power cycles whose scatter is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.error_split import SplitError
from gyrobench.bench.characteristics.turn_on import turn_on_repeatability, variance_interval
from gyrobench.bench.foundations.errors import MeasurementError
from tests.bench.characteristics.simulated_rows import holds, power_cycles

STD = "turn-on standard deviation"


@pytest.mark.long
@pytest.mark.parametrize("scatter_dph", [0.001, 0.0003])
def test_the_interval_holds_the_scatter_in_95_percent_of_records(scatter_dph):
    random = np.random.default_rng(1)
    held = [
        holds(each, scatter_dph)
        for _ in range(80)
        for each in turn_on_repeatability(power_cycles(random, 8, scatter_dph, 0.001)).coefficients
        if each.name == STD
    ]
    assert 0.915 <= np.mean(held) <= 0.985  # 240 intervals: 0.95 +- 0.014


def test_without_scatter_the_interval_begins_at_zero():
    random = np.random.default_rng(2)
    found = turn_on_repeatability(power_cycles(random, 10, 0.0, 0.001)).coefficients
    assert all(each.low == 0.0 and each.high < 0.0025 for each in found if each.name == STD)


@pytest.mark.long
def test_the_interval_holds_the_scatter_of_power_cycles_with_an_error_in_common():
    random = np.random.default_rng(6)
    found = []
    for _ in range(80):
        rows, errors = _with_common_error(random, 10, 0.001, own_dph=0.001, common_dph=0.002)
        found += [each for each in turn_on_repeatability(rows, errors).coefficients if each.name == STD]
    assert 0.915 <= np.mean([holds(each, 0.001) for each in found]) <= 0.985  # 240 intervals: 0.95 +- 0.014
    assert np.sqrt(np.mean([each.value**2 for each in found])) == pytest.approx(0.001, rel=0.1)


def test_set_points_that_differ_by_rounding_are_one():
    rows = power_cycles(np.random.default_rng(2), 5, 0.0, 0.001)
    rounded = [replace(row, chamber_set_c=22.0 + 1e-12 * number) for number, row in enumerate(rows)]
    assert not any("left out" in note for note in turn_on_repeatability(rounded).notes)


def test_an_error_that_all_power_cycles_share_is_not_subtracted_from_their_scatter():
    rows, errors = _with_common_error(np.random.default_rng(7), 60, 0.001, own_dph=0.0005, common_dph=0.003)
    found = [each for each in turn_on_repeatability(rows, errors).coefficients if each.name == STD]
    assert [each.value for each in found] == pytest.approx([0.001] * 3, rel=0.3)
    assert all(each.low > 0.0 for each in found)


def _with_common_error(random, count, scatter_dph, own_dph, common_dph):
    rows = power_cycles(random, count, scatter_dph, own_dph)
    off_dph = random.normal(0.0, common_dph, 3)
    sigma_dph = (float(np.hypot(own_dph, common_dph)),) * 3
    rows = [replace(row, bias_dph=tuple(row.bias_dph + off_dph), sigma_dph=sigma_dph) for row in rows]
    error = SplitError(np.full(3, own_dph**2), common_dph * np.eye(3))
    return rows, {row.dwell: error for row in rows}


def test_values_that_scatter_less_than_their_uncertainties_leave_room_for_a_scatter():
    alike = 0.01 * np.resize([1.0, -1.0], 12)
    low, high = variance_interval(alike, np.ones(12), np.ones((12, 1)))
    assert low == 0.0
    assert high == pytest.approx(
        11.0 / 3.816 - 1.0, rel=1e-3
    )  # 0.025 quantile of chi2 with 11 degrees of freedom


def test_a_power_cycle_with_a_flagged_dwell_is_left_out():
    random = np.random.default_rng(3)
    rows = power_cycles(random, 8, 0.001, 0.001)
    rows[3] = replace(rows[3], flags=("disturbed",), bias_dph=(9.0, 9.0, 9.0))
    result = turn_on_repeatability(rows)
    assert result.notes[0].startswith("1 power cycle left out")
    assert max(each.value for each in result.coefficients) < 0.1


def test_few_power_cycles_and_unequal_temperatures_are_noted():
    random = np.random.default_rng(4)
    rows = power_cycles(random, 4, 0.001, 0.001)
    rows[0] = replace(rows[0], gyro_c=(33.0, 30.0, 30.0))
    notes = " ".join(turn_on_repeatability(rows).notes)
    assert "fewer than 7" in notes
    assert "differ by 3.0 K" in notes


def test_a_single_power_cycle_has_no_repeatability():
    with pytest.raises(MeasurementError, match="two or more"):
        turn_on_repeatability(power_cycles(np.random.default_rng(5), 1, 0.001, 0.001))
