"""Warm-up from cold starts whose exponentials are known."""

from __future__ import annotations

import numpy as np
import pytest

from gyrobench.bench.characteristics.results import Coefficient
from gyrobench.bench.characteristics.warm_up import warm_up
from gyrobench.bench.foundations.errors import MeasurementError
from tests.bench.characteristics.simulated_rows import cold_start, holds


def _named(found: list[Coefficient], start: str) -> list[Coefficient]:
    return [each for each in found if each.name.startswith(start)]


@pytest.mark.long
def test_intervals_hold_drop_time_constant_and_time_to_settle() -> None:
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


def test_without_warm_up_it_says_so() -> None:
    random = np.random.default_rng(3)
    results = [warm_up(cold_start(random, 0.0, 3600.0), 0.001) for _ in range(10)]
    silent = [note for result in results for note in result.notes if "no warm-up is significant" in note]
    assert len(silent) >= 26  # of 30: one in twenty is significant by chance


def test_a_unit_that_has_not_settled_is_noted() -> None:
    result = warm_up(cold_start(np.random.default_rng(4), 0.05, 9000.0), 0.001)
    assert all(each.value is None for each in _named(result.coefficients, "time until"))
    assert "not settled within 4 h" in " ".join(result.notes)


@pytest.mark.parametrize("count", [0, 3])
def test_few_dwells_are_too_few(count: int) -> None:
    with pytest.raises(MeasurementError, match="too few"):
        warm_up(cold_start(np.random.default_rng(5), 0.006, 3600.0)[:count], 0.001)
