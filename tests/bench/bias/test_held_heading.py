"""Headings that an aid of the INS holds, from random walks, biases and the motion of a free heading."""

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.held_heading import held_heading_s
from gyrobench.bench.bias.noise_estimate import RestMotion
from gyrobench.bench.navigation.earth import MEAN_RADIUS, earth_rate_enu
from gyrobench.bench.navigation.error_model import Site
from tests.bench.bias.emulated_dwells import DPH

SITE = Site(math.radians(36.4), 60.0)
TIME_S = np.arange(601.0)
WALK = 1e-7  # rad/sqrt(s)
NONE = (SITE, 0.0)


def motion(rotation, velocity=0.0, begin_s=0.0):
    velocities = np.column_stack([np.full(601, velocity) * np.ones(601), np.zeros(601)])
    return RestMotion(begin_s + TIME_S, velocities, rotation, np.ones(600), np.eye(3))


def dwells(random, count=6, bias_dph=0.0, time_constant_s=math.inf, drift_dph_per_h=0.0):
    """Two windows each, of a unit with this bias of the vertical gyro, turned over from dwell to dwell.

    Velocity and tilt turn a free heading too.
    """
    result = []
    for number in range(count):
        windows = []
        for begin_s in (0.0, 628.0):
            rotation = np.cumsum(random.standard_normal((601, 3)), axis=0) * WALK
            rotation -= rotation[0]
            rotation[:, 0] += random.normal(0.0, 0.02 * DPH) * TIME_S
            velocity = random.normal(0.0, 1e-3) * TIME_S
            rate = (-1.0) ** number * bias_dph * DPH + drift_dph_per_h * DPH / 3600.0 * (begin_s + TIME_S)
            rate += earth_rate_enu(SITE.latitude)[1] * rotation[:, 0]
            rate -= math.tan(SITE.latitude) / MEAN_RADIUS * velocity
            steps = np.diff(rotation[:, 2] + np.cumsum(rate), prepend=0.0)
            heading = 0.0
            for index, step in enumerate(steps):
                heading = (heading + step) * math.exp(-1.0 / time_constant_s)
                rotation[index, 2] = heading
            windows.append(motion(rotation, velocity, begin_s))
        result.append(windows)
    return result


@pytest.mark.parametrize(
    ("heading", "vibration"),
    [
        pytest.param(1.0, 0.0, marks=pytest.mark.long),
        pytest.param(0.5, 0.0, marks=pytest.mark.long),
        (2.0, 0.0),
        (1.0, 5.0),
    ],
)
def test_a_heading_that_walks_is_not_held_whatever_its_gyro_or_its_table(heading, vibration):
    random = np.random.default_rng(17)
    held = []
    for _ in range(20):
        windows = []
        for _ in range(12):
            rotation = np.cumsum(random.standard_normal((601, 3)), axis=0) * [1.0, 1.0, heading]
            rotation[:, 2] += vibration * np.sin(TIME_S / 5.0 + random.uniform(0.0, 6.0))
            windows.append(motion(WALK * rotation))
        held.append(held_heading_s([windows[:2], *([each] for each in windows[2:])], 1e-9, *NONE))
    assert held == [None] * 20
    assert held_heading_s([], 1e-9, *NONE) is None
    assert held_heading_s([windows], 1e-4, *NONE) is None  # too coarse


@pytest.mark.parametrize(("time_constant_s", "bias_dph"), [(60.0, 0.005), (200.0, 0.01), (500.0, 0.02)])
def test_a_slow_aid_shows_by_the_decay_of_the_biases(time_constant_s, bias_dph):
    aided = dwells(np.random.default_rng(18), 6, bias_dph, time_constant_s)
    assert held_heading_s(aided, 1e-9, *NONE) == pytest.approx(time_constant_s, rel=0.5)


@pytest.mark.parametrize(
    ("bias_dph", "drift_dph_per_h"), [(0.02, 0.0), (0.1, 0.0), (0.02, -0.05), (0.01, 0.1)]
)
def test_biases_velocities_and_drifts_are_no_aid(bias_dph, drift_dph_per_h):
    free = dwells(np.random.default_rng(19), 12, bias_dph, drift_dph_per_h=drift_dph_per_h)
    assert held_heading_s(free, 1e-9, *NONE) is None


@pytest.mark.parametrize("step_rad", [0.0, 1e-8])
def test_a_heading_that_never_moves_is_held(step_rad):
    held = [
        [replace(each, rotation_enu=each.rotation_enu * [1.0, 1.0, 0.0]) for each in windows]
        for windows in dwells(np.random.default_rng(20))
    ]
    assert held_heading_s(held, step_rad, *NONE) is not None


def test_windows_of_hours_cost_little_memory():
    time_s = np.arange(7201.0)
    rotation = np.cumsum(np.random.default_rng(21).standard_normal((7201, 3)), axis=0) * WALK
    windows = [
        RestMotion(begin_s + time_s, np.zeros((7201, 2)), rotation, np.ones(7200), np.eye(3))
        for begin_s in (0.0, 7230.0)
    ]
    tracemalloc.start()
    assert held_heading_s([windows], 1e-9, *NONE) is None
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100e6


@pytest.mark.parametrize("seed", range(3))
def test_a_heading_within_its_rounding_is_not_held(seed):
    random, step_rad = np.random.default_rng(seed), 8.6e-5
    windows = []
    for begin_s in 628.0 * np.arange(24):
        switches = random.random((601, 3)) < 0.03 * (random.random(3) < 0.4)
        rotation = step_rad * (np.cumsum(switches, axis=0) % 2)
        windows.append(motion(rotation - rotation[0], begin_s=begin_s))
    assert held_heading_s([windows[i : i + 2] for i in range(0, 24, 2)], step_rad, *NONE) is None
