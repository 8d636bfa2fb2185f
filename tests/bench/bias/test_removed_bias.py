"""An INS that removes the biases that its alignments find, against units whose biases follow the position."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.removed_bias import removed_directions
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.bias.dwell_rows import dwell_row

SIGMA_DPH, COMMON_DPH, ALIGNMENT_DPH = 0.0012, 0.0004, 0.002
BIAS_DPH = np.array([0.015, -0.012, 0.018])


def rows(seed, bias_dph=BIAS_DPH, removed=(0, 0, 0), by_position=None, azimuths_deg=(0.0,)):
    """Dwells in six positions at each azimuth; ``removed``: shares of the biases East, North and Up."""
    random, result = np.random.default_rng(seed), []
    for azimuth_deg in azimuths_deg:
        for name, position in POSITIONS.items():
            C_nb = position.C_nb(math.radians(azimuth_deg))
            bias = bias_dph + (by_position(C_nb, random) if by_position else 0.0)
            found = C_nb @ bias + ALIGNMENT_DPH * random.standard_normal(3)
            bias = bias - C_nb.T @ (removed * found) + SIGMA_DPH * random.standard_normal(3)
            row = dwell_row(len(result) + 1, name, 20.0, sigma_dph=math.hypot(SIGMA_DPH, COMMON_DPH))
            result.append(
                replace(
                    row,
                    bias_dph=tuple(bias),
                    common_sigma_dph=(COMMON_DPH,) * 3,
                    azimuth_deg=azimuth_deg % 360.0,
                )
            )
    return result


@pytest.mark.parametrize(
    ("removed", "directions"),
    [((0, 1, 0), "North"), ((0, 1, 1), "North and Up"), ((1, 1, 0), "East and North"), ((0, 0, 1), "Up")],
)
def test_the_removed_directions_are_named(removed, directions):
    found = [removed_directions(rows(seed, 2.0 * BIAS_DPH, removed)) for seed in range(20)]
    assert found.count(directions) >= 18


def test_alignments_at_two_azimuths_show_smaller_biases():
    small = 0.5 * BIAS_DPH
    flags = [
        [bool(removed_directions(rows(seed, small, (0, 1, 0), None, azimuths))) for seed in range(20)]
        for azimuths in ((0.0,), (0.0, 90.0))
    ]
    assert sum(flags[0]) < sum(flags[1])
    assert sum(flags[1]) >= 19


@pytest.mark.parametrize("size_dph", [0.0, 0.0005, 0.002, 0.005, 0.02])
def test_a_unit_with_constant_biases_removes_none(size_dph):
    biases = np.random.default_rng(1).uniform(-size_dph, size_dph, (100, 3))
    assert not any(removed_directions(rows(seed, bias)) for seed, bias in enumerate(biases))


@pytest.mark.parametrize(
    "by_position",
    [
        lambda C_nb, random: random.normal(0.0, 0.005, 3),
        lambda C_nb, _: 0.01 * C_nb[2],
        lambda C_nb, _: 0.01 * C_nb[2, 1] * np.ones(3),
    ],
    ids=["scatter", "own axis", "y axis"],
)
@pytest.mark.parametrize("bias_dph", [np.zeros(3), BIAS_DPH], ids=["compensated", "biased"])
def test_biases_that_follow_the_position_are_not_removed(by_position, bias_dph):
    found = [removed_directions(rows(seed, bias_dph, by_position=by_position)) for seed in range(100)]
    assert sum(map(bool, found)) <= 1


def test_dwells_without_biases_or_azimuth_do_not_count():
    dwells = rows(0, removed=(0, 1, 0))
    without = [replace(dwells[0], bias_dph=(math.nan,) * 3), replace(dwells[1], azimuth_deg=math.nan)]
    assert removed_directions([*dwells, *without]) == "North"
    assert removed_directions(without) == removed_directions([]) == ""
