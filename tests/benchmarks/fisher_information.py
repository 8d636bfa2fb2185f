"""Fisher information of navigation output by brute force: shares no code with the estimators.

Responses are differences of the simulated output to each error of the unit, with all of its mechanisation.
The covariance of all epochs is that of a free-inertial INS with white noise of its sensors.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.linalg import cho_factor, cho_solve, expm
from scipy.spatial.transform import Rotation

from tests.adversarial.strapdown import ARCSEC, DPH, EPOCH_S, UG, Place, Table, Unit, simulate

#: Step, s; gravity, m/s^2; rate, rad/s, and radius, m, of the Earth.
STEP_S, GRAVITY, SPIN, RADIUS = 10.0, 9.81, 7.292115e-5, 6.371e6
#: Field of the unit, place in it, step in its unit, SI of that unit. Of the accelerometers those below the
#: diagonal: they fix the body frame.
ERRORS = [
    *(("gyro_bias_dph", i, 0.01, DPH) for i in range(3)),
    *(("gyro_scale_ppm", i, 50.0, 1e-6) for i in range(3)),
    *(("gyro_misalignment_arcsec", i, 20.0, ARCSEC) for i in range(6)),
    *(("accelerometer_bias_ug", i, 50.0, UG) for i in range(3)),
    *(("accelerometer_misalignment_arcsec", i, 20.0, ARCSEC) for i in (2, 4, 5)),
]
NAMES = [
    *(f"gyro_bias_{axis}" for axis in "xyz"),
    *(f"gyro_scale_factor_{axis}" for axis in "xyz"),
    *(f"gyro_misalignment_{axes}" for axes in ("xy", "xz", "yx", "yz", "zx", "zy")),
    *(f"accelerometer_bias_{axis}" for axis in "xyz"),
    *(f"accelerometer_misalignment_{axes}" for axes in ("yx", "zx", "zy")),
]
#: Large errors, SI, and initial attitude errors, rad.
_SIZES = np.array([1e-6] * 3 + [1e-2] * 9 + [1e-1] * 3 + [1e-2] * 3)
_ATTITUDE = 0.5


def fisher_sigmas(latitude_deg, recordings, velocity_mps, heading, walks):
    """Standard uncertainties, SI, by name.

    ``recordings``: pairs of Schedule and angles. ``velocity_mps``: white noise at 1 Hz. ``heading``: standard
    uncertainty, rad, of the heading over each turn about Up. ``walks``: angle and velocity random walk, SI.
    """
    count = len(ERRORS)
    total = np.diag(np.concatenate([_SIZES, np.full(3 * len(recordings), _ATTITUDE)]) ** -2.0)
    for number, (schedule, angles) in enumerate(recordings):
        rows, covariance = _recording(latitude_deg, schedule, angles, velocity_mps, heading, walks)
        here = [*range(count), *range(count + 3 * number, count + 3 * number + 3)]
        total[np.ix_(here, here)] += rows.T @ cho_solve(cho_factor(covariance), rows)
    scale = 1.0 / np.sqrt(np.diag(total))
    sigmas = np.sqrt(np.diag(np.linalg.inv(total * np.outer(scale, scale)))) * scale
    return dict(zip(NAMES, sigmas[:count], strict=True))


def _recording(latitude_deg, schedule, angles, velocity_mps, heading, walks):
    """Responses (m, 18 + 3) of velocities and turned headings, and their covariance (m, m)."""
    exact = Unit(angle_random_walk=0.0, velocity_random_walk=0.0)

    def output(unit):
        return simulate(unit, Place(latitude_deg), schedule, angles, np.random.default_rng(0))

    base, every = output(exact), round(STEP_S / EPOCH_S)
    spans = [(first, end - 1) for first, end in base.windows]
    # A velocity in the middle of each step stands for those of its seconds.
    middles = np.concatenate([np.arange(first + every // 2, end, every) for first, end in spans])
    chosen = np.union1d(middles, np.ravel(spans))

    def states(unit):
        """Errors of velocity East and North, and of the attitude, at the chosen epochs, (5 n,)."""
        found = output(unit)
        away = Rotation.from_matrix(found.C_nb[chosen] @ base.C_nb[chosen].transpose(0, 2, 1)).as_rotvec()
        velocity = found.velocity_enu_mps[chosen] - base.velocity_enu_mps[chosen]
        return np.hstack([velocity[:, :2], away]).ravel()

    columns = []
    for name, place, step, si in ERRORS:
        values = list(getattr(exact, name))
        values[place] = step
        columns.append(states(replace(exact, **{name: tuple(values)})) / (step * si))
    transitions, covariance = _noise(latitude_deg, base.time_s[chosen], walks)
    columns += list(transitions[:, :, 2:].reshape(-1, 3).T)
    up = Table().attitude(*np.radians(angles).T)[:, 2]
    turns = [ends for ends, a, b in zip(pairwise(spans), up, up[1:], strict=False) if np.allclose(a, b)]
    taken = np.zeros((2 * len(middles) + len(turns), 5 * len(chosen)))
    white = np.full(len(taken), velocity_mps**2 / STEP_S)
    for number, epoch in enumerate(np.searchsorted(chosen, middles)):
        taken[[2 * number, 2 * number + 1], [5 * epoch, 5 * epoch + 1]] = 1.0
    for turn, ((_, end), (first, _)) in enumerate(turns):
        before, after = np.searchsorted(chosen, [end, first])
        taken[2 * len(middles) + turn, [5 * before + 4, 5 * after + 4]] = -1.0, 1.0
    white[2 * len(middles) :] = heading**2
    return taken @ np.array(columns).T, taken @ covariance @ taken.T + np.diag(white)


def _noise(latitude_deg, time_s, walks):
    """Transitions (n, 5, 5) from the start, and covariance (5 n, 5 n) by the noise of the sensors."""
    sine, cosine = np.sin(np.radians(latitude_deg)), np.cos(np.radians(latitude_deg))
    # Errors of velocity East and North, of the attitude East, North and Up, and of the latitude.
    dynamics = np.zeros((6, 6))
    dynamics[0, [1, 3]] = 2.0 * SPIN * sine, GRAVITY
    dynamics[1, [0, 2]] = -2.0 * SPIN * sine, -GRAVITY
    dynamics[2, [1, 3, 4]] = 1.0 / RADIUS, SPIN * sine, -SPIN * cosine
    dynamics[3, [0, 2, 5]] = -1.0 / RADIUS, -SPIN * sine, SPIN * sine
    dynamics[4, [0, 2, 5]] = -sine / cosine / RADIUS, SPIN * cosine, -SPIN * cosine
    dynamics[5, 1] = 1.0 / RADIUS
    density = np.diag([walks[1] ** 2] * 2 + [walks[0] ** 2] * 3 + [0.0])
    transitions = np.array([expm(dynamics * each) for each in time_s])
    n, state, now_s = len(time_s), np.zeros((6, 6)), 0.0
    covariance = np.zeros((n, 5, n, 5))
    for i in range(n):
        length_s = time_s[i] - now_s
        step, now_s = expm(dynamics * length_s), time_s[i]
        parts = (expm(dynamics * length_s * (k + 0.5) / 20.0) for k in range(20))
        state = step @ state @ step.T + sum(each @ density @ each.T for each in parts) * length_s / 20.0
        later = transitions[i:] @ np.linalg.solve(transitions[i], state)
        covariance[i:, :, i] = later[:, :5, :5]
        covariance[i, :, i:] = later[:, :5, :5].transpose(2, 0, 1)
    return transitions[:, :5, :5], covariance.reshape(5 * n, 5 * n)
