import numpy as np
import pytest

from gyrobench.drivers.emulators.world.effects.surroundings import ChamberState, GSensitivity
from gyrobench.drivers.emulators.world.sensor_errors import DPH
from gyrobench.drivers.emulators.world.world import INNER, OUTER

CHAMBER = ChamberState(kind="chamber_state", bias_dph=[0.012, -0.010, 0.008])
ROWS = [[0.001, 0.002, 0.003], [0.004, 0.005, 0.006], [0.007, 0.008, 0.009]]


def g_sensitivity(values):
    return GSensitivity(kind="g_sensitivity", sensitivity_dph_per_g=values)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_matrix_gives_every_gyro_its_sensitivity_to_the_axis_that_points_up(conditions, axis):
    up = np.eye(3)[axis]
    added_dph = g_sensitivity(ROWS).added_dph(conditions(up_body=up))
    np.testing.assert_allclose(added_dph, np.array(ROWS)[:, axis])
    np.testing.assert_allclose(g_sensitivity(ROWS).added_dph(conditions(up_body=-up)), -added_dph)


def test_three_values_are_sensitivities_along_each_gyros_own_axis(conditions):
    added_dph = g_sensitivity([0.01, 0.02, 0.03]).added_dph(conditions(up_body=[0.6, -0.8, 0.0]))
    np.testing.assert_allclose(added_dph, [0.006, -0.016, 0.0])


def test_temperature_plays_no_part_in_it(conditions):
    cold, hot = (conditions(optics_c=optics_c) for optics_c in (-30.0, 70.0))
    assert g_sensitivity(ROWS).added_dph(cold).tolist() == g_sensitivity(ROWS).added_dph(hot).tolist()


def test_in_a_world_the_table_decides_where_up_is(make_world):
    world = make_world(undeclared_effects=[g_sensitivity(ROWS).model_dump()])
    np.testing.assert_allclose(world.undeclared_bias() / DPH, [0.003, 0.006, 0.009], atol=1e-12)
    world.axes[OUTER].move_to(90.0, 0.0)  # about East: y points up
    world.advance(60.0)
    np.testing.assert_allclose(world.undeclared_bias() / DPH, [0.002, 0.005, 0.008], atol=1e-9)
    world.axes[INNER].move_to(-90.0, 60.0)
    world.advance(120.0)
    np.testing.assert_allclose(world.undeclared_bias() / DPH, ROWS @ world.attitude()[2], atol=1e-9)


def test_in_the_turn_about_the_vertical_gravity_stays_where_it_is(make_world):
    world = make_world(undeclared_effects=[g_sensitivity(ROWS).model_dump()])
    before = world.undeclared_bias()
    world.axes[INNER].move_to(180.0, 0.0)
    for time_s in range(1, 30):
        world.advance(float(time_s))
        np.testing.assert_allclose(world.undeclared_bias(), before, atol=1e-6 * DPH)


def test_the_bias_follows_the_share_of_time_that_the_compressor_runs(conditions):
    for duty in (0.0, 0.3, 1.0):
        added_dph = CHAMBER.added_dph(conditions(compressor_duty=duty))
        np.testing.assert_allclose(added_dph, duty * np.array([0.012, -0.010, 0.008]))


def test_in_a_world_all_of_it_is_there_on_a_ramp_down_some_in_the_cold_and_nothing_in_the_heat(make_world):
    world = make_world(undeclared_effects=[CHAMBER.model_dump()])

    def share_after(set_point_c, minutes):
        world.air.set_point_c, world.air.ramp_rate_c_per_min, world.air.running = set_point_c, 2.0, True
        world.advance(world_time_s[0] + 60.0 * minutes)
        world_time_s[0] += 60.0 * minutes
        return world.undeclared_bias()[0] / DPH / 0.012

    world_time_s = [0.0]
    assert share_after(60.0, 10) == 0.0  # heating
    assert share_after(60.0, 120) == 0.0  # holding hot
    assert share_after(-20.0, 20) == pytest.approx(1.0)  # cooling
    assert 0.2 < share_after(-20.0, 180) < 0.6  # holding cold
    world.air.running = False
    assert share_after(-20.0, 0) >= 0.0
