"""The Earth's rotation, gravity and curvature (WGS-84)."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray

#: Rotation rate of the Earth, rad/s.
EARTH_RATE = 7.292115e-5
#: Semi-major axis of the ellipsoid, m.
_SEMI_MAJOR_AXIS = 6378137.0
#: Flattening of the ellipsoid.
_FLATTENING = 1.0 / 298.257223563
#: Square of the first eccentricity of the ellipsoid.
_ECCENTRICITY_SQUARED = _FLATTENING * (2.0 - _FLATTENING)
#: Mean radius of the Earth, m, used if the difference between North and East does not matter.
MEAN_RADIUS = 6371008.8
#: Normal gravity at the equator, m/s^2.
_EQUATOR_GRAVITY = 9.7803253359
#: Normal gravity at the poles, m/s^2.
_POLE_GRAVITY = 9.8321849378

_CENTRIFUGAL_RATIO = 0.00344978650684  # rate^2 a^2 b / GM
_SOMIGLIANA = (1.0 - _FLATTENING) * _POLE_GRAVITY / _EQUATOR_GRAVITY - 1.0


def earth_rate_enu(latitude: float) -> FloatArray:
    """Resolve the rotation of the Earth in the navigation frame, rad/s, at a latitude in rad."""
    return EARTH_RATE * np.array([0.0, np.cos(latitude), np.sin(latitude)])


def gravity(latitude: float, height: float = 0.0) -> float:
    """Compute normal gravity, m/s^2, by Somigliana's formula with the second-order term of height.

    ``latitude``: geodetic latitude, rad. ``height``: height above the ellipsoid, m.
    """
    sine_squared = float(np.sin(latitude)) ** 2
    surface = _EQUATOR_GRAVITY * (1.0 + _SOMIGLIANA * sine_squared)
    surface /= float(np.sqrt(1.0 - _ECCENTRICITY_SQUARED * sine_squared))
    relative = height / _SEMI_MAJOR_AXIS
    slope = 1.0 + _FLATTENING + _CENTRIFUGAL_RATIO - 2.0 * _FLATTENING * sine_squared
    return surface * (1.0 - 2.0 * slope * relative + 3.0 * relative**2)


def curvature_radii(latitude: float, height: float) -> tuple[float, float]:
    """Compute the radii of curvature along the meridian (North) and across it (East), m."""
    shrink = 1.0 - _ECCENTRICITY_SQUARED * float(np.sin(latitude)) ** 2
    east = _SEMI_MAJOR_AXIS / float(np.sqrt(shrink))
    north = east * (1.0 - _ECCENTRICITY_SQUARED) / shrink
    return north + height, east + height
