"""Temperatures that a plan leads to."""

import numpy as np
import pytest

from gyrobench.bench.closure.planned_campaign import forecast_temperatures
from gyrobench.bench.closure.unit_thermal import ELECTRONICS_ABOVE_OPTICS_K
from tests.bench.closure.plans import planned, station

RAMP = "  - chamber: {temperature_c: 60, ramp_c_per_min: 4}\n"


def test_all_ends_at_the_chambers_temperature_and_the_units_own_heating():
    _, plan = planned(f"  - power_on: {{settle_s: 120}}\n{RAMP}  - soak: {{for_s: 40000}}\n")
    forecast = forecast_temperatures(plan)
    heating_c = station().file.unit.thermal.self_heating_c
    assert forecast.air_c[-1] == pytest.approx(60.0, abs=0.01)
    np.testing.assert_allclose(forecast.optics_c[-1], 60.0 + heating_c, atol=0.05)
    assert forecast.air_c[-1] < forecast.case_c[-1] < forecast.optics_c[-1].min()
    above_c = forecast.electronics_c[-1] - forecast.optics_c[-1]
    np.testing.assert_allclose(above_c, ELECTRONICS_ABOVE_OPTICS_K, atol=0.05)


def test_a_unit_that_is_off_follows_the_chamber_alone():
    _, plan = planned(f"{RAMP}  - soak: {{for_s: 40000}}\n")
    forecast = forecast_temperatures(plan)
    np.testing.assert_allclose(forecast.optics_c[-1], 60.0, atol=0.05)
    np.testing.assert_allclose(forecast.electronics_c[-1], 60.0, atol=0.05)


def test_the_optics_lag_behind_a_ramp_by_the_stations_time_constant():
    _, plan = planned("  - chamber: {temperature_c: -40, ramp_c_per_min: 0.1, within_c: 1}\n")
    forecast = forecast_temperatures(plan)
    behind_s = (forecast.optics_c[-1, 0] - forecast.air_c[-1]) / (0.1 / 60.0)
    assert behind_s == pytest.approx(station().file.unit.thermal.time_constant_s, rel=0.05)


def test_electronics_below_their_optics_are_cooler_than_above_them():
    _, plan = planned(
        "  - power_on\n  - go_to: {position: z_up}\n  - wait: {duration_s: 30000}\n"
        "  - go_to: {position: z_down}\n  - wait: {duration_s: 30000}\n"
    )
    forecast = forecast_temperatures(plan)
    above_c = forecast.electronics_c - forecast.optics_c
    up_c, down_c = above_c[len(above_c) // 2 - 2], above_c[-1]
    assert np.abs(up_c - down_c).max() > 1.0
    assert (up_c[0], up_c[1]) == (pytest.approx(up_c[1]), pytest.approx(up_c[0]))
    assert up_c[2] == pytest.approx(down_c[2], abs=0.01)  # its heat path is level in both


def test_means_are_taken_over_each_stretch():
    _, plan = planned("  - chamber: {temperature_c: 60, ramp_c_per_min: 0.5}\n")
    forecast = forecast_temperatures(plan)
    means = forecast.means(forecast.time_s, np.array([0.0, 600.0]), np.array([600.0, 1800.0]))
    np.testing.assert_allclose(means, [300.0, 1200.0])
