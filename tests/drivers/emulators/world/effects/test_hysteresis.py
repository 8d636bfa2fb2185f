from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.drivers.emulators.world.effects.hysteresis import ThermalHysteresis

GAIN, HALF_WIDTH_C = np.array([0.002, -0.001, 0.0]), 5.0
EFFECT = ThermalHysteresis(
    kind="thermal_hysteresis", half_width_c=HALF_WIDTH_C, sensitivity_dph_per_c=GAIN.tolist()
)


@pytest.fixture(scope="module")
def through(conditions):
    """``through(temperatures)``: what a fresh effect adds at the last of them."""

    def go(temperatures_c):
        effect = EFFECT.begin()
        return [effect(conditions(optics_c=optics_c)) for optics_c in temperatures_c][-1]

    return go


def test_at_the_first_temperature_there_is_no_effect(through):
    assert not through([-30.0]).any()


def test_within_the_play_it_goes_back_to_nothing_with_the_temperature(through):
    np.testing.assert_allclose(through([20.0, 23.0]), -3.0 * GAIN)
    assert not through([20.0, 23.0, 17.0, 20.0]).any()


def test_after_heating_and_after_cooling_the_same_temperature_has_biases_on_both_sides(through):
    heated, cooled = through([0.0, 20.0]), through([60.0, 20.0])
    np.testing.assert_allclose(heated, -HALF_WIDTH_C * GAIN)
    np.testing.assert_allclose(cooled, HALF_WIDTH_C * GAIN)


def test_it_stays_however_long_the_temperature_rests(through):
    np.testing.assert_allclose(through([0.0, *[20.0] * 5000]), through([0.0, 20.0]))


def test_a_turn_back_by_twice_the_half_width_closes_the_loop(through):
    np.testing.assert_allclose(through([0.0, 40.0, 35.0]), 0.0 * GAIN, atol=1e-15)
    np.testing.assert_allclose(through([0.0, 40.0, 30.0]), HALF_WIDTH_C * GAIN)


def test_each_gyro_remembers_its_own_temperature(through):
    bias_dph = through([[0.0, 60.0, 0.0], [20.0, 20.0, 20.0]])
    np.testing.assert_allclose(bias_dph, [-5.0 * 0.002, 5.0 * -0.001, 0.0])


@given(turning_c=st.lists(st.floats(-40.0, 80.0), min_size=2, max_size=8), steps=st.sampled_from([2, 7, 300]))
def test_the_rate_of_temperature_does_not_matter(through, turning_c, steps):
    slow = np.concatenate([np.linspace(a, b, steps) for a, b in pairwise(turning_c)])
    np.testing.assert_allclose(through(slow), through(turning_c), atol=1e-12)
    assert np.abs(through(turning_c)).max() <= HALF_WIDTH_C * np.abs(GAIN).max() + 1e-12


def test_two_worlds_of_one_file_remember_nothing_of_each_other(make_world):
    worlds = [make_world(undeclared_effects=[EFFECT.model_dump()]) for _ in range(2)]
    worlds[0].air.set_point_c, worlds[0].air.running = 60.0, True
    worlds[0].advance(3600.0)
    assert np.abs(worlds[0].undeclared_bias()[:2]).min() > 0.0
    assert not worlds[1].undeclared_bias().any()
