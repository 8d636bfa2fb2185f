import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS
from gyrobench.drivers.emulators.can_ins import CanInsEmulator
from gyrobench.drivers.emulators.world.inertial_unit import AlignmentQuality, Mode
from gyrobench.drivers.emulators.world.ins_compensation import SLOT
from gyrobench.drivers.emulators.world.strapdown import matrix_of
from gyrobench.drivers.emulators.world.world import INNER, OUTER, World

QUICK = {"boot_s": 1.0, "levelling_s": 2.0, "coarse_alignment_s": 5.0, "fine_alignment_s": 10.0}


def settle_chamber(world, temperature_c):
    world.air.set_point_c, world.air.running = temperature_c, True


#: What happens in a short story, and when: nothing of it at a whole second.
STORY = [
    (0.503, lambda world, now_s: world.power_unit(True)),
    (2.2, lambda world, now_s: settle_chamber(world, 40.0)),
    (3.71, lambda world, now_s: world.unit.align()),
    (12.345, lambda world, now_s: world.unit.navigate()),
    (15.004, lambda world, now_s: world.axes[INNER].move_to(30.0, now_s)),
    (15.508, lambda world, now_s: world.axes[OUTER].turn_at(-4.0, now_s)),
    (18.25, lambda world, now_s: world.axes[OUTER].stop(now_s)),
    (31.999, lambda world, now_s: world.unit.align()),
    (45.0, lambda world, now_s: None),
]


def frames_of(world, steps_s, story=STORY):
    """Let the story happen in steps of those lengths in turn; returns every frame on the bus."""
    frames = []
    CanInsEmulator(world).listeners.append(
        lambda block: frames.extend((m.timestamp, m.arbitration_id, bytes(m.data)) for m in block.messages())
    )
    now_s, turn = 0.0, 0
    for time_s, happen in story:
        while now_s < time_s:
            now_s, turn = min(now_s + steps_s[turn % len(steps_s)], time_s), turn + 1
            world.advance(now_s)
        happen(world, time_s)
    return frames


def state_of(world):
    return [
        world.thermal.nodes_c.tolist(),
        world.attitude().tolist(),
        world.air.air_c,
        world.true_gyro_bias().tolist(),
    ]


@pytest.mark.parametrize("seed", [0, 7])
@pytest.mark.parametrize("steps_s", [[0.01], [0.1], [0.37], [1.0], [0.004, 0.2, 2.6]])
def test_many_small_steps_equal_one_big_step_to_the_bit(make_world, steps_s, seed):
    big, small = (make_world("gyro_a", seed, ins=QUICK) for _ in range(2))
    frames = frames_of(big, [100.0])
    assert {data[0] for _, identifier, data in frames if identifier == 0x010} == {1, 2, 3}
    assert frames_of(small, steps_s) == frames
    assert state_of(small) == state_of(big)


@settings(max_examples=10)
@given(steps_s=st.lists(st.floats(0.003, 3.0), min_size=1, max_size=6))
def test_any_steps_equal_one_big_step_to_the_bit(make_world, steps_s):
    big, small = (make_world("gyro_a", 1, ins=QUICK) for _ in range(2))
    assert frames_of(small, steps_s) == frames_of(big, [100.0])


def test_the_same_seed_makes_the_same_world_and_another_one_other_noise(make_world):
    first, second, other = (make_world("gyro_a", seed, ins=QUICK) for seed in (4, 4, 5))
    frames = frames_of(first, [1.0])
    assert frames_of(second, [1.0]) == frames
    assert frames_of(other, [1.0]) != frames
    assert other.attitude().tolist() == first.attitude().tolist()


def test_an_earlier_time_changes_nothing(make_world):
    back, straight = (make_world("gyro_a", ins=QUICK) for _ in range(2))
    for world in (back, straight):
        world.power_unit(True)
        world.advance(3.456)
        world.unit.align()
    before = state_of(back)
    for earlier_s in (3.456, 3.4559, 1.0, 0.0, -5.0):
        back.advance(earlier_s)
        assert state_of(back) == before
    assert frames_of(back, [1.0], [(20.0, lambda *_: None)]) == frames_of(
        straight, [1.0], [(20.0, lambda *_: None)]
    )


def test_with_both_axes_at_zero_the_unit_lies_level_and_looks_north(make_world):
    np.testing.assert_allclose(make_world().attitude(), np.eye(3), atol=1e-15)


@pytest.mark.parametrize(
    ("outer_axis", "outer", "inner"), [("east", [1, 0, 0], [0, 0, 1]), ("up", [0, 0, 1], [1, 0, 0])]
)
def test_the_outer_axis_carries_the_inner_one(make_world, outer_axis, outer, inner):
    world = make_world(table={"outer_axis": outer_axis})
    world.axes[OUTER].move_to(30.0, 0.0)
    world.axes[INNER].move_to(-70.0, 0.0)
    world.advance(60.0)
    expected = Rotation.from_rotvec(np.radians(30.0) * np.array(outer)) * Rotation.from_rotvec(
        np.radians(-70.0) * np.array(inner)
    )
    np.testing.assert_allclose(world.attitude(), expected.as_matrix(), atol=1e-12)


def test_tilt_and_mounting_error_turn_the_unit_by_their_rotation_vectors(make_world):
    arcsec = np.radians(1.0 / 3600.0)
    world = make_world(
        table={"tilt_arcsec": [30.0, -20.0, 10.0], "mounting_error_arcsec": [100.0, -150.0, 200.0]}
    )
    tilt = Rotation.from_rotvec(np.array([30.0, -20.0, 10.0]) * arcsec)
    mounting = Rotation.from_rotvec(np.array([100.0, -150.0, 200.0]) * arcsec)
    np.testing.assert_allclose(world.attitude(), (tilt * mounting).as_matrix(), atol=1e-15)
    # Half a turn about the inner axis leaves the tilt of the axes where it is and turns the mounting error.
    world.axes[INNER].move_to(180.0, 0.0)
    world.advance(60.0)
    half_turn = Rotation.from_rotvec(tilt.apply([0.0, 0.0, np.pi]))
    np.testing.assert_allclose(world.attitude(), (half_turn * tilt * mounting).as_matrix(), atol=1e-12)


def aligned(world, from_s):
    """Power the unit up, align it, and return the last state that it gave out."""
    epochs = []
    world.on_epochs = epochs.append
    world.power_unit(True)
    world.advance(from_s + 3.0)
    world.unit.align()
    world.advance(from_s + 20.0)
    assert epochs[-1].alignment is AlignmentQuality.FINE
    return epochs[-1].states[-1]


def test_an_aligned_unit_has_the_attitude_of_the_table(make_world):
    world = make_world(ins=QUICK, gyro={"bias_dph": {}}, table={"tilt_arcsec": [0.0, 0.0, 500.0]})
    world.axes[OUTER].move_to(90.0, 0.0)
    world.axes[INNER].move_to(-45.0, 0.0)
    world.advance(30.0)
    np.testing.assert_allclose(matrix_of(aligned(world, 30.0)[:4]), world.attitude(), atol=1e-9)


def test_a_motion_within_a_second_while_the_unit_is_off_is_not_missed(make_world):
    world = make_world(ins=QUICK, gyro={"bias_dph": {}})
    for time_s, command in (
        (5.1, lambda: world.axes[INNER].turn_at(20.0, 5.1)),
        (5.3, lambda: world.axes[INNER].release(5.3)),
    ):
        world.advance(time_s)
        command()
    assert world.axes[INNER].encoder(6.0).position_deg > 1.0
    assert not world.axes[INNER].is_moving(6.0)
    world.advance(7.0)
    np.testing.assert_allclose(matrix_of(aligned(world, 7.0)[:4]), world.attitude(), atol=1e-9)


def test_each_power_on_has_gyro_biases_a_little_different(make_world):
    world = make_world(gyro={"bias_dph": {"x": 0.03, "y": -0.02}, "power_on_repeatability_dph": 0.01})
    biases_dph = []
    for _ in range(200):
        world.power_unit(True)
        biases_dph.append(world.true_gyro_bias() / DPH_TO_RADPS)
        world.power_unit(True)  # it is on already
        assert (world.true_gyro_bias() / DPH_TO_RADPS).tolist() == biases_dph[-1].tolist()
        world.power_unit(False)
    np.testing.assert_allclose(np.mean(biases_dph, axis=0), [0.03, -0.02, 0.0], atol=0.003)
    np.testing.assert_allclose(np.std(biases_dph, axis=0), 0.01, rtol=0.2)


def test_the_very_first_sample_after_power_on_has_the_biases_of_this_power_on(make_world):
    world = make_world(seed=1, ins={"boot_s": 0.0}, gyro={"power_on_repeatability_dph": 1000.0})
    world.power_unit(True)
    world.advance(1.25)
    world.unit.align()
    rotation, _ = world._measured_increments(np.zeros((1, 6)), 1, None)
    still, _ = world._ideal_increments(1)
    np.testing.assert_allclose((rotation - still)[0] / 0.01, world.true_gyro_bias(), rtol=1e-9)


def test_temperature_sensors_read_the_network_with_their_noise(make_world):
    world = make_world(thermal={"sensor_noise_c": 0.05})
    readings_c = np.array([world.temperatures_c() for _ in range(2000)])
    np.testing.assert_allclose(readings_c.mean(axis=0), 23.0, atol=0.006)
    np.testing.assert_allclose(readings_c.std(axis=0), 0.05, rtol=0.1)
    assert (make_world().temperatures_c() == 23.0).all()


def test_the_heat_of_the_air_reaches_the_unit(make_world):
    world = make_world()
    settle_chamber(world, -20.0)
    world.advance(4 * 3600.0)
    assert world.air.air_c == pytest.approx(-20.0, abs=0.01)
    np.testing.assert_allclose(world.temperatures_c(), -20.0, atol=0.5)


def heading_drift_dph(world, from_s, seconds):
    states = []
    world.on_epochs = lambda epochs: states.extend(epochs.states[9::10])
    world.advance(from_s + seconds)
    yaws = [np.arctan2(C[1, 0], C[0, 0]) for C in (matrix_of(states[k][:4]) for k in (0, -1))]
    return (yaws[1] - yaws[0]) / DPH_TO_RADPS / (seconds - 1.0)


def test_an_applied_compensation_is_subtracted_from_the_gyros(make_world):
    world = make_world(ins=QUICK, gyro={"bias_dph": {"x": 0.0, "y": 0.0, "z": 0.5}})
    aligned(world, 0.0)
    world.unit.navigate()
    assert heading_drift_dph(world, 20.0, 100.0) == pytest.approx(0.5, rel=0.01)
    world.unit.loaded_table[2, SLOT.POLYNOMIAL] = 0.5
    world.unit.apply_compensation()
    assert abs(heading_drift_dph(world, 120.0, 100.0)) < 0.01
    assert world.unit.mode is Mode.NAVIGATE
    np.testing.assert_allclose(world.true_gyro_bias() / DPH_TO_RADPS, [0.0, 0.0, 0.5], atol=1e-12)


def test_a_world_that_begins_later_is_switched_off_and_in_the_present(make_world_file):
    file = make_world_file("gyro_a")
    world = World(file, 0, start_s=150_000)
    spoken = []
    world.on_epochs = spoken.append
    world.power_unit(True)
    world.advance(150_100.0)
    assert world.thermal.nodes_c[0] == pytest.approx(file.chamber.ambient_c, abs=5.0)
    samples = np.concatenate([epochs.sample for epochs in spoken])
    assert samples[-1] == 15_010_000
    assert samples[0] > 15_000_000


def test_a_world_that_begins_later_has_other_noise(make_world_file):
    file = make_world_file("gyro_a")
    first, restarted, again = World(file, 0), World(file, 0, start_s=1000), World(file, 0, start_s=1000)
    for world, time_s in ((first, 100.0), (restarted, 1100.0), (again, 1100.0)):
        world.power_unit(True)
        world.advance(time_s)
    assert (first.temperatures_c() != (temperatures_c := restarted.temperatures_c())).any()
    assert (temperatures_c == again.temperatures_c()).all()
    assert (first.true_gyro_bias() != restarted.true_gyro_bias()).any()


@pytest.mark.parametrize(
    "effect",
    [
        {"kind": "time_drift", "drift_dph_per_day": [0.01, 0.0, 0.0]},
        {"kind": "bias_jump", "bias_dph": [0.01, 0.0, 0.0], "at_h": 1.5},
        {"kind": "supply_ripple", "amplitude_dph": [0.01, 0.0, 0.0], "period_h": 3.0},
    ],
)
def test_effects_of_time_go_by_the_time_since_zero_wherever_the_world_begins(make_world_file, effect):
    file = make_world_file("ideal", undeclared_effects=[effect])
    whole, restarted = World(file, 0), World(file, 0, start_s=5000)
    for world in (whole, restarted):
        world.advance(7200.0)
    assert whole.undeclared_bias()[0] != 0.0
    assert (whole.undeclared_bias() == restarted.undeclared_bias()).all()
