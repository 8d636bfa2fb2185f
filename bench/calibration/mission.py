"""Position error of a rotational INS due to the residual errors of its sensors.

A dual-axis gimbal turns the sensors from one attitude to the next. The increments of gyros and accelerometers
with given :class:`SensorErrors` are computed without approximation and navigated: attitude, velocity and
position on the ellipsoid, at fixed altitude. The vehicle rests, the errors are constant, and the navigation
starts without error. Position errors are linear in such small sensor errors, so their distribution due to the
uncertainty of the coefficients is sampled with the responses to each coefficient.

References
----------
Titterton and Weston, *Strapdown Inertial Navigation Technology*, 2nd ed., chapters 3 and 11.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT, SensorErrors
from gyrobench.bench.calibration.turns import multiply, set_turn
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.kernels import compiled, multiply_3x3
from gyrobench.bench.navigation.attitude import rotation_matrices, rotation_vectors
from gyrobench.bench.navigation.earth import EARTH_RATE, curvature_radii, earth_rate_enu
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.rotational_ins import (
    GIMBALS,
    NAUTICAL_MILE_M,
    RETRACED_HALF_TURNS,
    RotationScheme,
)

#: Times of a mission at which its error is stated, h.
HOURS = (1.0, 8.0, 24.0)

_S_PER_H, _OUTPUT_INTERVAL_S = 3600.0, 60.0
_DURATION_S = HOURS[-1] * _S_PER_H
_DWELL_STEP_S, _TURN_STEP_DEG = 10.0, 5.0
#: Step of a coefficient in the computation of its response, as a share of its large size.
_STEP_SHARE = 1e-4
_DRAWS = 2000


@dataclass(frozen=True, eq=False)
class MissionError:
    """Largest distance from the true position up to each of :data:`HOURS`, nmi."""

    stated_nmi: FloatArray  #: Shape (3,). For the estimates of the coefficients.
    #: median_nmi, high_nmi: Shape (3,). Median and 95 % quantile, given the uncertainty of the coefficients.
    median_nmi: FloatArray
    high_nmi: FloatArray
    time_s: FloatArray  #: Shape (n,). Every minute.
    distance_nmi: FloatArray  #: Shape (n,). Distance from the true position, for the estimates.


def mission_error(values: FloatArray, covariance: FloatArray, site: Site) -> MissionError:
    """Error of a mission of a day with retraced half turns, due to residual coefficients.

    ``values`` (21,), ``covariance`` (21, 21): of :data:`~.coefficients.COEFFICIENTS`, SI.
    """
    time_s, responses = _responses(site)
    stated = np.hypot(*navigate_mission(SensorErrors.from_vector(values), site, RETRACED_HALF_TURNS)[1])
    draws = np.random.default_rng(0).multivariate_normal(values, covariance, _DRAWS, method="eigh")
    east_m, north_m = np.moveaxis(np.tensordot(draws, responses, axes=1), 1, 0)
    squares = east_m**2 + north_m**2
    ends = [int(np.searchsorted(time_s, hours * _S_PER_H)) + 1 for hours in HOURS]
    largest = np.maximum.reduceat(squares[:, : ends[-1]], [0, *ends[:-1]], axis=1)
    largest_nmi = np.sqrt(np.maximum.accumulate(largest.T)) / NAUTICAL_MILE_M
    return MissionError(
        stated_nmi=np.array([stated[:end].max() for end in ends]) / NAUTICAL_MILE_M,
        median_nmi=np.median(largest_nmi, axis=1),
        high_nmi=np.quantile(largest_nmi, 0.95, axis=1),
        time_s=time_s,
        distance_nmi=stated / NAUTICAL_MILE_M,
    )


def navigate_mission(
    errors: SensorErrors, site: Site, scheme: RotationScheme
) -> tuple[FloatArray, FloatArray]:
    """Navigate for a day with sensors that have errors.

    Returns times (n,), s, every minute, and errors East and North (2, n), m.
    """
    interval_s, angle, velocity, start = _increments(site, scheme)
    measured_angle = angle @ (np.eye(3) + errors.gyro_matrix).T + errors.gyro_bias * interval_s[:, np.newaxis]
    measured_velocity = (
        velocity @ (np.eye(3) + errors.force_matrix).T + errors.force_bias * interval_s[:, np.newaxis]
    )
    cycles = int(np.ceil(_DURATION_S / interval_s.sum()))
    half_turned = np.einsum("nij,nj->ni", rotation_matrices(0.5 * measured_angle), measured_velocity)
    track_m = _navigate(
        interval_s, rotation_matrices(measured_angle), half_turned, cycles, start, site.latitude,
        np.array(curvature_radii(site.latitude, site.height)), EARTH_RATE,
    )  # fmt: skip
    ends_s = np.concatenate([[0.0], np.cumsum(np.tile(interval_s, cycles))])
    time_s = np.arange(0.0, _DURATION_S + 0.5 * _OUTPUT_INTERVAL_S, _OUTPUT_INTERVAL_S)
    return time_s, np.stack([np.interp(time_s, ends_s, track) for track in track_m])


@lru_cache(maxsize=4)
def _responses(site: Site) -> tuple[FloatArray, FloatArray]:
    """Times (n,), and errors East and North (21, 2, n), m, per unit of each coefficient."""
    time_s, reference_m = navigate_mission(SensorErrors(), site, RETRACED_HALF_TURNS)
    sizes = _STEP_SHARE * np.array([each.size for each in COEFFICIENTS])
    single_errors = [SensorErrors.from_vector(row) for row in np.eye(COUNT) * sizes]
    return time_s, np.array(
        [
            (navigate_mission(each, site, RETRACED_HALF_TURNS)[1] - reference_m) / size
            for each, size in zip(single_errors, sizes, strict=True)
        ]
    )


@lru_cache(maxsize=4)
def _increments(site: Site, scheme: RotationScheme) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """True increments of one cycle of a scheme, and the attitude (3, 3) at its start.

    Lengths (n,), s, rotation vectors (n, 3) against inertial space, and velocities (n, 3), m/s, in the body
    axes in the middle of each step.
    """
    angles, lengths = [scheme.angles_deg()[0]], list[float]()
    for start, end in itertools.pairwise(scheme.angles_deg()):
        turn_deg = float(np.abs(np.subtract(end, start)).sum())
        dwell_steps = int(np.ceil(scheme.dwell_s / _DWELL_STEP_S))
        turn_steps = int(np.ceil(turn_deg / _TURN_STEP_DEG))
        angles += [start] * dwell_steps
        angles += [
            tuple(np.add(start, k / turn_steps * np.subtract(end, start))) for k in range(1, turn_steps + 1)
        ]
        lengths += [scheme.dwell_s / dwell_steps] * dwell_steps
        lengths += [turn_deg / scheme.rate_dps / turn_steps] * turn_steps
    edges_deg, interval_s = np.array(angles), np.array(lengths)
    C_nb = GIMBALS.attitude(*edges_deg.T)
    middle = GIMBALS.attitude(*(0.5 * (edges_deg[:-1] + edges_deg[1:])).T)
    earth = rotation_matrices(np.outer(interval_s, earth_rate_enu(site.latitude)))
    angle = rotation_vectors(np.swapaxes(C_nb[:-1], 1, 2) @ earth @ C_nb[1:])
    velocity = middle[:, 2] * (site.gravity * interval_s)[:, np.newaxis]
    return interval_s, angle, velocity, C_nb[0]


@compiled
def _navigate(
    interval_s: FloatArray, turns: FloatArray, velocity: FloatArray, cycles: int, start: FloatArray,
    latitude: float, radii: FloatArray, earth_rate: float,
) -> FloatArray:  # fmt: skip
    """Error East and North (2, n + 1), m, from the increments of one cycle, repeated.

    Half of the rotation of the navigation frame is applied before, and half after each step.

    ``turns`` (n, 3, 3): matrices of the rotations. ``velocity`` (n, 3): in the axes before each step.
    """
    steps = interval_s.size
    track = np.zeros((2, cycles * steps + 1))
    C_nb, product, turn = start.copy(), np.empty((3, 3)), np.empty((3, 3))
    east_mps, north_mps, east_m, north_m = 0.0, 0.0, 0.0, 0.0
    meridian_m, across_m = radii[0], radii[1]
    for k in range(cycles * steps):
        step = k % steps
        dt = interval_s[step]
        half = -0.5 * dt
        present_latitude = latitude + north_m / meridian_m
        cosine, sine = np.cos(present_latitude), np.sin(present_latitude)
        tangent = sine / cosine
        earth_n, earth_u = earth_rate * cosine, earth_rate * sine
        turn_n, turn_u = earth_n + east_mps / across_m, earth_u + east_mps * tangent / across_m
        set_turn(turn, (-half * north_mps / meridian_m, half * turn_n, half * turn_u))
        multiply_3x3(product, turn, C_nb)
        force = multiply(product, (velocity[step, 0], velocity[step, 1], velocity[step, 2]))
        multiply_3x3(C_nb, product, turns[step])
        coriolis = earth_u + turn_u
        change_e, change_n = force[0] + coriolis * north_mps * dt, force[1] - coriolis * east_mps * dt
        east_m += (east_mps + 0.5 * change_e) * dt * np.cos(latitude) / cosine
        north_m += (north_mps + 0.5 * change_n) * dt
        east_mps += change_e
        north_mps += change_n
        turn_n, turn_u = earth_n + east_mps / across_m, earth_u + east_mps * tangent / across_m
        set_turn(turn, (-half * north_mps / meridian_m, half * turn_n, half * turn_u))
        multiply_3x3(product, turn, C_nb)
        C_nb, product = product, C_nb
        track[0, k + 1], track[1, k + 1] = east_m, north_m
    return track
