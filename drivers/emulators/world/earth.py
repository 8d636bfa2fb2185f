"""The Earth as the simulation knows it: WGS-84 ellipsoid, normal gravity, rotation."""

from __future__ import annotations

import math

import numba

#: Rotation rate of the Earth, rad/s.
EARTH_RATE = 7.292115e-5
#: Semi-major axis of the ellipsoid, m.
SEMI_MAJOR_AXIS = 6378137.0
#: First eccentricity squared of the ellipsoid.
ECCENTRICITY_SQUARED = 6.69437999014e-3
_EQUATOR_GRAVITY = 9.7803253359
_SOMIGLIANA_K = 1.93185265241e-3


@numba.njit(cache=True)
def normal_gravity(latitude: float, height: float) -> float:
    """Gravity in m/s2 at geodetic latitude (rad) and height (m), Somigliana with free air term."""
    sin2 = math.sin(latitude) ** 2
    surface = _EQUATOR_GRAVITY * (1.0 + _SOMIGLIANA_K * sin2) / math.sqrt(1.0 - ECCENTRICITY_SQUARED * sin2)
    return surface * (1.0 - 2.0 * height / SEMI_MAJOR_AXIS)


@numba.njit(cache=True)
def principal_radii(latitude: float) -> tuple[float, float]:
    """Radii of curvature in m at a latitude in rad: along the meridian, and across it."""
    root = 1.0 - ECCENTRICITY_SQUARED * math.sin(latitude) ** 2
    across = SEMI_MAJOR_AXIS / math.sqrt(root)
    return across * (1.0 - ECCENTRICITY_SQUARED) / root, across
