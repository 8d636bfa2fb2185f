import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from gyrobench.bench.bias.bins import BiasBin, paper_bins
from gyrobench.bench.bias.equality import compare_positions
from gyrobench.bench.navigation.positions import POSITIONS


def position_bin(position, bias_dph, sigma_dph=0.001, low_c=20.0, temperature_c=22.0, gyro="x", count=3):
    return BiasBin(
        gyro, position, low_c, low_c + 5.0, temperature_c, bias_dph, sigma_dph, count, math.nan, math.nan
    )


def test_two_positions_by_hand():
    (result,) = compare_positions(
        [
            position_bin("z_up", 0.010, 0.001, temperature_c=22.0),
            position_bin("y_up", 0.015, 0.002, temperature_c=23.5),
        ]
    )
    assert result.positions == ("z_up", "y_up")
    assert result.bias_dph == pytest.approx(0.011)
    assert result.p_value == pytest.approx(math.erfc(math.sqrt(5.0 / 2.0)))
    assert result.largest_pair == ("y_up", "z_up")
    assert result.largest_difference_dph == pytest.approx(0.005)
    assert result.largest_difference_sigma_dph == pytest.approx(math.hypot(0.001, 0.002))
    assert result.temperature_spread_c == pytest.approx(1.5)


def test_the_papers_method_is_compared_in_the_same_way():
    bins = [
        replace(position_bin(p, 0.0), paper_bias_dph=b, paper_sigma_dph=0.002)
        for p, b in (("z_up", 0.01), ("y_up", 0.0))
    ]
    (result,) = compare_positions(paper_bins([*bins, position_bin("x_up", 0.5)]))
    assert result.positions == ("z_up", "y_up")
    assert result.largest_difference_dph == pytest.approx(0.01)
    assert result.p_value == pytest.approx(math.erfc(math.sqrt(12.5 / 2.0)))


def test_freedom_is_one_less_than_the_positions():
    biases = [0.001, 0.002, 0.003, 0.004]
    (result,) = compare_positions([position_bin(p, b) for p, b in zip(POSITIONS, biases, strict=False)])
    assert result.p_value == pytest.approx(chi2.sf(5.0, 3))
    assert result.largest_pair == ("y_down", "z_up")


def test_positions_that_are_equal_are_seldom_called_different():
    rng = np.random.default_rng(7)
    bins = [position_bin(p, 0.002 * rng.normal(), 0.002, 5.0 * k) for k in range(2000) for p in POSITIONS]
    p_values = np.array([result.p_value for result in compare_positions(bins)])
    assert len(p_values) == 2000
    assert 0.035 < (p_values < 0.05).mean() < 0.065


def test_a_position_apart_is_found():
    bins = [position_bin(p, 0.02 if p == "y_up" else 0.0, 0.002) for p in POSITIONS]
    (result,) = compare_positions(bins)
    assert result.p_value < 1e-12
    assert result.largest_pair[0] == "y_up"


def test_gyros_and_bins_are_kept_apart():
    bins = [
        position_bin(p, 0.0, low_c=low, gyro=gyro)
        for gyro in "zx"
        for low in (25.0, 20.0)
        for p in ("z_up", "y_up")
    ]
    results = compare_positions(bins)
    assert [(r.gyro, r.bin_low_c, r.bin_high_c) for r in results] == [
        ("x", 20.0, 25.0),
        ("x", 25.0, 30.0),
        ("z", 20.0, 25.0),
        ("z", 25.0, 30.0),
    ]


def test_needs_two_positions_that_were_measured():
    empty = position_bin("y_up", math.nan, math.nan, temperature_c=math.nan, count=0)
    assert compare_positions([position_bin("z_up", 0.0), empty]) == []
