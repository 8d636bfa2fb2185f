"""Coefficients over temperature as a table."""

import math

from gyrobench.bench.runs.tables.coefficient_table import (
    PlateauCoefficientRow,
    plateau_findings,
    plateau_heads,
)


def row(plateau, temperature_c, coefficient, finding=""):
    return PlateauCoefficientRow(
        plateau, 1, 60.0, temperature_c, coefficient, "x", 1.0, 0.1, "ppm", finding, math.nan, 0.0
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
