"""Levels and differences of runs that were not measured in the same positions."""

from datetime import datetime

import numpy as np
import pytest

from gyrobench.bench.bias.position_differences import SLOPE_SIGMA_DPH_PER_C
from gyrobench.bench.runs.index.run_biases import LEVEL, run_biases


def rows(path, biases, sigma=0.001, gyro="x", temperature_c=22.0, low_c=20.0):
    return [
        {
            "path": path,
            "unit": "1",
            "started_utc": datetime(2026, 1, 1),
            "gyro": gyro,
            "bin_low_c": low_c,
            "bin_high_c": low_c + 5.0,
            "position": position,
            "temperature_c": temperature_c,
            "bias_dph": bias,
            "sigma_dph": sigma,
        }
        for position, bias in biases.items()
    ]


def test_a_level_is_the_mean_of_the_positions_and_a_difference_is_from_it():
    result = run_biases(rows("a", {"z_up": 0.001, "y_up": 0.002, "x_up": 0.006}, sigma=0.003))
    assert {quantity.name: each[0].bias_dph for quantity, each in result.items()} == pytest.approx(
        {LEVEL: 0.003, "z_up": -0.002, "y_up": -0.001, "x_up": 0.003}
    )
    sigmas = {quantity.name: each[0].sigma_dph for quantity, each in result.items()}
    assert sigmas[LEVEL] == pytest.approx(0.003 / np.sqrt(3))
    assert sigmas["z_up"] == pytest.approx(0.003 * np.sqrt(2 / 3))


def test_runs_are_compared_by_the_positions_that_most_have():
    result = run_biases(
        [
            *rows("a", {"z_up": 1.0, "y_up": 3.0}),
            *rows("b", {"z_up": 1.0, "y_up": 3.0, "x_up": 100.0}),
            *rows("c", {"z_up": 1.0}),
        ]
    )
    level = next(quantity for quantity in result if quantity.name == LEVEL)
    assert level.positions == ("z_up", "y_up")
    assert [run.bias_dph for run in result[level]] == [2.0, 2.0]


def test_of_two_positions_one_difference_determines_all():
    names = [quantity.name for quantity in run_biases(rows("a", {"z_up": 1.0, "y_up": 3.0}))]
    assert names == [LEVEL, "y_up"]


def test_runs_at_other_temperatures_of_a_bin_are_compared_at_one():
    slope_dph_per_c = 0.002
    result = run_biases(
        row
        for number, shift_c in enumerate((-1.5, 0.0, 1.5, 2.0))
        for low_c in (-20.0, 20.0, 60.0)
        for position in ("z_up", "y_up")
        for row in rows(
            str(number),
            {position: slope_dph_per_c * (low_c + 2.0 + shift_c)},
            temperature_c=low_c + 2.0 + shift_c,
            low_c=low_c,
        )
    )
    for quantity, runs in result.items():
        assert np.ptp([run.bias_dph for run in runs]) < 0.0003, quantity
        assert max(run.sigma_dph for run in runs) < 1.2 * 0.001


def test_a_slope_that_the_runs_do_not_show_is_the_same_error_in_all_of_them():
    result = run_biases([*rows("a", {"z_up": 0.0}), *rows("b", {"z_up": 0.0}, temperature_c=24.0)])
    ((first, second),) = result.values()
    assert first.by_curve_dph == pytest.approx([-each for each in second.by_curve_dph], abs=1e-4)
    assert first.sigma_dph == pytest.approx(np.hypot(0.001, SLOPE_SIGMA_DPH_PER_C), rel=1e-3)
