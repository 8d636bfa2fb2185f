"""What a dwell is flagged for, and what it is not, on full strapdown data with one thing wrong."""

from __future__ import annotations

import numpy as np
import pytest

from gyrobench.bench.bias.damping import Damping
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.dwells.measure_dwell import estimate_dwell
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.foundations.text import flag_text
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.bias.disturbances import bias_step
from tests.bench.bias.emulated_dwells import UG, emulate, sensors, site

ARCSEC = np.pi / 180.0 / 3600.0
VELOCITY_LSB_MPS, ANGLE_LSB_DEG = 1e-4, 1e-6
#: Middle of the first window, and of the second one.
MIDDLES_S = (300.0, 925.0)
BIAS_DPH, ACCELEROMETER_UG = np.array([0.012, -0.02, 0.016]), (60.0, -40.0, 50.0)


def crossed(first, second):
    """All pairs of two lists. Of them as many as the longer one has, with each value, are quick."""
    quick = {(n % len(first), n % len(second)) for n in range(max(len(first), len(second)))}
    return [
        pytest.param(a, b, marks=[] if (i, j) in quick else [pytest.mark.long])
        for i, a in enumerate(first)
        for j, b in enumerate(second)
    ]


def noise_of(factor=1.0):
    """The resolution of the output is no noise of the sensors."""
    return NoiseModel.from_datasheet(
        0.0006 * factor, 5.0 * factor, VELOCITY_LSB_MPS, np.radians(ANGLE_LSB_DEG)
    )


def setup_for(declared, velocity_lsb_mps=VELOCITY_LSB_MPS, heading_lsb_deg=ANGLE_LSB_DEG):
    return MeasurementSetup(
        decode=lambda frames: pytest.fail("nothing is to be decoded here"),
        table=None,
        site=site(),
        noise=declared,
        prior=PriorKnowledge(),
        velocity_lsb_mps=velocity_lsb_mps,
        heading_lsb_rad=np.radians(heading_lsb_deg),
        resolution=(),
    )


DECLARED = setup_for(noise_of())
#: Resolution of an INS for land vehicles, m/s and deg, and its noise with it.
COARSE = 0.01, 0.005
COARSE_NOISE = NoiseModel.from_datasheet(0.0006, 5.0, COARSE[0], np.radians(COARSE[1]))


def measured(
    position="z_up", seed=0, noise=None, setup=DECLARED, accelerometer_ug=ACCELEROMETER_UG,
    lsb=(VELOCITY_LSB_MPS, ANGLE_LSB_DEG), bias_dph=BIAS_DPH, **errors,
):  # fmt: skip
    """Estimate, flags, and errors in units of sigma of a dwell of 10 Hz."""
    noise = noise or noise_of()
    dwell = emulate(
        position, sensors(bias_dph, accelerometer_ug, noise, **errors), random=np.random.default_rng(seed),
        lsb=lsb, epoch_s=0.1, outer_level=True,
    )  # fmt: skip
    estimated = estimate_dwell(dwell, setup, setup.noise_in(dwell.windows))
    estimate, flags = estimated.estimate, (*estimated.disturbances, *estimated.persistent_flags)
    return estimate, flag_text(flags), (estimate.bias_dph - bias_dph) / estimate.sigma_dph


@pytest.mark.parametrize("position", ["z_up", "y_down"])
def test_accelerometers_that_settle_after_the_turn_are_estimated(position):
    estimate, flags, away = measured(
        position,
        accelerometer_bias_change=lambda time_s: np.multiply.outer(
            np.where(time_s > 625.0, np.exp((625.0 - np.maximum(time_s, 625.0)) / 120.0), 0.0),
            20.0 * UG * np.array([1.0, -1.0, 1.0]),
        ),
    )
    assert flags == ""
    assert np.abs(away).max() < 3.0
    level = np.arange(3) != POSITIONS[position].up_axis
    # The level gyros know that they know less.
    assert estimate.sigma_dph[level].min() > 1.04 * measured(position)[0].sigma_dph[level].max()


def test_the_default_drift_of_accelerometers_covers_that_of_production_units():
    for ug_per_h in (10.0, 20.0, 30.0):
        drift = ug_per_h * UG / 3600.0 * np.array([1.0, -1.0, 1.0])
        _, flags, away = measured(
            accelerometer_bias_change=lambda time_s, drift=drift: np.multiply.outer(time_s, drift)
        )
        assert flags == ""
        assert np.abs(away).max() < 2.5


def test_a_damped_velocity_shows_in_few_dwells():
    damped = [
        measured(position, velocity_damping_s=600.0)[0].damping for position in ("z_up", "y_up", "x_up")
    ]
    free = [measured(position)[0].damping for position in ("z_up", "y_up", "x_up")]
    assert Damping.mean(damped).p_value < 1e-5
    assert 1.0 / Damping.mean(damped).rate == pytest.approx(600.0, rel=0.3)
    assert "time constant of" in Damping.mean(damped).text
    assert Damping.mean(free).p_value > 1e-3


def test_a_velocity_that_walks_at_random_is_not_taken_for_a_damped_one():
    still = {"bias_dph": np.zeros(3), "accelerometer_ug": (0.0, 0.0, 0.0)}
    found = [measured(seed=seed, **still)[0].damping for seed in range(12)]
    away = np.array([each.rate / each.sigma for each in found])
    assert abs(away.mean()) < 3.0 / np.sqrt(len(away))
    assert away.max() < 3.0


@pytest.mark.parametrize("factor", [1.3, 2.0])
def test_the_uncertainty_follows_the_noise_of_the_dwell(factor):
    noisy = noise_of(factor)
    estimate, flags, _ = measured(noise=noisy)
    known, _, _ = measured(noise=noisy, setup=setup_for(noisy))
    assert flags == ""
    np.testing.assert_allclose(estimate.sigma_dph, known.sigma_dph, rtol=0.05)
    np.testing.assert_allclose(estimate.bias_dph, known.bias_dph, atol=0.3 * known.sigma_dph.min())


def test_declared_noise_that_is_right_is_used_as_it_stands():
    dwell = emulate(ins=sensors(BIAS_DPH, noise=noise_of()), random=np.random.default_rng(1), epoch_s=0.1)
    assert DECLARED.noise_in(dwell.windows) is DECLARED.noise


@pytest.mark.parametrize(("axis", "at_s"), crossed(range(3), MIDDLES_S))
def test_a_bias_that_steps_is_found_with_its_gyro_time_and_size(axis, at_s):
    estimate, flags, _ = measured("x_up", gyro_bias_change=bias_step(axis, 0.03, at_s))
    assert f"that of the {'xyz'[axis]} gyro seems to step" in flags
    assert estimate.step.p_value < 1e-4
    assert estimate.step.gyro == axis
    assert estimate.step.time_s == pytest.approx(at_s, abs=60.0)
    assert estimate.step.size_dph == pytest.approx(0.03, abs=0.012)


def test_a_step_of_all_biases_by_a_hundredth_of_a_degree_an_hour_is_flagged():
    flagged = [
        measured(position, seed, gyro_bias_change=lambda time_s: sum(
            bias_step(axis, 0.01, 300.0)(time_s) for axis in range(3)
        ))[1]
        for seed, position in enumerate(("z_up", "y_up", "x_up"))
    ]  # fmt: skip
    assert sum("not constant" in flags for flags in flagged) >= 2


@pytest.mark.parametrize(("position", "bias_ug"), crossed(["z_up", "x_down"], [100.0, 500.0, 1000.0]))
def test_large_accelerometer_biases_are_no_motion(position, bias_ug):
    _, flags, away = measured(position, accelerometer_ug=bias_ug * np.array([1.0, -1.0, 1.0]))
    assert flags == ""
    assert np.abs(away).max() < 4.0


def test_misalignments_of_twenty_arcsec_are_no_motion():
    misalignment = 20.0 * ARCSEC * (1.0 - np.eye(3))
    _, flags, away = measured(accelerometer_matrix=misalignment, gyro_matrix=misalignment)
    assert flags == ""
    assert np.abs(away).max() < 4.0


@pytest.mark.parametrize("position", ["z_up", "y_down"])
def test_pulses_without_dither_are_noise_and_no_damage(position):
    estimate, flags, away = measured(position, gyro_pulse=0.5 * ARCSEC)
    assert flags == ""
    assert np.abs(away).max() < 4.0
    assert estimate.sigma_dph.min() > measured(position)[0].sigma_dph.min()


@pytest.mark.parametrize(("position", "seed"), crossed(["z_up", "x_down"], range(3)))
def test_coarse_output_that_stays_the_same_is_uncertain_and_no_fault(position, seed):
    setup = setup_for(COARSE_NOISE, *COARSE)
    estimate, flags, away = measured(position, seed, setup=setup, lsb=COARSE)
    assert flags == ""
    assert np.abs(away).max() < 3.0
    as_white = estimate_dwell(
        emulate(position, sensors(BIAS_DPH), random=np.random.default_rng(seed), epoch_s=0.1),
        setup,
        COARSE_NOISE,
    ).estimate
    ratios = estimate.sigma_dph / as_white.sigma_dph
    assert ratios.min() > 1.0
    assert ratios.max() > 2.0  # that of the vertical gyro, whose heading moves through few steps


@pytest.mark.long
@pytest.mark.parametrize("steps", [(1e-4, 1e-6), (2e-4, 1e-6), (5e-4, 1e-6)])
def test_errors_of_rounded_output_are_as_large_as_stated(steps):
    quiet = NoiseModel.from_datasheet(0.0002, 1.0)
    setup = setup_for(NoiseModel.from_datasheet(0.0002, 1.0, steps[0], np.radians(steps[1])), *steps)
    short = {"window_s": 60.0, "turn_s": 6.0, "align_s": 16.0, "lsb": steps, "epoch_s": 0.1}
    found = []
    for seed in range(60):
        dwell = emulate(ins=sensors(noise=quiet), random=np.random.default_rng(seed), **short)
        estimate = estimate_dwell(dwell, setup, setup.noise_in(dwell.windows)).estimate
        found.append(estimate.bias_dph / estimate.sigma_dph)
    # The prior knowledge of the accelerometers counts in what is stated, and they have no errors here.
    rms = np.sqrt(np.mean(np.square(found), axis=0))
    assert rms.max() < 1.2
    assert rms.min() > 0.5


def test_coarse_pulses_are_named_as_the_limit():
    _, flags, _ = measured(gyro_pulse=5.0 * ARCSEC)
    assert "the resolution of the sensors limits the dwell" in flags
