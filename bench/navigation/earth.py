"""The Earth's rotation, gravity and curvature (WGS-84)."""

from __future__ import annotations

import numpy as np

from gyrobench.bench.foundations.arrays import STANDARD_GRAVITY, FloatArray

#: Rotation rate of the Earth, rad/s.
EARTH_RATE = 7.292115e-5
#: Semi-major axis of the ellipsoid, m.
_SEMI_MAJOR_AXIS = 6378137.0
#: Flattening of the ellipsoid.
_FLATTENING = 1.0 / 298.257223563
#: Square of the first eccentricity of the ellipsoid.
_ECCENTRICITY_SQUARED = _FLATTENING * (2.0 - _FLATTENING)
#: Mean radius of the Earth, m, where the difference between North and East does not matter.
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


#: Standard uncertainty of normal gravity, m/s^2: a usual anomaly of 30 mGal.
NORMAL_GRAVITY_SIGMA = 3e-4
#: Largest difference of gravity from normal gravity, m/s^2, above that of laboratories by far, and one that
#: does not matter.
_MAX_ANOMALY, _SAME_GRAVITY = 5e-3, 1e-4


def gravity_uncertainty(known: float | None) -> float:
    """Standard uncertainty of gravity, m/s^2: of normal gravity, or of a number by the digits it is given to.

    ``known``: local gravity, m/s^2; None where normal gravity stands for it.
    """
    if known is None:
        return NORMAL_GRAVITY_SIGMA
    digits = len(repr(float(known)).partition(".")[2])
    return float(0.5 * 10.0**-digits / np.sqrt(3.0))


def gravity_fault(known: float, sigma: float | None, latitude_deg: float, height_m: float) -> str:
    """Why a number can't be the gravity of a place; empty if it can.

    ``known``: m/s^2, with the standard uncertainty ``sigma``, by default that of its digits.
    """
    normal = gravity(float(np.deg2rad(latitude_deg)), height_m)
    allowed = 2.0 * (gravity_uncertainty(known) if sigma is None else sigma)
    away = abs(known - normal)
    place = f"normal gravity at {latitude_deg:g} deg and {height_m:g} m is {normal:.5f} m/s^2"
    if known == STANDARD_GRAVITY and away > max(allowed, _SAME_GRAVITY):
        return (
            f"{known} m/s^2 is standard gravity, which defines the unit g; {place}. Leave gravity_mps2 out, "
            "or enter the gravity measured there"
        )
    if away > _MAX_ANOMALY + allowed:
        return (
            f"gravity_mps2 is {known}; {place}, from which places differ by up to {_MAX_ANOMALY:g} m/s^2. "
            "Correct gravity, latitude or height, or leave gravity_mps2 out"
        )
    return ""


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
