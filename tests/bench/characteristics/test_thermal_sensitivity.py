"""Thermal sensitivities from simulated temperature cycles whose coefficients are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.characteristics.thermal_sensitivity import thermal_sensitivity
from gyrobench.bench.foundations.errors import MeasurementError
from tests.bench.characteristics.simulated_rows import (
    after_soaks,
    holds,
    over_temperature,
    power_cycles,
    within_a_range,
)

TEMPERATURE, RAMP, HYSTERESIS = 1e-4, 5e-4, 0.006


def _bias(celsius, rate, lead):
    away = celsius - 20.0
    return 0.004 + TEMPERATURE * away - 8e-7 * away**2 + RAMP * rate + 0.5 * HYSTERESIS * lead


@pytest.mark.long
def test_intervals_hold_temperature_ramp_and_hysteresis():
    random = np.random.default_rng(1)
    held = {"temperature": [], "ramp": [], "hysteresis": []}
    truths = {"temperature": TEMPERATURE, "ramp": RAMP, "hysteresis": HYSTERESIS}
    for _ in range(25):
        for each in thermal_sensitivity(over_temperature(random, _bias, 2.0, 0.0018), 20.0, 3).coefficients:
            kind = each.name.split()[0]
            held[kind].append(holds(each, truths[kind]))
    assert {kind: len(each) for kind, each in held.items()} == dict.fromkeys(held, 75)
    assert all(np.mean(each) >= 0.87 for each in held.values()), held  # 0.95 +- 0.025


@pytest.mark.long
def test_intervals_hold_where_no_dwell_shows_the_history_before_the_first():
    random = np.random.default_rng(3)
    held = []
    for _ in range(40):
        found = thermal_sensitivity(after_soaks(random, HYSTERESIS, 2.0, 0.001), None, 1).coefficients
        truths = np.resize([2e-4, 0.0, HYSTERESIS], 9)
        held.append(np.reshape([holds(*each) for each in zip(found, truths, strict=True)], (3, 3)))
    assert np.all(np.mean(held, axis=(0, 1)) >= 0.9), np.mean(
        held, axis=(0, 1)
    )  # 120 intervals: 0.95 +- 0.02


@pytest.mark.parametrize(
    ("low_c", "high_c", "play_c", "units"),
    [
        (-30.0, 50.0, 5.0, 2),
        pytest.param(5.0, 40.0, 2.0, 40, marks=pytest.mark.long),
        pytest.param(5.0, 40.0, 8.0, 40, marks=pytest.mark.long),
    ],
)
def test_intervals_hold_where_no_dwell_shows_a_turning_point(low_c, high_c, play_c, units):
    random = np.random.default_rng(5)
    held = []
    for _ in range(units):
        rows = within_a_range(random, HYSTERESIS, play_c, 0.001, low_c, high_c)
        found = thermal_sensitivity(rows, 25.0, 1).coefficients
        truths = np.resize([2e-4, 5e-4, HYSTERESIS], 9)
        held.append(np.reshape([holds(*each) for each in zip(found, truths, strict=True)], (3, 3)))
    assert np.all(np.mean(held, axis=(0, 1)) >= (0.8 if units < 40 else 0.9)), np.mean(held, axis=(0, 1))


def test_the_history_before_the_first_dwell_may_be_heating():
    result = thermal_sensitivity(after_soaks(np.random.default_rng(1), HYSTERESIS, 2.0, 1e-4), None, 1)
    found = [each for each in result.coefficients if each.name == "hysteresis"]
    assert all(holds(each, HYSTERESIS) and each.high < 1.3 * HYSTERESIS for each in found)
    assert sum("inseparable" in note for note in result.notes) == 3


def test_without_noise_the_coefficients_are_those_of_the_model():
    rows = over_temperature(np.random.default_rng(2), _bias, 2.0, 1e-6)
    found = {each.name.split()[0]: each.value for each in thermal_sensitivity(rows, 20.0, 3).coefficients}
    assert found["temperature"] == pytest.approx(TEMPERATURE, abs=5e-6)
    assert found["ramp"] == pytest.approx(RAMP, abs=3e-5)
    assert found["hysteresis"] == pytest.approx(HYSTERESIS, abs=3e-4)


def test_the_parts_of_the_fit_are_heating_and_cooling():
    rows = over_temperature(np.random.default_rng(2), _bias, 2.0, 1e-6)
    [first, *_] = thermal_sensitivity(rows, 20.0, 3).curves
    steps = np.diff(first.x)
    named = [part.startswith("heating") for part in first.parts[1:]]
    # A reversal shows where the temperature has left its extreme.
    steady = np.abs(steps) > 2.0
    assert np.mean((steps > 0.0)[steady] == np.array(named)[steady]) > 0.9
    assert {part.split(",")[0] for part in first.parts} == {"heating", "cooling"}


def test_errors_that_all_dwells_share_are_in_the_intervals():
    """The x gyro is off by twice a shared uncertainty that follows the rate, the y gyro by another's."""
    rows = over_temperature(np.random.default_rng(6), _bias, 2.0, 2e-4)
    rates = {row.dwell: row.gyro_rate_c_per_h[0] / 60.0 for row in rows}
    shared = {
        dwell: 0.003 * np.array([[rate, 0.0], [0.0, np.tanh(rate)], [0.0, 0.0]])
        for dwell, rate in rates.items()
    }
    rows = [
        replace(
            row,
            bias_dph=tuple(row.bias_dph + shared[row.dwell] @ [1.8, -1.8]),
            sigma_dph=tuple(np.hypot(2e-4, np.linalg.norm(shared[row.dwell], axis=1))),
        )
        for row in rows
    ]
    result = thermal_sensitivity(rows, 20.0, 3, shared)
    ramps = [each for each in result.coefficients if each.name == "ramp sensitivity"]
    assert all(holds(each, RAMP) for each in ramps)
    x, y, z = (each.high - each.low for each in ramps)
    assert x == pytest.approx(2.0 * 1.96 * 0.003, rel=0.1)  # nothing in the dwells separates the two
    assert y < 0.2 * x  # the dwells do
    assert z < 0.1 * x
    assert [note[:6] for note in result.notes if "follow the temperature" in note] == ["X gyro"]
    without = thermal_sensitivity(rows, 20.0, 3).coefficients[1]
    assert without.name == "ramp sensitivity"
    assert not holds(without, RAMP)


def test_one_temperature_is_refused():
    with pytest.raises(MeasurementError, match=r"span 0\.0 K"):
        thermal_sensitivity(power_cycles(np.random.default_rng(3), 20, 0.001, 0.001), None, 3)
