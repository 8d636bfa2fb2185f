import numpy as np
import pytest

from bench.documents import find_document
from drivers.emulators.world.document import AttitudeThermalEffect, load_world
from drivers.emulators.world.effects import undeclared_bias
from drivers.emulators.world.sensor_errors import DPH
from drivers.emulators.world.thermal import ThermalNetwork

UPS = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
EFFECT = AttitudeThermalEffect(kind="attitude_thermal", sensitivity_dph_per_w=[0.04, -0.02, 0.0])


def heated(optics_c, convected_w=(0.3, 0.3, 0.3)):
    """A network that is at the moment in that state."""
    net = ThermalNetwork(load_world(find_document("worlds", "gyro_a")).thermal, 23.0)
    net.nodes_c[1:4] = optics_c
    net.convected_w[:] = convected_w
    return net


def effect_dph(net, *effects):
    return undeclared_bias(list(effects or (EFFECT,)), net) / DPH


def test_without_effects_there_is_no_undeclared_bias():
    assert undeclared_bias([], heated(-20.0)).tolist() == [0.0, 0.0, 0.0]


def test_well_above_the_onset_the_effect_vanishes():
    assert np.abs(effect_dph(heated(70.0))).max() < 1e-6
    assert np.abs(effect_dph(heated(90.0))).max() < 1e-10


def test_below_the_onset_the_effect_grows_the_colder_it_gets():
    sizes = [effect_dph(heated(optics_c))[0] for optics_c in (60.0, 50.0, 40.0, 20.0, 0.0, -20.0)]
    assert sizes == sorted(sizes)
    assert sizes[1] > 10 * sizes[0]


def test_far_below_the_onset_the_effect_is_proportional_to_heat_and_depth():
    # Sensitivity times heat flow times the share (50 - T) / 50 of the onset temperature.
    np.testing.assert_allclose(
        effect_dph(heated(10.0)), [0.04 * 0.3 * 0.8, -0.02 * 0.3 * 0.8, 0.0], rtol=1e-6
    )
    np.testing.assert_allclose(effect_dph(heated(-50.0))[0], 0.04 * 0.3 * 2.0, rtol=1e-6)


def test_the_effect_follows_the_sign_of_the_heat_flow_of_its_own_gyro():
    flows_w = np.array([0.2, -0.4, 0.3])
    forth, back = effect_dph(heated(10.0, flows_w)), effect_dph(heated(10.0, -flows_w))
    np.testing.assert_allclose(forth, -back)
    np.testing.assert_allclose(forth, [0.04 * 0.2 * 0.8, 0.02 * 0.4 * 0.8, 0.0], rtol=1e-6)


def test_each_gyro_has_the_effect_of_its_own_temperature():
    bias_dph = effect_dph(heated([-20.0, 80.0, 80.0]))
    assert bias_dph[0] > 0.01
    assert abs(bias_dph[1]) < 1e-6


def test_a_narrower_onset_is_sharper():
    narrow = EFFECT.model_copy(update={"onset_width_c": 0.5})
    assert effect_dph(heated(53.0), narrow)[0] < 0.01 * effect_dph(heated(53.0))[0]
    np.testing.assert_allclose(effect_dph(heated(20.0), narrow), effect_dph(heated(20.0)), rtol=1e-4)


def test_effects_add_up():
    np.testing.assert_allclose(effect_dph(heated(10.0), EFFECT, EFFECT), 2 * effect_dph(heated(10.0)))


def position_spread(name, optics_c):
    """Largest difference between any two of the six positions in deg/h, each gyro, at steady states."""
    file = load_world(find_document("worlds", name))
    biases_dph = []
    for up in UPS:
        net, air_c = ThermalNetwork(file.thermal, optics_c), optics_c - 10.0
        net.powered = True
        for _ in range(6):
            for _ in range(2400):
                net.step(1.0, air_c, np.array(up, dtype=float))
            air_c += optics_c - net.optics_c.mean()
        assert net.optics_c.mean() == pytest.approx(optics_c, abs=0.5)
        biases_dph.append(
            effect_dph(net, *file.undeclared_effects) if file.undeclared_effects else np.zeros(3)
        )
    return np.ptp(biases_dph, axis=0)


def test_before_the_hardware_change_every_gyro_differs_between_the_positions_in_the_cold():
    assert position_spread("gyro_a", -20.0).min() > 0.01


@pytest.mark.parametrize("optics_c", [55.0, 65.0])
def test_before_the_hardware_change_the_positions_agree_when_hot(optics_c):
    assert position_spread("gyro_a", optics_c).max() < 0.0005


@pytest.mark.parametrize(
    "optics_c",
    [
        -20.0,
        10.0,
        40.0,
        60.0,
    ],
)
def test_after_the_hardware_change_the_positions_practically_agree(optics_c):
    assert position_spread("gyro_b", optics_c).max() < 0.001


def test_the_ideal_world_has_nothing_undeclared():
    assert position_spread("ideal", -20.0).tolist() == [0.0, 0.0, 0.0]
