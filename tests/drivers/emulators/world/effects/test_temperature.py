import numpy as np
import pytest

from gyrobench.drivers.emulators.world.effects.temperature import (
    AttitudeThermal,
    TemperatureRate,
    ThermalGradient,
)
from gyrobench.drivers.emulators.world.effects.undeclared_bias import UndeclaredBias
from gyrobench.drivers.emulators.world.sensor_errors import DPH
from gyrobench.drivers.emulators.world.thermal import ThermalNetwork

UPS = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
RATE = TemperatureRate(kind="temperature_rate", sensitivity_dph_per_c_per_h=[1e-4, -2e-4, 0.0])
GRADIENT = ThermalGradient(kind="thermal_gradient", sensitivity_dph_per_c=[1e-3, -2e-3, 0.0])
ATTITUDE = AttitudeThermal(kind="attitude_thermal", sensitivity_dph_per_w=[0.04, -0.02, 0.0])


def test_at_a_steady_temperature_there_is_no_effect_of_the_rate(conditions):
    assert not RATE.added_dph(conditions(optics_c=-20.0)).any()


def test_the_effect_of_the_rate_is_odd_in_the_rate_of_each_gyro(conditions):
    up = RATE.added_dph(conditions(optics_rate_c_per_h=[60.0, 120.0, 60.0]))
    down = RATE.added_dph(conditions(optics_rate_c_per_h=[-60.0, -120.0, -60.0]))
    np.testing.assert_allclose(up, [0.006, -0.024, 0.0])
    np.testing.assert_allclose(down, -up)


def test_the_effect_of_the_gradient_follows_electronics_less_optics_of_each_gyro(conditions):
    now = conditions(optics_c=[20.0, 30.0, 40.0], electronics_c=[32.0, 30.0, 60.0])
    np.testing.assert_allclose(GRADIENT.added_dph(now), [0.012, 0.0, 0.0])
    swapped = conditions(optics_c=now.electronics_c, electronics_c=now.optics_c)
    np.testing.assert_allclose(GRADIENT.added_dph(swapped), -GRADIENT.added_dph(now))


def attitude_dph(conditions, optics_c, convected_w=0.3, effect=ATTITUDE):
    return effect.added_dph(conditions(optics_c=optics_c, convected_w=convected_w))


def test_well_above_the_onset_the_effect_of_attitude_vanishes(conditions):
    assert np.abs(attitude_dph(conditions, 70.0)).max() < 1e-6
    assert np.abs(attitude_dph(conditions, 90.0)).max() < 1e-10


def test_below_the_onset_the_effect_of_attitude_grows_the_colder_it_gets(conditions):
    sizes = [attitude_dph(conditions, optics_c)[0] for optics_c in (60.0, 50.0, 40.0, 20.0, 0.0, -20.0)]
    assert sizes == sorted(sizes)
    assert sizes[1] > 10 * sizes[0]


def test_far_below_the_onset_the_effect_of_attitude_is_proportional_to_heat_and_depth(conditions):
    # Sensitivity times heat flow times the share (50 - T) / 50 of the onset temperature.
    np.testing.assert_allclose(
        attitude_dph(conditions, 10.0), [0.04 * 0.3 * 0.8, -0.02 * 0.3 * 0.8, 0.0], rtol=1e-6
    )
    np.testing.assert_allclose(attitude_dph(conditions, -50.0)[0], 0.04 * 0.3 * 2.0, rtol=1e-6)


def test_the_effect_of_attitude_follows_the_sign_of_the_heat_flow_of_its_own_gyro(conditions):
    flows_w = np.array([0.2, -0.4, 0.3])
    forth, back = attitude_dph(conditions, 10.0, flows_w), attitude_dph(conditions, 10.0, -flows_w)
    np.testing.assert_allclose(forth, -back)
    np.testing.assert_allclose(forth, [0.04 * 0.2 * 0.8, 0.02 * 0.4 * 0.8, 0.0], rtol=1e-6)


def test_each_gyro_has_the_effect_of_attitude_of_its_own_temperature(conditions):
    bias_dph = attitude_dph(conditions, [-20.0, 80.0, 80.0])
    assert bias_dph[0] > 0.01
    assert abs(bias_dph[1]) < 1e-6


def test_a_narrower_onset_is_sharper(conditions):
    narrow = ATTITUDE.model_copy(update={"onset_width_c": 0.5})
    assert attitude_dph(conditions, 53.0, effect=narrow)[0] < 0.01 * attitude_dph(conditions, 53.0)[0]
    np.testing.assert_allclose(
        attitude_dph(conditions, 20.0, effect=narrow), attitude_dph(conditions, 20.0), rtol=1e-4
    )


def test_in_a_world_the_effects_are_those_of_its_thermal_network(make_world):
    effects = [effect.model_dump() for effect in (RATE, GRADIENT)]
    world = make_world(undeclared_effects=effects)
    world.power_unit(True)
    world.advance(600.0)
    before_c = world.thermal.optics_c.copy()
    world.advance(601.0)
    world.advance(601.5)
    world_rate_c_per_h = (world.thermal.optics_c - before_c) * 3600.0
    now_c = world.thermal.electronics_c - world.thermal.optics_c
    assert world_rate_c_per_h.min() > 1.0
    np.testing.assert_allclose(
        world.undeclared_bias() / DPH,
        np.array([1e-4, -2e-4, 0.0]) * world.thermal.optics_rate_c_per_h
        + np.array([1e-3, -2e-3, 0.0]) * now_c,
    )


@pytest.fixture(scope="module")
def position_spread(make_world_file, conditions):
    """``position_spread(name, optics_c)``: how far the six positions of a shipped world are apart, deg/h."""

    def spread_dph(name, optics_c):
        file = make_world_file(name)
        undeclared = UndeclaredBias(file.undeclared_effects)
        biases_dph = []
        for up in UPS:
            net, air_c = ThermalNetwork(file.thermal, optics_c), optics_c - 10.0
            net.powered = True
            for _ in range(6):
                for _ in range(2400):
                    net.step(1.0, air_c, np.array(up, dtype=float))
                air_c += optics_c - net.optics_c.mean()
            assert net.optics_c.mean() == pytest.approx(optics_c, abs=0.5)
            now = conditions(optics_c=net.optics_c, convected_w=net.convected_w, up_body=up)
            biases_dph.append(undeclared.added_dph(now))
        return np.ptp(biases_dph, axis=0)

    return spread_dph


def test_before_the_hardware_change_every_gyro_differs_between_the_positions_in_the_cold(position_spread):
    assert position_spread("gyro_a", -20.0).min() > 0.01


@pytest.mark.parametrize("optics_c", [55.0, 65.0])
def test_before_the_hardware_change_the_positions_agree_when_hot(position_spread, optics_c):
    assert position_spread("gyro_a", optics_c).max() < 0.0005


@pytest.mark.parametrize("optics_c", [-20.0, 10.0, 40.0, 60.0])
def test_after_the_hardware_change_the_positions_practically_agree(position_spread, optics_c):
    assert position_spread("gyro_b", optics_c).max() < 0.001


def test_the_ideal_world_has_nothing_undeclared(position_spread):
    assert position_spread("ideal", -20.0).tolist() == [0.0, 0.0, 0.0]
