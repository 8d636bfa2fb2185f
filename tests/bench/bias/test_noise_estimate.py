from dataclasses import dataclass, replace

import numpy as np
import pytest

from gyrobench.bench.bias.bias_filter import estimate_state_space
from gyrobench.bench.bias.dwell import NavigationWindow
from gyrobench.bench.bias.noise_estimate import compare_noise, estimate_noise
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.parameters import ErrorModel
from gyrobench.bench.foundations.arrays import DEG_PER_SQRT_H_TO_SI, DPH_TO_RADPS, UG_PER_SQRT_HZ_TO_SI
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.drivers.emulators.world.sensor_errors import MICRO_G, sense
from gyrobench.drivers.emulators.world.strapdown import (
    STATE_SIZE,
    euler_output,
    gyrocompass,
    navigate,
    normal_gravity,
    true_increments,
)
from gyrobench.drivers.ins.attitude import EulerSequence, attitude_matrices
from tests.bench.bias.emulated_dwells import CLEAN, emulate, noise_model, sensors, site

EAST, UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
LATITUDE = np.radians(36.4)
GRAVITY = normal_gravity(LATITUDE, 0.0)
SAMPLE_S = 0.05
TURN_S = 18.0


@dataclass(frozen=True)
class SimulatedIns:
    """An INS on a table that turns it by 180 deg between two windows of navigation."""

    position: str = "z_up"
    arw_deg_per_sqrt_h: tuple[float, float, float] = (0.0006, 0.0006, 0.0006)
    vrw_ug_per_sqrt_hz: float = 5.0
    gyro_bias_dph: float = 0.0
    accelerometer_bias_ug: float = 0.0
    window_s: float = 600.0
    epoch_s: float = 0.1
    velocity_step_mps: float = 1e-4
    attitude_step_deg: float = 1e-6
    align_s: float = 120.0


def dwell(ins, random):
    """Navigation before and after the turn, as the emulated INS puts it out."""
    counts = [round(s / SAMPLE_S) for s in (ins.align_s, ins.window_s, TURN_S, ins.window_s)]
    turn = np.pi * (1.0 - np.cos(np.linspace(0.0, np.pi, counts[2] + 1))) / 2.0
    inner = np.concatenate([np.zeros(counts[0] + counts[1]), turn, np.full(counts[3], np.pi)])
    mounting = POSITIONS[ins.position].C_nb()
    true = true_increments(EAST, UP, mounting, np.zeros(inner.size), inner, LATITUDE, 0.0, SAMPLE_S)
    walk = (
        np.array(ins.arw_deg_per_sqrt_h) * DEG_PER_SQRT_H_TO_SI,
        np.full(3, ins.vrw_ug_per_sqrt_hz * MICRO_G),
    )
    bias = np.full(3, ins.gyro_bias_dph * DPH_TO_RADPS), np.full(3, ins.accelerometer_bias_ug * MICRO_G)
    noise = np.sqrt(SAMPLE_S) * random.normal(size=(2, inner.size - 1, 3))
    rotation, velocity = (
        sense(true[k], np.zeros((3, 3)), bias[k], walk[k] * noise[k], SAMPLE_S, 0.0, np.zeros(3))
        for k in (0, 1)
    )
    state = np.zeros(STATE_SIZE)
    state[:4] = gyrocompass(rotation[: counts[0]].sum(axis=0), velocity[: counts[0]].sum(axis=0))
    state[6] = LATITUDE
    every = round(ins.epoch_s / SAMPLE_S)
    states = navigate(state, rotation[counts[0] :], velocity[counts[0] :], SAMPLE_S, 0.0, every - 1, every)
    time = ins.epoch_s * np.arange(1, len(states) + 1)
    whole = output(ins, time, states)
    return [part(whole, time <= ins.window_s + 1e-6), part(whole, time > ins.window_s + TURN_S)]


def output(ins, time, states):
    pitch_first = ins.position.startswith("y")
    out = euler_output(states, pitch_first)
    out[:, :2] = np.rint(out[:, :2] / ins.velocity_step_mps) * ins.velocity_step_mps
    out[:, 2:] = np.radians(np.rint(np.degrees(out[:, 2:]) / ins.attitude_step_deg) * ins.attitude_step_deg)
    sequence = EulerSequence.PRY_231 if pitch_first else EulerSequence.RPY_321
    C_nb = attitude_matrices(sequence, out[:, 2], out[:, 3], -out[:, 4])
    return NavigationWindow(time, np.stack([out[:, 1], out[:, 0], np.zeros(len(out))], axis=1), C_nb)


def part(window, rows):
    return NavigationWindow(window.time_s[rows], window.velocity_enu_mps[rows], window.C_nb[rows])


def simulated(seed=1, **fields):
    return dwell(SimulatedIns(**fields), np.random.default_rng(seed))


def estimated(seed=1, **fields):
    return estimate_noise(simulated(seed, **fields), GRAVITY)


def pull(parameter, truth):
    return (parameter.square - truth**2) / parameter.square_sigma


@pytest.fixture(scope="module")
def many_dwells():
    """Truth and estimate of dwells of all positions with several noises."""
    random = np.random.default_rng(20)
    result = []
    for number in range(36):
        arw, vrw = (0.0005, 0.001, 0.003)[number % 3], (5.0, 20.0)[number % 2]
        ins = SimulatedIns(tuple(POSITIONS)[number % 6], (arw, arw, arw), vrw)
        truth = NoiseModel(arw * DEG_PER_SQRT_H_TO_SI, vrw * UG_PER_SQRT_HZ_TO_SI)
        result.append((truth, estimate_noise(dwell(ins, random), GRAVITY)))
    return result


def assert_pulls(pulls):
    pulls = np.array(pulls)
    assert abs(pulls.mean()) < 3.5 / np.sqrt(pulls.size)
    assert abs(pulls.std() - 1.0) < 3.5 / np.sqrt(2.0 * pulls.size)


@pytest.mark.long
def test_angle_random_walk_is_the_true_one_within_its_uncertainty(many_dwells):
    assert_pulls(
        [pull(estimate.angle_random_walk, truth.angle_random_walk) for truth, estimate in many_dwells]
    )
    assert_pulls(
        [
            pull(walk, truth.angle_random_walk)
            for truth, estimate in many_dwells
            for walk in estimate.angle_random_walks
        ]
    )


@pytest.mark.long
def test_one_dwell_shows_the_angle_random_walk_to_a_hundredth(many_dwells):
    for _, estimate in many_dwells:
        assert estimate.angle_random_walk.sigma < 0.01 * estimate.angle_random_walk.value
        for walk in estimate.angle_random_walks:
            assert walk.sigma < 0.02 * walk.value


@pytest.mark.long
def test_velocity_random_walk_is_the_true_one_within_its_uncertainty(many_dwells):
    assert_pulls(
        [pull(estimate.velocity_random_walk, truth.velocity_random_walk) for truth, estimate in many_dwells]
    )
    for truth, estimate in many_dwells:
        assert estimate.velocity_random_walk.square_sigma < 0.12 * truth.velocity_random_walk**2


@pytest.mark.long
def test_velocities_show_the_angle_random_walk_too(many_dwells):
    errors = [
        (estimate.angle_random_walk_of_tilt.square / truth.angle_random_walk**2 - 1.0)
        for truth, estimate in many_dwells
        if truth.velocity_random_walk < 6.0 * UG_PER_SQRT_HZ_TO_SI
    ]
    assert abs(np.mean(errors)) < 3.5 * np.std(errors) / np.sqrt(len(errors))
    assert np.std(errors) < 0.7


@pytest.mark.long
def test_rounding_of_the_output_is_reported_as_its_noise(many_dwells):
    velocity = [estimate.velocity_white.square for _, estimate in many_dwells]
    assert np.mean(velocity) == pytest.approx(1e-8 / 12.0, rel=0.1)


@pytest.mark.parametrize("count", [4, pytest.param(12, marks=pytest.mark.long)])
def test_biases_and_tilts_do_not_look_like_noise(count):
    estimates = [estimated(seed, gyro_bias_dph=0.02, accelerometer_bias_ug=100.0) for seed in range(count)]
    truth = NoiseModel.from_datasheet(0.0006, 5.0)
    for name, value in (
        ("angle_random_walk", truth.angle_random_walk),
        ("velocity_random_walk", truth.velocity_random_walk),
        ("angle_random_walk_of_tilt", truth.angle_random_walk),
    ):
        pulls = np.array([pull(getattr(estimate, name), value) for estimate in estimates])
        assert abs(pulls.mean()) < 3.5 / np.sqrt(count), name
        assert np.abs(pulls).max() < 4.0, name


@pytest.mark.parametrize("position", POSITIONS)
def test_the_gyro_that_is_noisier_is_named_in_every_position(position):
    estimate = estimated(position=position, arw_deg_per_sqrt_h=(0.0006, 0.003, 0.001), window_s=120.0)
    in_datasheet_units = [walk.value / DEG_PER_SQRT_H_TO_SI for walk in estimate.angle_random_walks]
    np.testing.assert_allclose(in_datasheet_units, [0.0006, 0.003, 0.001], rtol=0.15)


@pytest.mark.parametrize(("window_s", "epoch_s"), [(600.0, 1.0), (60.0, 0.1), (60.0, 1.0)])
def test_slow_epochs_and_short_windows_give_a_wider_uncertainty(window_s, epoch_s):
    estimates = [estimated(seed, window_s=window_s, epoch_s=epoch_s) for seed in range(20)]
    truth = 0.0006 * DEG_PER_SQRT_H_TO_SI
    errors = np.array([estimate.angle_random_walk.square / truth**2 - 1.0 for estimate in estimates])
    stated = np.array([estimate.angle_random_walk.square_sigma / truth**2 for estimate in estimates])
    assert stated.min() > 0.03
    assert abs(errors.mean()) < 4.0 * stated.mean() / np.sqrt(20)
    assert 0.6 < errors.std() / stated.mean() < 1.5


def test_dwells_are_pooled():
    windows = [window for seed in range(4) for window in simulated(seed)]
    one, four = (estimate_noise(some, GRAVITY).angle_random_walk for some in (windows[:2], windows))
    assert four.sigma == pytest.approx(0.5 * one.sigma, rel=0.05)
    assert abs(pull(four, 0.0006 * DEG_PER_SQRT_H_TO_SI)) < 3.5


def test_missing_epochs_do_not_bias():
    random = np.random.default_rng(30)
    windows = simulated(seed=31)
    thinned = []
    for window in windows:
        keep = np.ones(len(window.time_s), bool)
        for first in random.integers(1, len(keep) - 6, 150):
            if keep[first - 1 : first + 5].all():
                keep[first : first + random.integers(1, 5)] = False
        thinned.append(part(window, keep))
    lost = 1.0 - len(thinned[0].time_s) / len(windows[0].time_s)
    whole, holed = (estimate_noise(some, GRAVITY) for some in (windows, thinned))
    assert lost > 0.03
    for name in ("angle_random_walk", "velocity_random_walk"):
        full, rest = getattr(whole, name), getattr(holed, name)
        assert abs(rest.square - full.square) < full.square_sigma, name
        assert rest.square_sigma > 0.99 * full.square_sigma, name


def test_an_attitude_too_coarse_hides_the_angle_random_walk_below_a_limit():
    estimate = estimated(attitude_step_deg=1e-3)
    assert estimate.angle_random_walk.value is None
    assert 0.0006 * DEG_PER_SQRT_H_TO_SI < estimate.angle_random_walk.limit < 0.01 * DEG_PER_SQRT_H_TO_SI
    assert estimate.heading_white.value is None
    assert estimate.velocity_random_walk.is_significant
    with pytest.raises(MeasurementError, match="angle random walk is not observable"):
        estimate.noise_model()


def test_an_attitude_that_never_changes_determines_nothing():
    estimate = estimated(attitude_step_deg=1.0)
    assert estimate.angle_random_walk.value is None
    assert estimate.angle_random_walk.limit is None


@pytest.mark.parametrize("count", [6, pytest.param(15, marks=pytest.mark.long)])
def test_a_coarse_attitude_is_used_at_the_epochs_between_which_it_moves(count):
    estimates = [estimated(seed, attitude_step_deg=3e-5) for seed in range(count)]
    truth = 0.0006 * DEG_PER_SQRT_H_TO_SI
    errors = np.array([estimate.angle_random_walk.square / truth**2 - 1.0 for estimate in estimates])
    stated = np.array([estimate.angle_random_walk.square_sigma / truth**2 for estimate in estimates])
    assert 0.05 < stated.mean() < 0.3
    assert abs(errors.mean()) < 4.0 * stated.mean() / np.sqrt(count)
    assert 0.5 < errors.std() / stated.mean() < 1.6


def test_a_velocity_too_coarse_hides_the_velocity_random_walk_below_a_limit():
    estimate = estimated(velocity_step_mps=0.01)
    assert estimate.velocity_random_walk.value is None
    assert estimate.velocity_random_walk.limit > 5.0 * UG_PER_SQRT_HZ_TO_SI
    assert estimate.noise_model().velocity_random_walk == estimate.velocity_random_walk.limit


def test_accelerometers_without_noise_give_an_upper_limit():
    walk = estimated(vrw_ug_per_sqrt_hz=0.0).velocity_random_walk
    assert not walk.is_significant
    assert 0.0 < walk.limit < 5.0 * UG_PER_SQRT_HZ_TO_SI
    assert walk.text("ug/sqrt(Hz)", UG_PER_SQRT_HZ_TO_SI).startswith("below ")


def test_noise_model_holds_what_was_found():
    model = estimated(vrw_ug_per_sqrt_hz=20.0).noise_model()
    assert model.angle_random_walk == pytest.approx(0.0006 * DEG_PER_SQRT_H_TO_SI, rel=0.05)
    assert model.velocity_random_walk == pytest.approx(20.0 * UG_PER_SQRT_HZ_TO_SI, rel=0.1)
    assert model.velocity_white == pytest.approx(1e-4 / np.sqrt(12.0), rel=0.3)
    assert model.heading_white < np.radians(2e-6)


def test_noise_model_allows_for_the_noisiest_gyro():
    estimate = estimated(arw_deg_per_sqrt_h=(0.0006, 0.003, 0.001))
    noisiest = estimate.angle_random_walks[1]
    model = estimate.noise_model()
    assert model.angle_random_walk == noisiest.value > 1.5 * estimate.angle_random_walk.value
    assert model.dof[0] == noisiest.dof(noisiest.value)


def test_noise_that_is_as_declared_is_called_consistent():
    declared = NoiseModel.from_datasheet(0.0006, 5.0, 1e-4, np.radians(1e-6))
    comparisons = compare_noise(estimated(seed=3), declared)
    assert [each.name for each in comparisons[:4]] == [
        "angle random walk of the x gyro",
        "angle random walk of the y gyro",
        "angle random walk of the z gyro",
        "angle random walk of all gyros",
    ]
    assert all(each.is_consistent for each in comparisons)
    assert comparisons[3].measured.value == pytest.approx(comparisons[3].declared, rel=0.05)
    assert comparisons[3].sentence.startswith("angle random walk of all gyros 0.000")
    assert comparisons[3].sentence.endswith("deg/sqrt(h), declared 0.0006 deg/sqrt(h): consistent")


def test_noise_that_differs_from_the_declared_one_is_said_so():
    declared = NoiseModel.from_datasheet(0.0006, 40.0)
    x, y, z, _, _, velocity, *_ = compare_noise(
        estimated(arw_deg_per_sqrt_h=(0.0006, 0.0009, 0.0006), vrw_ug_per_sqrt_hz=20.0), declared
    )
    assert (x.is_consistent, y.is_consistent, z.is_consistent) == (True, False, True)
    assert y.sentence.endswith(": larger than declared")
    assert velocity.sentence.endswith(": smaller than declared")


def test_what_the_resolution_hides_is_compared_by_its_limit():
    estimate = estimated(attitude_step_deg=1e-3, velocity_step_mps=0.01)
    below, above = (compare_noise(estimate, NoiseModel.from_datasheet(arw))[3] for arw in (0.0006, 0.1))
    assert "hidden by the resolution, below 0.00" in below.sentence
    assert (below.is_consistent, above.is_consistent) == (True, False)
    assert above.sentence.endswith(": smaller than declared")
    tilt = compare_noise(estimate, NoiseModel.from_datasheet(0.0006))[4]
    assert tilt.is_consistent is None
    assert tilt.sentence.endswith(": can't be compared")


def test_windows_that_do_not_belong_together_are_refused():
    fast, slow = simulated(window_s=60.0), simulated(window_s=60.0, epoch_s=1.0)
    with pytest.raises(MeasurementError, match=r"epochs every 0\.1 s and every 1 s"):
        estimate_noise([*fast, *slow], GRAVITY)
    with pytest.raises(MeasurementError, match="no window"):
        estimate_noise([], GRAVITY)


def test_windows_with_too_few_epochs_are_refused():
    window = simulated(window_s=70.0, epoch_s=1.0)[0]
    with pytest.raises(MeasurementError, match="Record longer"):
        estimate_noise([part(window, np.arange(0, len(window.time_s), 2))], GRAVITY)


def test_the_clock_of_the_ins_may_start_anywhere():
    windows = simulated(window_s=60.0)
    shifted = [replace(window, time_s=window.time_s + 1e6) for window in windows]
    assert estimate_noise(shifted, GRAVITY).angle_random_walk.value == pytest.approx(
        estimate_noise(windows, GRAVITY).angle_random_walk.value, rel=1e-6
    )


@pytest.fixture(scope="module")
def own_noise():
    """Dwells of an epoch a second, each with the noise that it shows itself."""
    result = []
    for seed in range(24):
        random = np.random.default_rng(2000 + seed)
        unit = sensors((0.01, -0.01, 0.02), (20.0, 10.0, 0.0), noise_model())
        one = emulate("z_up", unit, noise=noise_model(), random=random)
        result.append((one, estimate_noise(one.windows, site().gravity)))
    return result


def test_good_dwells_pass_the_test_of_fit_with_the_noise_that_they_show(own_noise):
    p_values = np.array(
        [
            estimate_state_space(one, ErrorModel(site(), noise.noise_model(), CLEAN)).fit.p_value
            for one, noise in own_noise
        ]
    )
    # Chances of more with uniform p values: 3e-4, 1e-3 and 2e-4.
    assert np.count_nonzero(p_values < 1e-3) <= 1
    assert np.count_nonzero(p_values < 0.05) <= 5
    assert p_values.min() > 1e-5


def test_noise_of_the_heading_is_that_about_up_alone(own_noise):
    whites = [noise.heading_white.value for _, noise in own_noise]
    assert np.mean(whites) == pytest.approx(noise_model().heading_white, rel=0.02)


def test_velocity_random_walk_of_the_model_is_seldom_too_small(own_noise):
    ratios = np.array([noise.noise_model().velocity_random_walk for _, noise in own_noise])
    ratios /= noise_model().velocity_random_walk
    # A sigma more than the estimate: no more than one in six is smaller, give or take three sigmas of that.
    assert np.count_nonzero(ratios < 1.0) <= 4 + 5
    assert ratios.min() > 0.3
    assert ratios.mean() < 2.0
