"""Several units on one table: what they share, and what they give each other."""

import numpy as np
import pytest

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS
from gyrobench.drivers.emulators.world.world import INNER, World

HEATING = {"from_unit": 2, "to_unit": 1, "coupling_k_per_w": 0.1, "time_constant_s": 300.0}
POWER_W, SENSITIVITY = 21.0, [0.006, -0.005, 0.004]


@pytest.fixture
def pair(make_world_file):
    """Make two units of the world quick on one table."""

    def make(**sections):
        file = make_world_file("quick", **sections)
        first = World(file, 0)
        return first, World(file.of_unit(2), 0, 0, first.surroundings, 2)

    return make


def advance(units, until_s, step_s=7.3):
    for time_s in np.arange(step_s, until_s + step_s, step_s):
        for unit in units:
            unit.advance(min(float(time_s), until_s))


def test_the_neighbours_heat_warms_the_air_with_its_time_constant(pair):
    effect = {"kind": "neighbouring_unit", "sensitivity_dph_per_k": SENSITIVITY}
    first, second = pair(neighbour_heating=[HEATING], undeclared_effects=[effect])
    second.power_unit(True)
    rises_k = []
    for time_s in (300.0, 3000.0):
        advance((first, second), time_s)
        rises_k.append(first.undeclared_bias()[0] / DPH_TO_RADPS / SENSITIVITY[0])
    assert rises_k == pytest.approx([0.1 * POWER_W * (1.0 - np.exp(-1.0)), 0.1 * POWER_W], rel=1e-3)
    case_c, air_c = first.thermal.nodes_c[0], first.air.air_c
    assert case_c - air_c == pytest.approx(0.1 * POWER_W, rel=0.02)
    assert not second.undeclared_bias().any()
    second.power_unit(False)
    advance((first, second), 6000.0)
    assert np.abs(first.undeclared_bias()).max() < 1e-4 * DPH_TO_RADPS


def test_the_heat_does_not_depend_on_how_the_time_is_split(pair):
    cases_c = []
    for step_s in (1.0, 7.3, 50.0):
        first, second = pair(neighbour_heating=[HEATING])
        second.power_unit(True)
        advance((first, second), 600.0, step_s)
        cases_c.append(first.thermal.nodes_c[0])
    assert cases_c == pytest.approx([cases_c[0]] * 3, abs=1e-9)


def test_without_heating_a_unit_is_as_if_it_were_alone(pair, make_world):
    alone, (first, second) = make_world("quick"), pair()
    for unit in (alone, first):
        unit.power_unit(True)
    second.power_unit(True)
    for world in (alone, first):
        world.air.set_point_c, world.air.running = 40.0, True
        world.axes[INNER].move_to(90.0, 0.0)
    advance((alone,), 500.0)
    advance((first, second), 500.0)
    assert first.thermal.nodes_c.tolist() == alone.thermal.nodes_c.tolist()
    assert first.true_gyro_bias().tolist() == alone.true_gyro_bias().tolist()
    assert second.true_gyro_bias().tolist() != first.true_gyro_bias().tolist()
    np.testing.assert_array_equal(second.thermal.nodes_c, first.thermal.nodes_c)
    np.testing.assert_array_equal(second.attitude(), first.attitude())


def test_a_unit_that_joins_late_starts_in_the_air_of_that_time(make_world_file):
    file = make_world_file("quick")
    first = World(file, 0)
    first.air.set_point_c, first.air.running = 40.0, True
    advance((first,), 300.0)
    second = World(file.of_unit(2), 0, 0, first.surroundings, 2)
    advance((first, second), 310.0)
    assert second.air.air_c == first.air.air_c
    assert 23.0 < second.thermal.nodes_c[0] < second.air.air_c


def test_a_unit_is_mounted_as_the_world_says(pair):
    first, second = pair(
        units=[{"mounting": {"x": "south", "y": "east", "z": "up"}, "mounting_error_arcsec": [0, 0, 0]}],
        table={"mounting_error_arcsec": [0, 0, 0]},
    )
    x, y, z = (first.attitude().T @ second.attitude()).T
    np.testing.assert_allclose((x, y, z), ((0, -1, 0), (1, 0, 0), (0, 0, 1)), atol=1e-9)
