"""Scale-factor stability from whole turns whose gyros are known."""

from __future__ import annotations

import numpy as np
import pytest

from gyrobench.bench.calibration.spins import RateRow, SpinScaleFactor
from gyrobench.bench.characteristics.scale_factor import SpinRecord, scale_factor_stability
from gyrobench.bench.foundations.errors import MeasurementError
from tests.bench.characteristics.simulated_rows import holds

RATES_DPS = (5.0, 10.0, 20.0)
#: Standard deviation of each single turn, ppm.
TURN = 0.8


def measurement(random, run, hours, true_ppm, asymmetry_ppm=0.0, ppm_per_dps=0.0, celsius=30.0):
    """One dwell: a turn each way at each rate of each gyro, averaged as they are."""
    gyros = []
    for axis in "xyz":
        size = np.array(RATES_DPS)
        ahead, back = (
            true_ppm
            + sign * asymmetry_ppm / 2.0
            + ppm_per_dps * (size - size.mean())
            + random.normal(0.0, TURN, 3)
            for sign in (1.0, -1.0)
        )
        mean = 0.5 * (ahead + back)
        away = TURN * np.sqrt(0.5 * 2.0 / 3.0)
        rows = [
            RateRow(rate, one - mean.mean(), away, difference, TURN * np.sqrt(2.0))
            for rate, one, difference in zip(RATES_DPS, mean, ahead - back, strict=True)
        ]
        gyros.append(SpinScaleFactor(axis, mean.mean(), TURN / np.sqrt(6.0), (), tuple(rows), 1.0))
    return SpinRecord(run, 3600.0 * hours, (celsius,) * 3, tuple(gyros))


def campaign(random, cycles, each, drift=0.0, scatter=0.0, turn_on=0.0, **of_rate):
    records = []
    for cycle in range(cycles):
        constant = 40.0 + random.normal(0.0, turn_on)
        for number in range(each):
            true = constant + drift * number + random.normal(0.0, scatter)
            records.append(measurement(random, f"r{cycle}", 13.0 * cycle + number, true, **of_rate))
    return records


def held(campaigns, name, truth):
    found = [
        holds(each, truth)
        for records in campaigns
        for each in scale_factor_stability(records).coefficients
        if each.name == name
    ]
    return np.mean(found), len(found)


@pytest.mark.long
@pytest.mark.parametrize(("cycles", "each", "scatter"), [(1, 12, 0.1), (3, 8, 0.6), (8, 1, 0.3)])
def test_intervals_hold_drift_and_scatter_in_95_percent_of_campaigns(cycles, each, scatter):
    random = np.random.default_rng((1, cycles))
    drift = 0.05 if each > 1 else 0.0
    campaigns = [campaign(random, cycles, each, drift, scatter) for _ in range(60)]
    truths = {"scale factor drift": drift, "scale factor standard deviation": scatter}
    for name, truth in truths.items():
        share, count = held(campaigns, name, truth)
        assert count == 180
        # The gyros of a campaign share its true scatter: 0.95 +- 0.025.
        assert 0.875 <= share <= 0.995, name


@pytest.mark.long
def test_the_scatter_from_power_cycle_to_power_cycle_is_apart_from_that_within():
    random = np.random.default_rng(3)
    campaigns = [campaign(random, 5, 5, 0.1, 0.3, 2.0) for _ in range(40)]
    for name, truth in {"turn-on": 2.0, "scale factor": 0.3}.items():
        share, count = held(campaigns, f"{name} standard deviation", truth)
        assert count == 120
        assert 0.87 <= share <= 1.0, name


@pytest.mark.long
def test_the_intervals_of_worst_asymmetry_and_nonlinearity_hold_them():
    random = np.random.default_rng(4)
    for asymmetry, slope in ((0.0, 0.0), (1.5, 0.1)):
        campaigns = [campaign(random, 1, 10, asymmetry_ppm=asymmetry, ppm_per_dps=slope) for _ in range(40)]
        worst = slope * (20.0 - np.mean(RATES_DPS))
        assert held(campaigns, "worst asymmetry", asymmetry)[0] >= 0.92
        assert held(campaigns, "worst nonlinearity", worst)[0] >= 0.92
    found = [each for records in campaigns for each in scale_factor_stability(records).coefficients]
    assert np.mean([each.low > 0.0 for each in found if each.name.startswith("worst")]) > 0.9


def test_dwells_without_a_result_and_unequal_temperatures_are_noted():
    random = np.random.default_rng(5)
    records = [measurement(random, "r", hour, 40.0, celsius=30.0 + 0.5 * hour) for hour in range(8)]
    records.append(SpinRecord("r", 1e5, (30.0,) * 3, (), "the unit rests for 3 s"))
    notes = " ".join(scale_factor_stability(records).notes)
    assert "1 measurement left out: the unit rests for 3 s." in notes
    assert "differs by 3.5 K" in notes


def test_the_parts_of_the_fit_are_power_cycles():
    curve = scale_factor_stability(campaign(np.random.default_rng(4), 2, 4)).curves[0]
    assert curve.parts == ["r0"] * 4 + ["r1"] * 4


def test_three_measurements_are_too_few():
    random = np.random.default_rng(6)
    with pytest.raises(MeasurementError, match="no gyro has 4 measurements"):
        scale_factor_stability([measurement(random, "r", hour, 40.0) for hour in range(3)])
