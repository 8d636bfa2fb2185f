import numpy as np
import pytest

from gyrobench.drivers.emulators.world.effects.elapsed_time import BiasJump, SupplyRipple, TimeDrift, WarmUp
from gyrobench.drivers.emulators.world.sensor_errors import DPH

SIZE = np.array([0.02, -0.01, 0.005])
WARM_UP = WarmUp(kind="warm_up", bias_dph=SIZE.tolist(), time_constant_s=1800.0)
DRIFT = TimeDrift(kind="time_drift", drift_dph_per_day=SIZE.tolist())
JUMP = BiasJump(kind="bias_jump", bias_dph=SIZE.tolist(), at_h=2.0)
RIPPLE = SupplyRipple(kind="supply_ripple", amplitude_dph=SIZE.tolist(), period_h=0.5)


def test_the_warm_up_dies_away_with_its_time_constant(conditions):
    for since_s in (0.0, 1800.0, 5400.0):
        added_dph = WARM_UP.added_dph(conditions(since_power_on_s=since_s))
        np.testing.assert_allclose(added_dph, SIZE * np.exp(-since_s / 1800.0))


def test_a_unit_that_is_off_does_not_warm_up(conditions):
    assert not WARM_UP.added_dph(conditions(since_power_on_s=None)).any()


def test_each_power_on_begins_the_warm_up_anew(make_world):
    world = make_world(undeclared_effects=[WARM_UP.model_dump()])
    assert not world.undeclared_bias().any()
    for power_on_s in (100.5, 9000.25):
        world.advance(power_on_s)
        world.power_unit(True)
        np.testing.assert_allclose(world.undeclared_bias() / DPH, SIZE)
        world.advance(power_on_s + 1800.0)
        world.power_unit(True)  # it is on already
        np.testing.assert_allclose(world.undeclared_bias() / DPH, SIZE / np.e, rtol=1e-3)
        world.power_unit(False)
        assert not world.undeclared_bias().any()


def test_the_drift_counts_from_the_beginning_of_the_world_whatever_the_unit_does(conditions, make_world):
    np.testing.assert_allclose(DRIFT.added_dph(conditions(time_s=43_200.0)), SIZE / 2)
    world = make_world(undeclared_effects=[DRIFT.model_dump()])
    assert not world.undeclared_bias().any()
    world.advance(1801.0)
    world.power_unit(True)
    np.testing.assert_allclose(world.undeclared_bias() / DPH, SIZE * 1801.0 / 86_400.0)


@pytest.mark.parametrize(("time_s", "share"), [(0.0, 0), (7199.0, 0), (7200.0, 1), (1e6, 1)])
def test_a_jump_happens_once_and_stays(conditions, time_s, share):
    np.testing.assert_allclose(JUMP.added_dph(conditions(time_s=time_s)), share * SIZE)


@pytest.mark.parametrize(
    ("time_s", "share"), [(0.0, 0.0), (450.0, 1.0), (900.0, 0.0), (1350.0, -1.0), (2250.0, 1.0)]
)
def test_the_ripple_swings_with_its_period(conditions, time_s, share):
    np.testing.assert_allclose(RIPPLE.added_dph(conditions(time_s=time_s)), share * SIZE, atol=1e-12)


def test_the_ripple_has_its_phase_at_the_beginning_of_the_world(conditions):
    shifted = RIPPLE.model_copy(update={"phase_deg": 30.0})
    np.testing.assert_allclose(shifted.added_dph(conditions(time_s=0.0)), 0.5 * SIZE)
