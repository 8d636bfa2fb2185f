"""Warm-up from cold starts whose exponentials are known."""

from __future__ import annotations

import numpy as np
import pytest

from gyrobench.bench.characteristics.warm_up import warm_up
from gyrobench.bench.foundations.errors import MeasurementError
from tests.bench.characteristics.simulated_rows import cold_start, holds


def _named(found, start):
    return [each for each in found if each.name.startswith(start)]


@pytest.mark.long
def test_intervals_hold_drop_time_constant_and_time_to_settle():
    random = np.random.default_rng(1)
    results = [warm_up(cold_start(random, 0.006, 3600.0), 0.001).coefficients for _ in range(40)]
    truths = {
        "first bias": 0.006 * np.exp(-np.linspace(60.0, 190.0, 100) / 3600.0).mean(),
        "time constant": 3600.0,
        "time until": 3600.0 * np.log(6.0),
    }
    for start, truth in truths.items():
        held = [holds(each, truth) for found in results for each in _named(found, start)]
        assert len(held) >= 117  # of 120; in a few the warm-up is not significant
        assert np.mean(held) >= 0.88, start  # 120 intervals: 0.95 +- 0.02


@pytest.mark.long
@pytest.mark.parametrize("size_dph", [0.02, 0.05, 0.1])
def test_intervals_of_large_warm_ups_hold_time_constants_of_any_value(size_dph):
    random = np.random.default_rng(2)
    held = []
    for _ in range(40):
        tau_s = float(np.exp(random.uniform(np.log(600.0), np.log(3000.0))))
        first, constant, settled = warm_up(cold_start(random, size_dph, tau_s), 0.001).coefficients[:3]
        truths = (
            size_dph * np.exp(-np.linspace(60.0, 190.0, 100) / tau_s).mean(),
            tau_s,
            tau_s * np.log(size_dph / 0.001),
        )
        held.append(
            [holds(each, truth) for each, truth in zip((first, constant, settled), truths, strict=True)]
        )
    assert np.all(np.mean(held, axis=0) >= 0.82), np.mean(held, axis=0)  # 40 intervals: 0.95 +- 0.035


def test_the_time_constant_of_a_large_warm_up_is_not_rounded_to_a_grid():
    taus_s = 1300.0, 1500.0, 1700.0
    found = [
        _named(warm_up(cold_start(np.random.default_rng(6), 0.1, tau_s), 0.001).coefficients, "time constant")
        for tau_s in taus_s
    ]
    held = [holds(each, tau_s) for own, tau_s in zip(found, taus_s, strict=True) for each in own]
    assert len(held) == 9
    assert sum(held) >= 8
    assert all(0.0 < each.high - each.low < 0.25 * each.value for own in found for each in own)


def test_a_time_constant_that_is_longer_than_the_record_has_no_upper_limit():
    result = warm_up(cold_start(np.random.default_rng(0), 0.02, 28800.0), 0.001)
    sizes, constants = (_named(result.coefficients, start) for start in ("first bias", "time constant"))
    assert len(sizes) == len(constants) == 3
    assert all(each.high is None and each.low < 0.02 for each in sizes)
    assert all(each.high is None and each.low < 28800.0 for each in constants)
    assert sum("no upper limit to the time constant and the size" in note for note in result.notes) == 3


def test_a_rising_bias_without_a_limit_of_its_time_constant_has_no_lower_limit_of_its_size():
    result = warm_up(cold_start(np.random.default_rng(0), -0.02, 28800.0), 0.001)
    sizes, constants = (_named(result.coefficients, start) for start in ("first bias", "time constant"))
    are_open = [each.high is None for each in constants]
    assert sum(are_open) >= 2
    assert [each.low is None for each in sizes] == are_open
    assert all(each.high < 0.0 for each in sizes)


def test_without_warm_up_it_says_so():
    random = np.random.default_rng(3)
    results = [warm_up(cold_start(random, 0.0, 3600.0), 0.001) for _ in range(10)]
    silent = [note for result in results for note in result.notes if "no warm-up is significant" in note]
    assert len(silent) >= 26  # of 30: one in twenty is significant by chance


@pytest.mark.parametrize(("size_dph", "time_constant_s"), [(0.0, 3600.0), (0.02, 1e6)])
def test_an_insignificant_warm_up_has_a_limited_change_in_the_record_and_a_size_without_limits(
    size_dph, time_constant_s
):
    result = warm_up(cold_start(np.random.default_rng(7), size_dph, time_constant_s), 0.001)
    truth = size_dph * (np.exp(-125.0 / time_constant_s) - np.exp(-14285.0 / time_constant_s))
    assert sum("no warm-up is significant in the record" in note for note in result.notes) == 3
    assert all(each.value is each.low is each.high is None for each in _named(result.coefficients, "first"))
    changes = _named(result.coefficients, "change in the record")
    assert all(holds(each, truth) and each.high - each.low < 0.01 for each in changes)
    assert len(changes) == 3


def test_a_unit_that_has_not_settled_is_noted():
    result = warm_up(cold_start(np.random.default_rng(4), 0.05, 9000.0), 0.001)
    assert all(each.value is None for each in _named(result.coefficients, "time until"))
    assert "not settled within 4 h" in " ".join(result.notes)


@pytest.mark.parametrize("count", [0, 3])
def test_few_dwells_are_too_few(count):
    with pytest.raises(MeasurementError, match="too few"):
        warm_up(cold_start(np.random.default_rng(5), 0.006, 3600.0)[:count], 0.001)
