"""Rests, rotations, spins and disturbances are found in increments."""

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.calibration.increment_recording import IncrementRecording, find_rotations, measure_noise
from gyrobench.bench.foundations.errors import MeasurementError
from tests.bench.calibration.rotated_unit import EARTH, Noise, Unit


def recorded(unit, noise=None, seed=1):
    noise, dt = noise or Noise(), 1.0 / unit.sample_hz
    return IncrementRecording(dt, *noise.added(*unit.increments(), dt, np.random.default_rng(seed)))


def test_rests_and_rotations_are_those_of_the_table():
    unit = Unit(rotations=(("outer", 90.0), ("inner", -180.0), ("outer", 45.0)), dwell_s=40.0, sample_hz=20.0)
    recording = recorded(unit)
    rests = recording.rests
    lengths = [(rest.end - rest.begin) * recording.interval_s for rest in rests]
    assert len(rests) == 4
    assert min(lengths) > 37.0
    rotations = find_rotations(recording)
    assert [rotation.kind for rotation in rotations] == ["rotation"] * 3
    np.testing.assert_allclose(np.rad2deg([turn.path for turn in rotations]), [90.0, -180.0, -45.0], atol=0.2)
    assert [turn.axis for turn in rotations] == [0, 2, 0]


def test_a_steady_spin_is_no_rest_and_whole_turns_are_a_spin():
    unit = Unit(rotations=(("inner", 3600.0), ("outer", 90.0)), dwell_s=40.0, rate_dps=30.0, sample_hz=20.0)
    recording = recorded(unit)
    rests = recording.rests
    assert len(rests) == 3
    spin, rotation = find_rotations(recording)
    assert (spin.kind, rotation.kind) == ("spin", "rotation")
    assert np.rad2deg(spin.path) == pytest.approx(3600.0, abs=0.5)


def test_a_large_bias_is_not_taken_for_a_rotation():
    unit = Unit(
        rotations=(("outer", 90.0),), dwell_s=40.0, sample_hz=20.0, gyro_bias=np.array([0.02, 0.0, -0.01])
    )
    assert len(recorded(unit).rests) == 2


def test_disturbed_parts_of_a_rest_are_left_out():
    unit = Unit(rotations=(), dwell_s=200.0, sample_hz=20.0)
    recording = recorded(unit)
    shake = np.sin(np.arange(100) * 0.7)[:, np.newaxis]
    recording.angle[2000:2100] += 2e-4 * shake
    recording.velocity[2000:2100] += 0.01 * shake
    first, second = recording.rests
    assert first.end <= 2000 < 2100 <= second.begin
    assert (first.end - first.begin) + (second.end - second.begin) > 3800
    (moved,) = find_rotations(recording)
    assert moved.kind == "disturbance"


def test_a_unit_that_does_not_rest_is_refused():
    unit = Unit(rotations=(("outer", 3600.0),), dwell_s=5.0, sample_hz=20.0)
    with pytest.raises(MeasurementError, match="at least 60 s are needed"):
        _ = recorded(unit).rests


def test_samples_too_far_apart_to_show_motion_are_refused():
    with pytest.raises(
        MeasurementError, match=r"samples are 50 s apart.*of a run, ins\.signals\.increments\.period_s"
    ):
        IncrementRecording(50.0, np.zeros((100, 3)), np.zeros((100, 3)))


def test_the_noise_is_that_of_the_sensors():
    unit = Unit(rotations=(("outer", 90.0),) * 3, dwell_s=120.0, sample_hz=20.0)
    noise = Noise(white_angle=1e-6)
    recording = recorded(unit, noise)
    measured = measure_noise([recording])
    assert measured.angle_random_walk == pytest.approx(noise.angle_random_walk, rel=0.35)
    assert measured.white_angle == pytest.approx(1e-6, rel=0.1)
    assert measured.velocity_random_walk == pytest.approx(noise.velocity_random_walk, rel=0.25)
    assert measured.white_velocity == pytest.approx(1e-4, rel=0.1)


def test_output_that_is_rounded_is_at_least_as_uncertain_as_its_rounding():
    unit = Unit(rotations=(("outer", 90.0),) * 3, dwell_s=60.0, sample_hz=20.0)
    recording = recorded(unit)
    fine, coarse = (
        measure_noise([replace(recording, rounding=each)]) for each in ((1e-12, 1e-12), (25e-6, 3e-3))
    )
    assert (fine.white_angle < 1e-6).all()
    assert (coarse.white_angle == 25e-6).all()
    assert (coarse.white_velocity == 3e-3).all()
    np.testing.assert_array_equal(coarse.angle_random_walk, fine.angle_random_walk)


def test_a_sensor_that_never_changes_is_refused():
    unit = Unit(rotations=(), dwell_s=100.0, sample_hz=20.0)
    recording = recorded(unit)
    recording.velocity[:, 1] = 0.0
    with pytest.raises(MeasurementError, match="output of the y accelerometer never changes"):
        measure_noise([recording])


def _disturbed_axes(time):
    """Roll, pitch, heading (deg), and specific force (m/s^2) of a unit that is disturbed on some axes.

    With the stretches (s) in which that happens: a swinging support, a push on one side, a twist that stays,
    and a machine beside it that shakes the vertical axis.
    """
    rph, shake = np.tile([3.0, -2.0, 40.0], (len(time), 1)), np.zeros((len(time), 3))
    swing, push, twist, machine = (300.0, 340.0), (700.0, 703.0), (1100.0, 1102.0), (1500.0, 1520.0)

    def inside(span):
        return np.clip((time - span[0]) / (span[1] - span[0]), 0.0, 1.0)

    rph[:, 0] += 0.05 * np.sin(26.0 * np.pi * inside(swing)) * np.sin(np.pi * inside(swing))
    rph[:, 1] += 0.1 * np.sin(np.pi * inside(push)) ** 2
    rph[:, 2] += 0.1 * np.sin(0.5 * np.pi * inside(twist)) ** 2
    running = (inside(machine) > 0.0) & (inside(machine) < 1.0)
    shake[:, 2] = running * 0.05 * np.sin(2.0 * np.pi * 7.3 * time)
    return rph, shake, (swing, push, twist, machine)


# pandas 3 ignores an argument of pyins with a warning.
@pytest.mark.long
@pytest.mark.filterwarnings("ignore::Warning")
def test_quiet_stretches_of_1847_s_with_disturbed_axes_give_earth_rate_and_noise():
    """Increments of the real motion by python-ins, as of a ring-laser INS at 64 Hz."""
    from pyins import sim

    latitude_deg, interval_s = 51.0784, 1.0 / 64.0
    time = np.arange(round(1847.0 / interval_s) + 1) * interval_s
    rph, shake, stretches = _disturbed_axes(time)
    place = np.tile([latitude_deg, 0.0, 0.0], (len(time), 1))
    _, imu = sim.generate_imu(time, place, rph, np.zeros((len(time), 3)), "increment")
    clean = imu.to_numpy()[1:, :3], imu.to_numpy()[1:, 3:] + shake[1:] * interval_s
    noise = Noise(angle_random_walk=np.deg2rad(0.002) / 60.0)
    angle, velocity = noise.added(*clean, interval_s, np.random.default_rng(5))
    recording = IncrementRecording(interval_s, angle, velocity)
    rests = recording.rests
    assert len(rests) == len(stretches) + 1
    assert {each.kind for each in find_rotations(recording)} == {"disturbance"}
    for rest, begin_s, end_s in zip(
        rests,
        [0.0, *(end for _, end in stretches)],
        [*(begin for begin, _ in stretches), 1847.0],
        strict=True,
    ):
        # Swings begin and end slowly.
        assert begin_s - 2.0 <= rest.begin * interval_s < begin_s + 3.0
        assert end_s - 3.0 < rest.end * interval_s <= end_s + 2.0
        duration_s = (rest.end - rest.begin) * interval_s
        rate, force = (each[rest.begin : rest.end].sum(axis=0) / duration_s for each in (angle, velocity))
        up_rate = rate @ force / np.linalg.norm(force)
        sigma = noise.angle_random_walk / np.sqrt(duration_s)
        # pyins has North, East and Down: the unit's force points up in it all the same.
        assert up_rate == pytest.approx(EARTH * np.sin(np.deg2rad(latitude_deg)), abs=4.0 * sigma)
        assert np.linalg.norm(rate) == pytest.approx(EARTH, abs=4.0 * sigma)
    measured = measure_noise([recording])
    assert measured.angle_random_walk == pytest.approx(np.full(3, noise.angle_random_walk), rel=0.2)
    assert measured.velocity_random_walk == pytest.approx(np.full(3, noise.velocity_random_walk), rel=0.35)
