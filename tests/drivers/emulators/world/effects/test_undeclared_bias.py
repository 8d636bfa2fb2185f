import numpy as np
import pytest

from gyrobench.drivers.emulators.world.effects.elapsed_time import TimeDrift
from gyrobench.drivers.emulators.world.effects.hysteresis import ThermalHysteresis
from gyrobench.drivers.emulators.world.effects.undeclared_bias import UndeclaredBias
from gyrobench.drivers.emulators.world.sensor_errors import DPH

DRIFT = TimeDrift(kind="time_drift", drift_dph_per_day=[0.01, 0.02, -0.03])
PLAY = ThermalHysteresis(
    kind="thermal_hysteresis", half_width_c=3.0, sensitivity_dph_per_c=[0.001, 0.002, 0.003]
)


def test_without_effects_there_is_no_undeclared_bias(conditions):
    assert UndeclaredBias([]).added_dph(conditions()).tolist() == [0.0, 0.0, 0.0]


def test_effects_add_up_two_of_a_kind_as_well(conditions):
    bias = UndeclaredBias([DRIFT, PLAY, DRIFT])
    bias.added_dph(conditions(optics_c=20.0))
    np.testing.assert_allclose(
        bias.added_dph(conditions(optics_c=30.0, time_s=86_400.0)), [0.017, 0.034, -0.069]
    )


def test_the_true_bias_of_a_world_holds_them_beside_the_declared_one(make_world):
    effects = [DRIFT.model_dump(), PLAY.model_dump()]
    world, plain = (
        make_world("gyro_b", undeclared_effects=effects),
        make_world("gyro_b", undeclared_effects=[]),
    )
    for each in (world, plain):
        each.power_unit(True)
        each.advance(7200.0)
    added = world.true_gyro_bias() - plain.true_gyro_bias()
    np.testing.assert_allclose(added, world.undeclared_bias(), atol=1e-9 * DPH)
    assert np.abs(added).min() > 1e-4 * DPH


@pytest.mark.parametrize("steps_s", [0.37, 1.0, 450.0])
def test_they_do_not_depend_on_how_the_time_is_cut(make_world, steps_s):
    def end(step_s):
        world = make_world(undeclared_effects=[DRIFT.model_dump(), PLAY.model_dump()])
        world.air.set_point_c, world.air.running = 40.0, True
        for time_s in [*np.arange(step_s, 900.0, step_s), 900.0]:
            world.advance(time_s)
        return world.true_gyro_bias().tolist()

    assert end(steps_s) == end(900.0)
