"""Attitude from increments of fast motion, against the closed form; responses, against differences."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT, SensorErrors
from gyrobench.bench.calibration.strapdown import ATTITUDE, attitudes, integrate_increments
from gyrobench.bench.navigation.attitude import rotation_matrices
from gyrobench.bench.navigation.earth import earth_rate_enu
from tests.bench.calibration.rotated_unit import Unit

LATITUDE = np.deg2rad(45.0)


def coning_increments(dt, duration_s, cone=0.01, hz=2.0):
    """Increments of angle of a unit whose z axis moves on a cone, and its attitude at the end.

    Increments of an ideal gyro are integrals of the rate, here over 200 steps a sample.
    """
    fine = dt / 200.0
    time = fine * np.arange(round(duration_s / fine) + 1)
    phase = 2.0 * np.pi * hz * time
    vector = cone * np.column_stack([np.cos(phase), np.sin(phase), np.zeros_like(phase)])
    spun = Rotation.from_rotvec(np.outer(time, earth_rate_enu(LATITUDE)))
    attitude = Rotation.from_rotvec(vector)
    inertial = spun * attitude
    steps = (inertial[:-1].inv() * inertial[1:]).as_rotvec()
    return steps.reshape(-1, 200, 3).sum(axis=1), attitude[0].as_matrix(), attitude[-1].as_matrix()


@cache
def drift(dt, duration_s=20.0):
    """Error of the attitude, rad/s, from increments every ``dt``."""
    angle, first, last = coning_increments(dt, duration_s)
    found = attitudes(angle, dt, np.array([len(angle)]), first, LATITUDE)[-1]
    return np.linalg.norm(Rotation.from_matrix(found @ last.T).as_rotvec()) / duration_s


def test_coning_between_samples_is_computed_from_neighbouring_increments():
    # Without it a cone of 10 mrad at 2 Hz drifts by pi cone^2 f (1 - sin(w dt) / (w dt)).
    dt, w = 0.01, 4.0 * np.pi
    without = 0.5 * w * 0.01**2 * (1.0 - np.sin(w * dt) / (w * dt))
    assert drift(dt) < 0.02 * without


def test_the_drift_falls_with_a_high_power_of_the_interval():
    assert drift(0.02) / drift(0.01) == pytest.approx(16.0, rel=0.3)


def test_responses_are_derivatives_however_large_the_errors_are():
    unit = Unit(sample_hz=20.0, dwell_s=5.0)
    angle, velocity = unit.increments()
    random = np.random.default_rng(4)
    errors = SensorErrors(
        random.normal(0.0, 1e-5, 3),
        random.normal(0.0, 0.1, (3, 3)),
        random.normal(0.0, 0.01, 3),
        np.tril(random.normal(0.0, 0.1, (3, 3))),
    )
    ends = np.arange(20, len(angle) + 1, 20)
    gyro, force = np.eye(3) + errors.gyro_matrix, np.eye(3) + errors.force_matrix
    measured = angle @ gyro.T + errors.gyro_bias / 20.0, velocity @ force.T + errors.force_bias / 20.0

    def at(vector, turn):
        start, errors = rotation_matrices(turn), SensorErrors.from_vector(vector)
        columns = [*range(COUNT), *range(ATTITUDE.start, ATTITUDE.stop)]
        return integrate_increments(*measured, 0.05, ends, start, LATITUDE, unit.gravity, columns, errors)

    found = at(errors.vector(), np.zeros(3))
    for number in range(COUNT + 3):
        step = 1e-4 * COEFFICIENTS[number].size if number < COUNT else 1e-5
        change = np.zeros(COUNT + 3)
        change[number] = step
        moved = [at(errors.vector() + sign * change[:COUNT], sign * change[COUNT:]) for sign in (1.0, -1.0)]
        difference = (moved[0].integral - moved[1].integral) / (2.0 * step)
        response = found.response[:, 3:, number]
        assert np.abs(response - difference).max() < 3e-3 * np.abs(difference).max()
