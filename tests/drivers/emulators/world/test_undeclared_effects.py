import math
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS
from gyrobench.bench.foundations.documents import parse_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.drivers.emulators.world.thermal import ThermalNetwork
from gyrobench.drivers.emulators.world.undeclared_effects import (
    AttitudeThermal,
    BiasJump,
    ChamberState,
    Conditions,
    DitherCrossing,
    GSensitivity,
    LooseClamp,
    ModeHop,
    SupplyRipple,
    TemperatureRate,
    ThermalGradient,
    ThermalHysteresis,
    TimeDrift,
    UndeclaredBias,
    WarmUp,
)
from gyrobench.drivers.emulators.world.world import INNER, OUTER

TRIPLES = ("optics_c", "electronics_c", "optics_rate_c_per_h", "convected_w", "up_body")


def conditions(**changes):
    """Conditions of a unit at 25 degC, level, long after power-on, with some of them changed.

    One number for a value of three gyros stands for all of them.
    """
    usual = {
        "time_s": 1e5,
        "since_power_on_s": 1e5,
        "optics_c": 25.0,
        "electronics_c": 37.0,
        "optics_rate_c_per_h": 0.0,
        "convected_w": 0.0,
        "up_body": (0.0, 0.0, 1.0),
        "compressor_duty": 0.0,
    }
    values = usual | changes
    for name in TRIPLES:
        values[name] = np.broadcast_to(np.asarray(values[name], dtype=float), 3)
    return Conditions(**values)


UPS = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
RATE = TemperatureRate(kind="temperature_rate", sensitivity_dph_per_c_per_h=[1e-4, -2e-4, 0.0])
GRADIENT = ThermalGradient(kind="thermal_gradient", sensitivity_dph_per_c=[1e-3, -2e-3, 0.0])
ATTITUDE = AttitudeThermal(kind="attitude_thermal", sensitivity_dph_per_w=[0.04, -0.02, 0.0])


def test_at_a_steady_temperature_there_is_no_effect_of_the_rate():
    assert not RATE.added_dph(conditions(optics_c=-20.0)).any()


def test_the_effect_of_the_rate_is_odd_in_the_rate_of_each_gyro():
    up = RATE.added_dph(conditions(optics_rate_c_per_h=[60.0, 120.0, 60.0]))
    down = RATE.added_dph(conditions(optics_rate_c_per_h=[-60.0, -120.0, -60.0]))
    np.testing.assert_allclose(up, [0.006, -0.024, 0.0])
    np.testing.assert_allclose(down, -up)


def test_the_effect_of_the_gradient_follows_electronics_less_optics_of_each_gyro():
    now = conditions(optics_c=[20.0, 30.0, 40.0], electronics_c=[32.0, 30.0, 60.0])
    np.testing.assert_allclose(GRADIENT.added_dph(now), [0.012, 0.0, 0.0])
    swapped = conditions(optics_c=now.electronics_c, electronics_c=now.optics_c)
    np.testing.assert_allclose(GRADIENT.added_dph(swapped), -GRADIENT.added_dph(now))


def attitude_dph(optics_c, convected_w=0.3, effect=ATTITUDE):
    return effect.added_dph(conditions(optics_c=optics_c, convected_w=convected_w))


def test_well_above_the_onset_the_effect_of_attitude_vanishes():
    assert np.abs(attitude_dph(70.0)).max() < 1e-6
    assert np.abs(attitude_dph(90.0)).max() < 1e-10


def test_below_the_onset_the_effect_of_attitude_grows_the_colder_it_gets():
    sizes = [attitude_dph(optics_c)[0] for optics_c in (60.0, 50.0, 40.0, 20.0, 0.0, -20.0)]
    assert sizes == sorted(sizes)
    assert sizes[1] > 10 * sizes[0]


def test_far_below_the_onset_the_effect_of_attitude_is_proportional_to_heat_and_depth():
    # Sensitivity times heat flow times the share (50 - T) / 50 of the onset temperature.
    np.testing.assert_allclose(attitude_dph(10.0), [0.04 * 0.3 * 0.8, -0.02 * 0.3 * 0.8, 0.0], rtol=1e-6)
    np.testing.assert_allclose(attitude_dph(-50.0)[0], 0.04 * 0.3 * 2.0, rtol=1e-6)


def test_the_effect_of_attitude_follows_the_sign_of_the_heat_flow_of_its_own_gyro():
    flows_w = np.array([0.2, -0.4, 0.3])
    forth, back = attitude_dph(10.0, flows_w), attitude_dph(10.0, -flows_w)
    np.testing.assert_allclose(forth, -back)
    np.testing.assert_allclose(forth, [0.04 * 0.2 * 0.8, 0.02 * 0.4 * 0.8, 0.0], rtol=1e-6)


def test_each_gyro_has_the_effect_of_attitude_of_its_own_temperature():
    bias_dph = attitude_dph([-20.0, 80.0, 80.0])
    assert bias_dph[0] > 0.01
    assert abs(bias_dph[1]) < 1e-6


def test_a_narrower_onset_is_sharper():
    narrow = ATTITUDE.model_copy(update={"onset_width_c": 0.5})
    assert attitude_dph(53.0, effect=narrow)[0] < 0.01 * attitude_dph(53.0)[0]
    np.testing.assert_allclose(attitude_dph(20.0, effect=narrow), attitude_dph(20.0), rtol=1e-4)


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
        world.undeclared_bias() / DPH_TO_RADPS,
        np.array([1e-4, -2e-4, 0.0]) * world.thermal.course.optics_rate_c_per_h[-1]
        + np.array([1e-3, -2e-3, 0.0]) * now_c,
    )


@pytest.fixture(scope="module")
def position_spread(make_world_file):
    """``position_spread(name, optics_c)``: how far the six positions of a shipped world are apart, deg/h."""

    def spread_dph(name, optics_c):
        file = make_world_file(name)
        undeclared = UndeclaredBias(file.undeclared_effects)
        biases_dph = []
        for up in UPS:
            net, air_c = ThermalNetwork(file.thermal, optics_c), optics_c - 10.0
            net.powered = True
            for _ in range(6):
                net.step(1.0, np.full(2400, air_c), np.array(up, dtype=float))
                air_c += optics_c - net.optics_c.mean()
            assert net.optics_c.mean() == pytest.approx(optics_c, abs=0.5)
            now = conditions(optics_c=net.optics_c, convected_w=net.course.convected_w[-1], up_body=up)
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


GAIN, HALF_WIDTH_C = np.array([0.002, -0.001, 0.0]), 5.0
EFFECT = ThermalHysteresis(
    kind="thermal_hysteresis", half_width_c=HALF_WIDTH_C, sensitivity_dph_per_c=GAIN.tolist()
)


def through(temperatures_c):
    """What a fresh effect adds at the last of the temperatures."""
    effect = EFFECT.start()
    return [effect(conditions(optics_c=optics_c)) for optics_c in temperatures_c][-1]


def test_at_the_first_temperature_there_is_no_effect():
    assert not through([-30.0]).any()


def test_within_the_play_it_goes_back_to_nothing_with_the_temperature():
    np.testing.assert_allclose(through([20.0, 23.0]), -3.0 * GAIN)
    assert not through([20.0, 23.0, 17.0, 20.0]).any()


def test_after_heating_and_after_cooling_the_same_temperature_has_biases_on_both_sides():
    heated, cooled = through([0.0, 20.0]), through([60.0, 20.0])
    np.testing.assert_allclose(heated, -HALF_WIDTH_C * GAIN)
    np.testing.assert_allclose(cooled, HALF_WIDTH_C * GAIN)


def test_it_stays_however_long_the_temperature_rests():
    np.testing.assert_allclose(through([0.0, *[20.0] * 5000]), through([0.0, 20.0]))


def test_a_turn_back_by_twice_the_half_width_closes_the_loop():
    np.testing.assert_allclose(through([0.0, 40.0, 35.0]), 0.0 * GAIN, atol=1e-15)
    np.testing.assert_allclose(through([0.0, 40.0, 30.0]), HALF_WIDTH_C * GAIN)


def test_each_gyro_remembers_its_own_temperature():
    bias_dph = through([[0.0, 60.0, 0.0], [20.0, 20.0, 20.0]])
    np.testing.assert_allclose(bias_dph, [-5.0 * 0.002, 5.0 * -0.001, 0.0])


@given(turning_c=st.lists(st.floats(-40.0, 80.0), min_size=2, max_size=8), steps=st.sampled_from([2, 7, 300]))
def test_the_rate_of_temperature_does_not_matter(turning_c, steps):
    slow = np.concatenate([np.linspace(a, b, steps) for a, b in pairwise(turning_c)])
    np.testing.assert_allclose(through(slow), through(turning_c), atol=1e-12)
    assert np.abs(through(turning_c)).max() <= HALF_WIDTH_C * np.abs(GAIN).max() + 1e-12


def test_two_worlds_of_one_file_remember_nothing_of_each_other(make_world):
    worlds = [make_world(undeclared_effects=[EFFECT.model_dump()]) for _ in range(2)]
    worlds[0].air.set_point_c, worlds[0].air.running = 60.0, True
    worlds[0].advance(3600.0)
    assert np.abs(worlds[0].undeclared_bias()[:2]).min() > 0.0
    assert not worlds[1].undeclared_bias().any()


SIZE = np.array([0.02, -0.01, 0.005])
WARM_UP = WarmUp(kind="warm_up", bias_dph=SIZE.tolist(), time_constant_s=1800.0)
TIME_DRIFT = TimeDrift(kind="time_drift", drift_dph_per_day=SIZE.tolist())
JUMP = BiasJump(kind="bias_jump", bias_dph=SIZE.tolist(), at_h=2.0)
RIPPLE = SupplyRipple(kind="supply_ripple", amplitude_dph=SIZE.tolist(), period_h=0.5)


def test_the_warm_up_dies_away_with_its_time_constant():
    for since_s in (0.0, 1800.0, 5400.0):
        added_dph = WARM_UP.added_dph(conditions(since_power_on_s=since_s))
        np.testing.assert_allclose(added_dph, SIZE * np.exp(-since_s / 1800.0))


def test_a_warm_up_may_be_over_at_once():
    shortest = WARM_UP.model_copy(update={"time_constant_s": 1e-310})
    assert not shortest.added_dph(conditions(since_power_on_s=np.float64(1e7))).any()


def test_a_unit_that_is_off_does_not_warm_up():
    assert not WARM_UP.added_dph(conditions(since_power_on_s=math.inf)).any()


def test_each_power_on_restarts_the_warm_up(make_world):
    world = make_world(undeclared_effects=[WARM_UP.model_dump()])
    assert not world.undeclared_bias().any()
    for power_on_s in (100.5, 9000.25):
        world.advance(power_on_s)
        world.power_unit(True)
        np.testing.assert_allclose(world.undeclared_bias() / DPH_TO_RADPS, SIZE)
        world.advance(power_on_s + 1800.0)
        world.power_unit(True)  # it is on already
        np.testing.assert_allclose(world.undeclared_bias() / DPH_TO_RADPS, SIZE / np.e, rtol=1e-3)
        world.power_unit(False)
        assert not world.undeclared_bias().any()


def test_the_drift_counts_from_the_start_of_the_world_in_any_state_of_the_unit(make_world):
    np.testing.assert_allclose(TIME_DRIFT.added_dph(conditions(time_s=43_200.0)), SIZE / 2)
    world = make_world(undeclared_effects=[TIME_DRIFT.model_dump()])
    assert not world.undeclared_bias().any()
    world.advance(1801.0)
    world.power_unit(True)
    np.testing.assert_allclose(world.undeclared_bias() / DPH_TO_RADPS, SIZE * 1801.0 / 86_400.0)


@pytest.mark.parametrize(("time_s", "share"), [(0.0, 0), (7199.0, 0), (7200.0, 1), (1e6, 1)])
def test_a_jump_happens_once_and_stays(time_s, share):
    np.testing.assert_allclose(JUMP.added_dph(conditions(time_s=time_s)), share * SIZE)


@pytest.mark.parametrize(
    ("time_s", "share"), [(0.0, 0.0), (450.0, 1.0), (900.0, 0.0), (1350.0, -1.0), (2250.0, 1.0)]
)
def test_the_ripple_swings_with_its_period(time_s, share):
    np.testing.assert_allclose(RIPPLE.added_dph(conditions(time_s=time_s)), share * SIZE, atol=1e-12)


def test_the_ripple_has_its_phase_at_the_beginning_of_the_world():
    shifted = RIPPLE.model_copy(update={"phase_deg": 30.0})
    np.testing.assert_allclose(shifted.added_dph(conditions(time_s=0.0)), 0.5 * SIZE)


CHAMBER = ChamberState(kind="chamber_state", bias_dph=[0.012, -0.010, 0.008])
ROWS = [[0.001, 0.002, 0.003], [0.004, 0.005, 0.006], [0.007, 0.008, 0.009]]


def g_sensitivity(values):
    return GSensitivity(kind="g_sensitivity", sensitivity_dph_per_g=values)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_matrix_gives_every_gyro_its_sensitivity_to_the_axis_that_points_up(axis):
    up = np.eye(3)[axis]
    added_dph = g_sensitivity(ROWS).added_dph(conditions(up_body=up))
    np.testing.assert_allclose(added_dph, np.array(ROWS)[:, axis])
    np.testing.assert_allclose(g_sensitivity(ROWS).added_dph(conditions(up_body=-up)), -added_dph)


def test_three_values_are_sensitivities_along_each_gyros_own_axis():
    added_dph = g_sensitivity([0.01, 0.02, 0.03]).added_dph(conditions(up_body=[0.6, -0.8, 0.0]))
    np.testing.assert_allclose(added_dph, [0.006, -0.016, 0.0])


def test_temperature_plays_no_part_in_it():
    cold, hot = (conditions(optics_c=optics_c) for optics_c in (-30.0, 70.0))
    assert g_sensitivity(ROWS).added_dph(cold).tolist() == g_sensitivity(ROWS).added_dph(hot).tolist()


def test_in_a_world_the_table_decides_where_up_is(make_world):
    world = make_world(undeclared_effects=[g_sensitivity(ROWS).model_dump()])
    np.testing.assert_allclose(world.undeclared_bias() / DPH_TO_RADPS, [0.003, 0.006, 0.009], atol=1e-12)
    world.axes[OUTER].move_to(90.0, 0.0)  # about East: y points up
    world.advance(60.0)
    np.testing.assert_allclose(world.undeclared_bias() / DPH_TO_RADPS, [0.002, 0.005, 0.008], atol=1e-9)
    world.axes[INNER].move_to(-90.0, 60.0)
    world.advance(120.0)
    np.testing.assert_allclose(world.undeclared_bias() / DPH_TO_RADPS, ROWS @ world.attitude()[2], atol=1e-9)


def test_with_a_lag_the_bias_follows_a_new_attitude_after_it_however_time_is_cut(make_world):
    effect = g_sensitivity(ROWS).model_dump() | {"lag_s": 100.0}
    worlds = [make_world(undeclared_effects=[effect]) for _ in range(2)]
    for world in worlds:
        np.testing.assert_allclose(world.undeclared_bias() / DPH_TO_RADPS, [0.003, 0.006, 0.009], atol=1e-12)
        world.axes[OUTER].move_to(90.0, 0.0)  # about East: y points up
        world.advance(60.0)
    settled = np.array(ROWS)[:, 1] * DPH_TO_RADPS
    before = worlds[0].undeclared_bias() - settled
    worlds[0].advance(160.0)
    for time_s in np.arange(60.5, 160.5, 0.5):
        worlds[1].advance(time_s)
    np.testing.assert_allclose(worlds[0].undeclared_bias() - settled, before * np.exp(-1.0), rtol=1e-6)
    np.testing.assert_allclose(worlds[1].undeclared_bias(), worlds[0].undeclared_bias(), rtol=1e-9)


def test_in_the_turn_about_the_vertical_gravity_stays_where_it_is(make_world):
    world = make_world(undeclared_effects=[g_sensitivity(ROWS).model_dump()])
    before = world.undeclared_bias()
    world.axes[INNER].move_to(180.0, 0.0)
    for time_s in range(1, 30):
        world.advance(float(time_s))
        np.testing.assert_allclose(world.undeclared_bias(), before, atol=1e-6 * DPH_TO_RADPS)


def test_the_bias_follows_the_share_of_time_that_the_compressor_runs():
    for duty in (0.0, 0.3, 1.0):
        added_dph = CHAMBER.added_dph(conditions(compressor_duty=duty))
        np.testing.assert_allclose(added_dph, duty * np.array([0.012, -0.010, 0.008]))


def test_in_a_world_all_of_it_is_there_on_a_ramp_down_some_in_the_cold_and_nothing_in_the_heat(make_world):
    world = make_world(undeclared_effects=[CHAMBER.model_dump()])

    def share_after(set_point_c, minutes):
        world.air.set_point_c, world.air.ramp_rate_c_per_min, world.air.running = set_point_c, 2.0, True
        world.advance(world_time_s[0] + 60.0 * minutes)
        world_time_s[0] += 60.0 * minutes
        return world.undeclared_bias()[0] / DPH_TO_RADPS / 0.012

    world_time_s = [0.0]
    assert share_after(60.0, 10) == 0.0  # heating
    assert share_after(60.0, 120) == 0.0  # holding hot
    assert share_after(-20.0, 20) == pytest.approx(1.0)  # cooling
    assert 0.2 < share_after(-20.0, 180) < 0.6  # holding cold
    world.air.running = False
    assert share_after(-20.0, 0) >= 0.0


HOP = ModeHop(kind="mode_hop", bias_dph=[0.01, -0.02, 0.0], first_reset_c=-10.0, reset_every_c=8.0)
CROSSING = DitherCrossing(
    kind="dither_crossing", gyros=["x", "z"], crossing_c=30.0, half_width_c=2.0, bias_dph=[0.01, -0.02]
)


@pytest.mark.parametrize(
    ("optics_c", "share"), [(-18.5, 1), (-10.1, 0), (-9.9, 1), (-2.1, 1), (-1.9, 0), (5.9, 0), (6.1, 1)]
)
def test_every_second_mode_has_the_bias(optics_c, share):
    added_dph = HOP.added_dph(conditions(optics_c=optics_c))
    np.testing.assert_allclose(added_dph, share * np.array([0.01, -0.02, 0.0]))


def test_a_clamp_is_loose_above_one_temperature():
    clamp = LooseClamp(kind="loose_clamp", sensitivity_dph_per_c=[0.001, -0.002, 0.0], free_above_c=40.0)
    np.testing.assert_allclose(clamp.added_dph(conditions(optics_c=[50.0, 45.0, 60.0])), [0.01, -0.01, 0.0])
    np.testing.assert_allclose(clamp.added_dph(conditions(optics_c=[39.0, 0.0, -30.0])), 0.0)


def test_each_gyro_hops_at_its_own_temperature():
    added_dph = HOP.added_dph(conditions(optics_c=[-9.0, -1.0, 0.0]))
    np.testing.assert_allclose(added_dph, [0.01, 0.0, 0.0])


def test_at_the_crossing_both_gyros_have_all_of_the_bias_and_the_third_has_nothing():
    np.testing.assert_allclose(CROSSING.added_dph(conditions(optics_c=30.0)), [0.01, 0.0, -0.02])


@pytest.mark.parametrize(("away_c", "share"), [(2.0, 0.5), (-2.0, 0.5), (20.0, 1.0 / 101.0)])
def test_it_falls_off_on_both_sides_as_a_resonance_does(away_c, share):
    added_dph = CROSSING.added_dph(conditions(optics_c=30.0 + away_c))
    np.testing.assert_allclose(added_dph, share * np.array([0.01, 0.0, -0.02]))


def test_the_mean_temperature_of_the_two_gyros_decides():
    np.testing.assert_allclose(
        CROSSING.added_dph(conditions(optics_c=[25.0, 80.0, 35.0])), [0.01, 0.0, -0.02]
    )


@pytest.mark.parametrize("gyros", ["[x, x]", "[x]", "[x, y, z]", "[x, w]"])
def test_a_crossing_needs_two_different_gyros(gyros):
    text = f"kind: dither_crossing\ngyros: {gyros}\ncrossing_c: 30\nhalf_width_c: 2\nbias_dph: [0.01, 0.02]\n"
    with pytest.raises(DocumentError) as caught:
        validate(parse_document(text, Path("w.yaml")), DitherCrossing)
    assert re.match(r"w\.yaml:2:\d+: ", str(caught.value))


DRIFT = TimeDrift(kind="time_drift", drift_dph_per_day=[0.01, 0.02, -0.03])
PLAY = ThermalHysteresis(
    kind="thermal_hysteresis", half_width_c=3.0, sensitivity_dph_per_c=[0.001, 0.002, 0.003]
)


def test_without_effects_there_is_no_undeclared_bias():
    assert UndeclaredBias([]).added_dph(conditions()).tolist() == [0.0, 0.0, 0.0]


def test_effects_add_up_two_of_a_kind_as_well():
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
    np.testing.assert_allclose(added, world.undeclared_bias(), atol=1e-9 * DPH_TO_RADPS)
    assert np.abs(added).min() > 1e-4 * DPH_TO_RADPS


@pytest.mark.parametrize("steps_s", [0.37, 1.0, 450.0])
def test_they_do_not_depend_on_how_the_time_is_cut(make_world, steps_s):
    def end(step_s):
        world = make_world(undeclared_effects=[DRIFT.model_dump(), PLAY.model_dump()])
        world.air.set_point_c, world.air.running = 40.0, True
        for time_s in [*np.arange(step_s, 900.0, step_s), 900.0]:
            world.advance(time_s)
        return world.true_gyro_bias().tolist()

    assert end(steps_s) == end(900.0)
