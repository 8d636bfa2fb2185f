import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrobench.bench.foundations.arrays import DPH_TO_RADPS
from gyrobench.drivers.emulators.world.sensor_errors import MICRO_G, sense
from gyrobench.drivers.emulators.world.strapdown import (
    EARTH_RATE,
    euler_angles,
    matrix_of,
    navigate,
    normal_gravity,
    true_increments,
)

EAST, UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
DT = 0.01
HEIGHT = 100.0


def increments(latitude, outer_rad, inner_rad):
    return true_increments(EAST, UP, np.eye(3), outer_rad, inner_rad, latitude, HEIGHT, DT)


def level_state(latitude, C=None):
    state = np.zeros(8)
    state[:4] = Rotation.from_matrix(np.eye(3) if C is None else C).as_quat(scalar_first=True)
    state[6] = latitude
    return state


def turn(seconds_before, seconds_turn, seconds_after, angle_rad):
    steps = [round(s / DT) for s in (seconds_before, seconds_turn, seconds_after)]
    ramp = angle_rad * (1 - np.cos(np.linspace(0, np.pi, steps[1] + 1))) / 2
    return np.concatenate([np.zeros(steps[0]), ramp, np.full(steps[2], angle_rad)])


@pytest.mark.parametrize("latitude_deg", [-60.0, 0.0, 36.4, 70.0])
def test_perfect_sensors_at_rest_stay_at_rest_for_an_hour(latitude_deg):
    latitude = np.radians(latitude_deg)
    still = np.zeros(360_001)
    rotation, velocity = increments(latitude, still, still)
    states = navigate(level_state(latitude), rotation, velocity, DT, HEIGHT, 0, 1000)
    assert np.abs(states[:, 4:6]).max() < 1e-6
    assert np.abs(states[:, 6] - latitude).max() * 6.4e6 < 1e-3
    assert np.abs(states[:, 1:4]).max() < 1e-10


def test_perfect_sensors_through_a_turn_of_both_axes_come_to_rest_in_the_new_attitude():
    latitude = np.radians(36.4)
    outer = np.pi / 2 - turn(60, 18, 60, np.pi)
    inner = turn(60, 18, 60, np.pi)
    rotation, velocity = increments(latitude, outer, inner)
    start = Rotation.from_rotvec([np.pi / 2, 0, 0]).as_matrix()
    states = navigate(level_state(latitude, start), rotation, velocity, DT, HEIGHT, 0, 100)
    end = Rotation.from_rotvec([-np.pi / 2, 0, 0]) * Rotation.from_rotvec([0, 0, np.pi])
    error = Rotation.from_matrix(matrix_of(states[-1, :4])) * end.inv()
    assert error.magnitude() < 1e-9
    assert np.abs(states[-1, 4:6]).max() < 1e-4


def test_level_errors_swing_with_the_schuler_period():
    latitude = np.radians(36.4)
    still = np.zeros(2 * 5064 * 100 + 1)
    rotation, velocity = increments(latitude, still, still)
    tilted = Rotation.from_rotvec([0, 1e-4, 0]).as_matrix()
    states = navigate(level_state(latitude, tilted), rotation, velocity, DT, HEIGHT, 99, 100)
    crossings = np.flatnonzero(np.diff(np.sign(states[:, 4])))
    half_period_s = np.diff(crossings[crossings > 600]).mean()
    assert 2 * half_period_s / 60 == pytest.approx(84.4, abs=0.8)


# pyins 1.0.1 passes pandas an argument that pandas 3 ignores with a warning.
@pytest.mark.long
@pytest.mark.filterwarnings("ignore:The copy keyword is deprecated")
def test_agrees_with_an_independent_mechanisation_with_biases_and_a_turn():
    import pandas as pd
    from pyins.strapdown import Integrator

    latitude = np.radians(36.4)
    inner = turn(600, 18, 600, np.pi)
    rotation, velocity = increments(latitude, np.zeros(inner.size), inner)
    zero = np.zeros((3, 3))
    none = np.zeros_like(rotation)
    rotation = sense(rotation, zero, np.array([0.05, -0.03, 0.04]) * DPH_TO_RADPS, none, DT, 0.0, np.zeros(3))
    velocity = sense(velocity, zero, np.array([50.0, -80.0, 30.0]) * MICRO_G, none, DT, 0.0, np.zeros(3))
    ours = navigate(level_state(latitude), rotation, velocity, DT, HEIGHT, 99, 100)

    # pyins takes velocity increments already resolved in the body frame at the start of each sample.
    corrected = velocity + 0.5 * np.cross(rotation, velocity)
    to_frd = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1.0]])
    table = pd.DataFrame(
        np.hstack([np.full((len(rotation), 1), DT), rotation @ to_frd.T, corrected @ to_frd.T]),
        columns=["dt", "theta_x", "theta_y", "theta_z", "dv_x", "dv_y", "dv_z"],
        index=DT * np.arange(1, len(rotation) + 1),
    )
    start = {
        "lat": 36.4,
        "lon": 0,
        "alt": HEIGHT,
        "VN": 0,
        "VE": 0,
        "VD": 0,
        "roll": 0,
        "pitch": 0,
        "heading": 0,
    }
    theirs = Integrator(pd.Series(start, dtype=float), with_altitude=False).integrate(table).iloc[100::100]

    np.testing.assert_allclose(ours[:, 4], theirs.VE, atol=2e-6)
    np.testing.assert_allclose(ours[:, 5], theirs.VN, atol=2e-6)
    heading = [np.degrees(euler_angles(matrix_of(s[:4]), False)[2]) for s in ours]
    difference = (np.array(heading) - theirs.heading.to_numpy() + 180) % 360 - 180
    assert np.abs(difference).max() < 1e-7


def test_a_body_at_rest_feels_gravity_up_and_the_earth_rate():
    latitude = np.radians(-30.0)
    rotation, velocity = increments(latitude, np.full(3, np.pi / 2), np.zeros(3))
    np.testing.assert_allclose(velocity[0], [0, normal_gravity(latitude, HEIGHT) * DT, 0], atol=1e-15)
    expected = EARTH_RATE * DT * np.array([0, np.sin(latitude), -np.cos(latitude)])
    np.testing.assert_allclose(rotation[0], expected, atol=1e-18)


def test_pulses_lose_nothing_in_the_long_run():
    true = np.full((10_000, 3), 1.7e-7)
    remainder = np.zeros(3)
    out = sense(true, np.zeros((3, 3)), np.zeros(3), np.zeros_like(true), DT, 1e-6, remainder)
    assert set(np.unique(np.rint(out * 1e6))) <= {0.0, 1.0}
    np.testing.assert_allclose(out.sum(axis=0) + remainder, true.sum(axis=0), atol=1e-12)


@pytest.mark.parametrize("pitch_first", [False, True])
def test_euler_angles_rebuild_the_attitude(pitch_first):
    roll, pitch, heading = 0.3, -0.7, 2.0
    yaw = Rotation.from_rotvec([0, 0, -heading])
    about_x, about_y = Rotation.from_rotvec([pitch, 0, 0]), Rotation.from_rotvec([0, roll, 0])
    attitude = yaw * (about_y * about_x if pitch_first else about_x * about_y)
    np.testing.assert_allclose(euler_angles(attitude.as_matrix(), pitch_first), (roll, pitch, heading))
