"""White rows against generalised least squares with the whole covariance matrix."""

import numpy as np
import pytest

from gyrobench.bench.calibration.increment_recording import SensorNoise
from gyrobench.bench.calibration.section import IncrementEpochs, IncrementSection
from gyrobench.bench.calibration.strapdown import Trajectory
from gyrobench.bench.calibration.whitening import _intervals, white_rows
from gyrobench.bench.navigation.attitude import rotation_matrices

N, LATITUDE, GRAVITY, TABLE = 8, 0.7, 9.8, 2e-6
NOISE = SensorNoise(np.full(3, 3e-6), np.full(3, 1e-6), np.full(3, 2e-4), np.full(3, 1e-3))
#: A turn from the rest that ends with epoch 3 to the one that begins with epoch 5.
BEFORE, AFTER, TURN = 3, 5, rotation_matrices(np.array([[0.0, 0.0, 0.5]]))[0]


def recorded(has_vertical):
    random = np.random.default_rng(5)
    at_rest = ~np.isin(np.arange(1, N + 1), [4])
    epochs = IncrementEpochs(np.arange(100, 100 * N + 1, 100), at_rest, [(BEFORE, AFTER, TURN)], has_vertical)
    section = IncrementSection(0.01, np.zeros((100 * N, 3)), np.zeros((100 * N, 3)), 300, epochs)
    attitude = np.array([np.eye(3)] * 5 + [TURN] * 4)
    response = random.normal(size=(N + 1, 6, 4))
    return section, Trajectory(attitude, random.normal(0.0, 1e-3, (N + 1, 3)), GRAVITY, response)


@pytest.mark.parametrize("has_vertical", [True, False])
def test_the_normal_equations_are_those_of_generalised_least_squares(has_vertical):
    section, trajectory = recorded(has_vertical)
    rows, data = white_rows(section, trajectory, NOISE, LATITUDE, TABLE, None)
    transition, covariance = _intervals(trajectory, section.lengths_s, NOISE, LATITUDE)
    white = NOISE.white_velocity[0] ** 2
    # Covariance of the states psi, u at all epochs.
    states = np.zeros((6 * (N + 1),) * 2)
    states[3:6, 3:6] = white * np.eye(3)
    for k in range(N):
        done, new = slice(0, 6 * (k + 1)), slice(6 * (k + 1), 6 * (k + 2))
        carried = transition[k] @ states[6 * k : 6 * (k + 1), done]
        states[new, done], states[done, new] = carried, carried.T
        states[new, new] = transition[k] @ states[6 * k : 6 * (k + 1), 6 * k : 6 * (k + 1)] @ transition[k].T
        states[new, new] += covariance[k]
    measured = [
        (np.eye(6 * (N + 1))[6 * k + 3 + i], white, trajectory.response[k, 3 + i], -trajectory.integral[k, i])
        for k in np.flatnonzero(section.epochs.at_rest) + 1
        for i in range(3 if has_vertical else 2)
    ]
    turned = np.zeros((3, 6 * (N + 1)))
    turned[:, 6 * AFTER : 6 * AFTER + 3], turned[:, 6 * BEFORE : 6 * BEFORE + 3] = np.eye(3), -TURN
    turn_response = trajectory.response[AFTER, :3] - TURN @ trajectory.response[BEFORE, :3]
    variance = TABLE**2 + 2.0 * NOISE.white_angle[0] ** 2
    measured += [(turned[i], variance, turn_response[i], 0.0) for i in range(3)]
    H, variances, design, values = (np.array(each) for each in zip(*measured, strict=True))
    weights = np.linalg.inv(H @ states @ H.T + np.diag(variances))
    both, white_both = np.column_stack([design, values]), np.column_stack([rows, data])
    np.testing.assert_allclose(white_both.T @ white_both, both.T @ weights @ both, rtol=1e-6)
