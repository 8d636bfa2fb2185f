"""Coefficients over temperature as a table."""

import math

import pytest

from gyrobench.bench.bias.budget import Budget, Contribution
from gyrobench.bench.calibration.coefficients import SensorCoefficient
from gyrobench.bench.runs.tables.budget_table import BUDGET_TABLE, coefficient_budget_rows
from gyrobench.bench.runs.tables.coefficient_table import (
    COEFFICIENT_TABLE,
    PlateauCoefficientRow,
    plateau_findings,
    plateau_heads,
    plateau_notes,
    read_coefficients_for_fit,
    read_common_sigmas,
)


def row(plateau, temperature_c, coefficient, finding="", note=""):
    return PlateauCoefficientRow(
        plateau, 1, 60.0, temperature_c, coefficient, "x", 1.0, 0.1, "ppm", finding, math.nan, 0.0, note=note
    )


def test_a_plateau_is_headed_by_the_temperatures_of_gyro_and_case():
    rows = [
        row(1, 66.7, "gyro_bias"),
        row(1, 66.6, "gyro_scale_factor"),
        row(1, 62.6, "accelerometer_bias"),
        row(2, math.nan, "gyro_bias"),
        row(2, -1.6, "accelerometer_bias"),
    ]
    assert plateau_heads(rows) == {1: "67 / 63 °C", 2: "– / -2 °C"}


def test_findings_are_named_once_for_each_plateau_and_not_for_what_is_not_observable():
    rows = [
        row(1, 20.0, "gyro_bias", "not observable"),
        row(2, 20.0, "gyro_bias", "not observable; too few rests"),
        row(2, 20.0, "accelerometer_bias", "too few rests"),
    ]
    assert plateau_findings(rows) == ["Plateau 2: too few rests."]


def test_a_note_is_no_finding_and_is_named_once_for_each_plateau():
    rows = [row(1, 20.0, "gyro_bias"), *(row(2, 20.0, name, note="more") for name in ("gyro_bias", "accel"))]
    assert plateau_findings(rows) == []
    assert plateau_notes(rows) == ["Plateau 2: more."]


def test_what_all_plateaus_share_is_left_out_of_the_uncertainties_by_which_they_differ(tmp_path):
    rows = [row(1, 20.0, "accelerometer_scale_factor"), row(2, 50.0, "accelerometer_scale_factor")]
    coefficients, budget = tmp_path / "coefficients.csv", tmp_path / "budget.csv"
    COEFFICIENT_TABLE.write(coefficients, rows)
    unchanged = read_coefficients_for_fit(coefficients, budget)
    assert repr(unchanged) == repr(COEFFICIENT_TABLE.read(coefficients))  # NaN does not equal itself
    parts = {"gravity": 30.0, "latitude": 2.0, "velocity_random_walk": 0.3, "temperature_change": 0.4}
    contributions = [Contribution(name, math.nan, sigma) for name, sigma in parts.items()]
    known = SensorCoefficient("accelerometer", "scale_factor", "x", "ppm", 1e6, 0.01)
    BUDGET_TABLE.write(budget, coefficient_budget_rows(1, [(known, Budget(tuple(contributions)))]))
    first, second = read_coefficients_for_fit(coefficients, budget)
    assert first.sigma == pytest.approx(0.5)
    assert read_common_sigmas(budget) == {(1, first.name): pytest.approx((30.0, 2.0))}
    assert second.sigma == rows[1].sigma
