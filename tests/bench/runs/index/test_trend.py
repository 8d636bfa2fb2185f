"""A drift is found where there is one, and seldom where there is none."""

from dataclasses import replace
from datetime import datetime, timedelta

import numpy as np
import pytest

from gyrobench.bench.runs.index.run_biases import (
    LEVEL,
    MONTH_DAYS,
    BiasQuantity,
    RunBias,
    mixed_origins,
    trends,
)

QUANTITIES = [BiasQuantity(gyro, 20.0, 25.0, LEVEL, ("z_up",)) for gyro in "xyz"]


def runs(biases, sigma=0.001, months=1.0):
    start = datetime(2026, 1, 1)
    return [
        RunBias("1", start + timedelta(days=MONTH_DAYS * months * number), float(bias), sigma)
        for number, bias in enumerate(biases)
    ]


def scattered(rng, count=8, slope=0.0, between=0.002):
    return slope * np.arange(count) + rng.normal(0.0, np.hypot(0.001, between), count)


def test_slope_and_scatter_between_runs_are_recovered_within_their_uncertainty():
    rng = np.random.default_rng(1)
    pulls = []
    for _ in range(200):
        (trend,) = trends({QUANTITIES[0]: runs(scattered(rng, slope=0.003))})
        pulls.append((trend.slope_dph_per_month - 0.003) / trend.slope_sigma_dph_per_month)
    assert np.mean(pulls) == pytest.approx(0.0, abs=0.25)
    assert np.mean(np.abs(pulls) < 2.447) == pytest.approx(0.95, abs=0.04)  # Student, 6 degrees of freedom


def test_without_drift_one_is_proven_no_oftener_than_stated():
    rng = np.random.default_rng(2)
    alarms = sum(
        any(each.is_proven for each in trends({each: runs(scattered(rng)) for each in QUANTITIES}))
        for _ in range(100)
    )
    assert alarms <= 5  # 1 % is stated; more than 5 of 100 has a chance of 0.0005


def test_temperatures_that_drift_over_the_runs_are_no_drift_of_a_bias_with_an_unknown_slope():
    own_dph, by_curve_dph = 0.0005, 0.002
    drifting = [
        replace(run, sigma_dph=float(np.hypot(own_dph, part)), by_curve_dph=(float(part), 0.0, 0.0))
        for run, part in zip(runs(np.zeros(8)), np.linspace(-1.0, 1.0, 8) * by_curve_dph, strict=True)
    ]
    (trend,) = trends({QUANTITIES[0]: drifting})
    assert trend.slope_sigma_dph_per_month > 2.0 * by_curve_dph / 7.0


def test_a_drift_is_proven_in_the_gyro_that_has_it():
    rng = np.random.default_rng(3)
    values = {each: runs(scattered(rng, 12, 0.003 if each.gyro == "y" else 0.0)) for each in QUANTITIES}
    assert [each.quantity.gyro for each in trends(values) if each.is_proven] == ["y"]


@pytest.mark.parametrize("biases", [[1.0], [1.0, 2.0]])
def test_too_few_runs_show_a_mean_and_no_slope(biases):
    (trend,) = trends({QUANTITIES[0]: runs(biases)})
    assert trend.bias_dph == pytest.approx(np.mean(biases), abs=1e-6)
    assert np.isnan(trend.slope_dph_per_month)
    assert not trend.is_proven


def test_runs_of_one_day_show_no_slope():
    (trend,) = trends({QUANTITIES[0]: runs([1.0, 2.0, 3.0, 4.0], months=0.0)})
    assert np.isnan(trend.p_value)


def test_runs_of_several_benches_or_versions_are_reported():
    warnings = mixed_origins(
        [
            {"station": "one", "procedure": "a", "procedure_sha256": "1"},
            {"station": "two", "procedure": "a", "procedure_sha256": "2"},
        ]
    )
    assert warnings[0].startswith("the runs come from the benches one, two")
    assert "2 procedures or versions" in warnings[1]
    assert not mixed_origins([{"station": "one", "procedure": "a", "procedure_sha256": "1"}] * 2)
