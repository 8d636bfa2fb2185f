"""Attitude from increments of fast motion, against the closed form."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrobench.bench.calibration.strapdown import attitudes
from gyrobench.bench.navigation.earth import earth_rate_enu

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
