"""Five noise coefficients from records made with fractional integration, sums and random rounding."""

from __future__ import annotations

import re

import numpy as np
import pytest

from gyrobench.bench.characteristics.allan_test import (
    MIN_RATIO,
    RateRecord,
    allan_test,
    periodic_rate,
    square_interval,
)
from gyrobench.bench.foundations.errors import MeasurementError
from tests.bench.characteristics.simulated_rows import holds

DPH = np.pi / 180.0 / 3600.0
ARCSEC = np.pi / 180.0 / 3600.0
TRUTHS = {"Q": 0.03, "N": 0.0005, "B": 0.004, "K": 0.006, "R": 0.02}


def angles(random, seconds):
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
def test_intervals_hold_the_five_coefficients():
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


def _with_line(random, size_dph, period_s, hours=10.0):
    """Record of three gyros with angle random walk and a sinusoidal rate, each ten seconds."""
    time_s = np.arange(0.0, 3600.0 * hours, 10.0)[:, np.newaxis]
    noise = TRUTHS["N"] * np.pi / 180.0 / 60.0 * np.sqrt(10.0) * random.standard_normal((len(time_s), 3))
    phases = random.uniform(0.0, 2.0 * np.pi, 3)
    line = 10.0 * size_dph * DPH * np.sin(2.0 * np.pi * time_s / period_s + phases)
    return RateRecord(10.0, [np.vstack([np.zeros((1, 3)), np.cumsum(noise + line, axis=0)])])


@pytest.mark.parametrize("period_s", [600.0, 1800.0, 3600.0])
def test_a_periodic_rate_is_noted_near_its_averaging_time(period_s):
    notes = allan_test([_with_line(np.random.default_rng(4), 0.003, period_s)]).notes
    assert [note[:6] for note in notes] == ["X gyro", "Y gyro", "Z gyro"]
    assert all("do not explain the Allan variance" in note for note in notes)
    near_s = [float(note.split("; near ")[1].split(" s ")[0]) for note in notes]
    assert near_s == pytest.approx([0.371 * period_s] * 3, rel=0.35)


@pytest.mark.parametrize(("period_s", "size_dph"), [(1800.0, 0.006), (2700.0, 0.01)])
def test_a_periodic_rate_of_few_periods_is_noted_with_its_size(period_s, size_dph):
    record = _with_line(np.random.default_rng(4), size_dph, period_s, hours=3.0)
    record.segments[0][1000] = np.nan
    notes = allan_test([record]).notes
    assert [note[:6] for note in notes] == ["X gyro", "Y gyro", "Z gyro"]
    found = [re.search(r"rate of period (\S+) s and amplitude (\S+) deg/h", note).groups() for note in notes]
    assert [float(period) for period, _ in found] == pytest.approx([period_s] * 3, rel=0.1)
    assert [float(size) for _, size in found] == pytest.approx([size_dph] * 3, rel=0.25)


@pytest.mark.parametrize(
    ("walk_dph", "count"),
    [(0.006, 14), *(pytest.param(each, 700, marks=pytest.mark.long) for each in (0.0, 0.006, 0.1))],
)
def test_noise_and_warm_up_are_no_periodic_rate(walk_dph, count):
    random, time_s = np.random.default_rng(6), np.arange(0.0, 10_800.0, 10.0)
    warm_up = 0.02 * DPH * np.exp(-time_s / 3600.0)
    ratios = []
    for _ in range(count):
        walk = walk_dph * DPH / 60.0 * np.sqrt(10.0) * np.cumsum(random.standard_normal(len(time_s)))
        white = TRUTHS["N"] * np.pi / 180.0 / 60.0 / np.sqrt(10.0) * random.standard_normal(len(time_s))
        ratios.append(periodic_rate(10.0 * np.cumsum(white + walk + warm_up), 10.0).ratio)
    assert np.count_nonzero(np.array(ratios) > MIN_RATIO) <= (count > 100)  # by chance less than 1 of 2,000
    assert 7.0 < np.median(ratios) < 10.5


def test_a_short_record_has_no_periodic_rate():
    assert periodic_rate(np.zeros(150), 1.0) is None


def test_noise_that_the_terms_explain_has_no_note():
    random = np.random.default_rng(5)
    assert allan_test([_with_line(random, 0.0, 600.0)]).notes == []
    record = np.column_stack([angles(random, 3600) for _ in range(3)])
    assert allan_test([RateRecord(1.0, [record])]).notes == []


def test_a_coefficient_that_does_not_show_has_an_upper_limit_only():
    low, high = square_interval(1.0, 0.8)
    assert (low, high) == (0.0, pytest.approx(1.0 + 1.96 * 0.8))


def test_without_a_noise_record_it_says_so():
    with pytest.raises(MeasurementError, match="purpose: noise"):
        allan_test([])
