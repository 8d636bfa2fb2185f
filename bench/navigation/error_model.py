"""Linear error model of an INS at rest: the paper's equations (3) and (4) with the terms that it neglects.

The state is ``(phi_E, phi_N, phi_U, dV_E, dV_N, dL)``: attitude error in rad, velocity error in
m/s and latitude error in rad, at fixed altitude. In addition to the paper's terms, the model has the
transport rate (the Schuler loop), the Coriolis acceleration, and the change of the Earth rate with the
latitude error.

References
----------
Yu et al., "The Six-Position Calibration Technique of Gyro Bias for Rotational Inertial
Navigation System Based on Ring Laser Gyroscope", equations (3) and (4).
Titterton and Weston, Strapdown Inertial Navigation Technology, chapter 12.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.earth import curvature_radii, earth_rate_enu, gravity

#: Numbers of components of the state and of the input.
STATES, INPUTS = 6, 5

#: Highest latitude, rad, at which the Earth's horizontal rate is large enough for gyrocompassing.
MAX_LATITUDE = np.deg2rad(85.0)

_INPUT = np.zeros((STATES, INPUTS))
_INPUT[:3, :3] = -np.eye(3)
_INPUT[3:5, 3:] = np.eye(2)
_TERMS = 16


@dataclass(frozen=True)
class Site:
    """Location of the bench.

    Raises MeasurementError near a pole: the Earth's rotation is nearly vertical there, so gyrocompassing
    fails.
    """

    #: latitude, height: Geodetic latitude in rad, height above the ellipsoid in m.
    latitude: float
    height: float = 0.0

    def __post_init__(self) -> None:
        if not abs(self.latitude) <= MAX_LATITUDE:
            raise MeasurementError(
                f"at a latitude of {np.rad2deg(self.latitude):.1f} deg gyrocompassing fails; "
                f"at most {np.rad2deg(MAX_LATITUDE):g} deg North or South"
            )

    @property
    def gravity(self) -> float:
        """Normal gravity, m/s^2."""
        return gravity(self.latitude, self.height)


@dataclass(frozen=True, eq=False)
class Intervals:
    """The error model integrated over n intervals of time."""

    transition: FloatArray  #: Shape (n, 6, 6). Final state for a unit of each component of the initial state.
    #: Shape (n, 6, 5). Final state for a unit of each constant input: gyro error East, North, Up in rad/s,
    #: acceleration error East, North in m/s^2.
    response: FloatArray
    covariance: FloatArray  #: Shape (n, 6, 6). Of the final state, by white noise of rates and accelerations.


def dynamics(site: Site) -> FloatArray:
    """System matrix (6, 6): the derivative of the state is this times the state."""
    _, rate_n, rate_u = earth_rate_enu(site.latitude)
    meridian, across = curvature_radii(site.latitude, site.height)
    tangent = np.tan(site.latitude)
    g = site.gravity
    return np.array(
        [
            [0.0, rate_u, -rate_n, 0.0, -1.0 / meridian, 0.0],
            [-rate_u, 0.0, 0.0, 1.0 / across, 0.0, -rate_u],
            [rate_n, 0.0, 0.0, tangent / across, 0.0, rate_n],
            [0.0, -g, 0.0, 0.0, 2.0 * rate_u, 0.0],
            [g, 0.0, 0.0, -2.0 * rate_u, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 1.0 / meridian, 0.0],
        ]
    )


def integrate(
    site: Site, durations: FloatArray, angle_random_walk: float, velocity_random_walk: float
) -> Intervals:
    """Integrate the model over intervals at rest.

    ``durations`` (n,): s; the power series in them are accurate to 1e-7 up to a quarter of an hour.
    ``angle_random_walk``, ``velocity_random_walk``: noise of each gyro and accelerometer, rad/sqrt(s) and
    m/s/sqrt(s).
    """
    transitions, responses, covariances = _series(site, angle_random_walk, velocity_random_walk)
    powers = np.power.outer(durations, np.arange(_TERMS))
    return Intervals(
        np.tensordot(powers, transitions, 1),
        np.tensordot(powers * durations[:, np.newaxis], responses, 1),
        np.tensordot(powers, covariances, 1),
    )


def unit_walks(site: Site, durations: FloatArray) -> FloatArray:
    """Covariances (2, n, 6, 6) due to unit angle and velocity random walk over durations (n,), s."""
    powers = np.power.outer(durations, np.arange(_TERMS))
    return np.stack([np.tensordot(powers, _series(site, *unit)[2], 1) for unit in ((1.0, 0.0), (0.0, 1.0))])


@lru_cache(maxsize=64)
def _series(
    site: Site, angle_random_walk: float, velocity_random_walk: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Coefficients of the power series of transition, response over time, and covariance, (k, 6, ...)."""
    F = dynamics(site)
    transition, response, covariance = np.eye(STATES), _INPUT, np.zeros((STATES, STATES))
    noise = np.diag([angle_random_walk**2] * 3 + [velocity_random_walk**2] * 2 + [0.0])
    terms = []
    for order in range(_TERMS):
        terms.append((transition, response / (order + 1), covariance))
        covariance = (noise if order == 0 else F @ covariance + covariance @ F.T) / (order + 1)
        transition = F @ transition / (order + 1)
        response = F @ response / (order + 1)
    transitions, responses, covariances = (np.stack(each) for each in zip(*terms, strict=True))
    for each in (transitions, responses, covariances):
        each.setflags(write=False)
    return transitions, responses, covariances
