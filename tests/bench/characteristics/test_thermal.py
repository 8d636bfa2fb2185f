"""Thermal sensitivities from simulated temperature cycles whose coefficients are known."""

from __future__ import annotations

import numpy as np
import pytest

from gyrobench.bench.characteristics.profile_fit import thermal_sensitivity
from gyrobench.bench.foundations.errors import MeasurementError
from tests.bench.characteristics.simulated_rows import holds, over_temperature, power_cycles

TEMPERATURE, RAMP, HYSTERESIS = 1e-4, 5e-4, 0.006


def _bias(celsius: float, rate: float, lead: float) -> float:
    away = celsius - 20.0
    return 0.004 + TEMPERATURE * away - 8e-7 * away**2 + RAMP * rate + 0.5 * HYSTERESIS * lead


@pytest.mark.long
def test_intervals_hold_temperature_ramp_and_hysteresis() -> None:
    random = np.random.default_rng(1)
    held = {"temperature": [], "ramp": [], "hysteresis": []}
    truths = {"temperature": TEMPERATURE, "ramp": RAMP, "hysteresis": HYSTERESIS}
    for _ in range(25):
        for each in thermal_sensitivity(over_temperature(random, _bias, 2.0, 0.0018), 20.0, 3).coefficients:
            kind = each.name.split()[0]
            held[kind].append(holds(each, truths[kind]))
    assert {kind: len(each) for kind, each in held.items()} == dict.fromkeys(held, 75)
    assert all(np.mean(each) >= 0.87 for each in held.values()), held  # 0.95 +- 0.025


def test_without_noise_the_coefficients_are_those_of_the_model() -> None:
    rows = over_temperature(np.random.default_rng(2), _bias, 2.0, 1e-6)
    found = {each.name.split()[0]: each.value for each in thermal_sensitivity(rows, 20.0, 3).coefficients}
    assert found["temperature"] == pytest.approx(TEMPERATURE, abs=5e-6)
    assert found["ramp"] == pytest.approx(RAMP, abs=3e-5)
    assert found["hysteresis"] == pytest.approx(HYSTERESIS, abs=3e-4)


def test_the_parts_of_the_fit_are_heating_and_cooling() -> None:
    rows = over_temperature(np.random.default_rng(2), _bias, 2.0, 1e-6)
    [first, *_] = thermal_sensitivity(rows, 20.0, 3).curves
    steps = np.diff(first.x)
    named = [part.startswith("heating") for part in first.parts[1:]]
    # A reversal shows where the temperature has left its extreme.
    steady = np.abs(steps) > 2.0
    assert np.mean((steps > 0.0)[steady] == np.array(named)[steady]) > 0.9
    assert {part.split(",")[0] for part in first.parts} == {"heating", "cooling"}


def test_one_temperature_is_refused() -> None:
    with pytest.raises(MeasurementError, match=r"span 0\.0 K"):
        thermal_sensitivity(power_cycles(np.random.default_rng(3), 20, 0.001, 0.001), None, 3)
