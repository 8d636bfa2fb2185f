"""Five noise coefficients from records made with fractional integration, sums and random rounding."""

from __future__ import annotations

import numpy as np
import pytest

from gyrobench.bench.characteristics.allan_test import RateRecord, allan_test, square_interval
from gyrobench.bench.foundations.errors import MeasurementError
from tests.bench.characteristics.simulated_rows import holds

DPH = np.pi / 180.0 / 3600.0
ARCSEC = np.pi / 180.0 / 3600.0
TRUTHS = {"Q": 0.03, "N": 0.0005, "B": 0.004, "K": 0.006, "R": 0.02}


def angles(random: np.random.Generator, seconds: int) -> np.ndarray:
    """Angle of one gyro each second, rad: flicker by Kasdin's filter, the others by definition."""
    from scipy.signal import fftconvolve

    taps = np.concatenate([[1.0], np.cumprod((np.arange(1, 2 * seconds) - 0.5) / np.arange(1, 2 * seconds))])
    flicker = fftconvolve(random.standard_normal(2 * seconds), taps)[seconds : 2 * seconds]
    rate = (
        TRUTHS["N"] * np.pi / 180.0 / 60.0 * random.standard_normal(seconds)
        + TRUTHS["B"] * DPH * flicker
        + TRUTHS["K"] * DPH / 60.0 * np.cumsum(random.standard_normal(seconds))
        + TRUTHS["R"] * DPH / 3600.0 * np.arange(seconds)
    )
    pulse = np.sqrt(12.0) * TRUTHS["Q"] * ARCSEC
    return np.concatenate([[0.0], np.cumsum(rate)]) + random.uniform(-0.5, 0.5, seconds + 1) * pulse


@pytest.mark.long
def test_intervals_hold_the_five_coefficients() -> None:
    random = np.random.default_rng(1)
    held: dict[str, list[bool]] = {name: [] for name in TRUTHS}
    values: dict[str, list[float]] = {name: [] for name in TRUTHS}
    for _ in range(30):
        record = np.column_stack([angles(random, 12_000) for _ in range(3)])
        for each in allan_test([RateRecord(1.0, [record])]).coefficients:
            held[each.name[-1]].append(holds(each, TRUTHS[each.name[-1]]))
            values[each.name[-1]].append(each.value)
    assert all(len(each) == 90 for each in held.values())
    assert all(np.mean(each) >= 0.88 for each in held.values()), held  # 0.95 +- 0.023
    for name, tolerance in {"Q": 0.02, "N": 0.02, "B": 0.15}.items():
        assert np.mean(values[name]) == pytest.approx(TRUTHS[name], rel=tolerance)


def test_a_coefficient_that_does_not_show_has_an_upper_limit_only() -> None:
    low, high = square_interval(1.0, 0.8)
    assert (low, high) == (0.0, pytest.approx(1.0 + 1.96 * 0.8))


def test_without_a_noise_record_it_says_so() -> None:
    with pytest.raises(MeasurementError, match="purpose: noise"):
        allan_test([])
