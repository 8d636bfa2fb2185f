import numpy as np
import pytest

from gyrobench.bench.foundations.arrays import (
    DEG_PER_SQRT_H_TO_SI,
    DPH_TO_RADPS,
    RADPS_TO_DPH,
    UG_PER_SQRT_HZ_TO_SI,
)
from gyrobench.bench.navigation import earth


def test_earth_rate_lies_between_north_and_up():
    rate = earth.earth_rate_enu(np.deg2rad(30.0))
    assert rate[0] == 0.0
    assert np.linalg.norm(rate) == pytest.approx(7.292115e-5)
    assert rate[2] == pytest.approx(0.5 * 7.292115e-5)
    assert np.linalg.norm(rate) * RADPS_TO_DPH == pytest.approx(15.041, abs=1e-3)


@pytest.mark.parametrize(
    ("latitude_deg", "expected"), [(0.0, 9.7803253359), (45.0, 9.8061977694), (90.0, 9.8321849378)]
)
def test_gravity_on_the_ellipsoid_is_the_standard_one(latitude_deg, expected):
    assert earth.gravity(np.deg2rad(latitude_deg)) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("latitude_deg", [-60.0, 0.0, 36.4, 89.0])
def test_gravity_and_radii_agree_with_another_library(latitude_deg):
    from pyins import earth as reference

    latitude = np.deg2rad(latitude_deg)
    assert earth.gravity(latitude, 1000.0) == pytest.approx(reference.gravity(latitude_deg, 1000.0), abs=3e-5)
    north, east, _ = reference.principal_radii(latitude_deg, 1000.0)
    assert earth.curvature_radii(latitude, 1000.0) == pytest.approx((north, east), abs=1e-3)


def test_gravity_falls_by_the_free_air_gradient():
    latitude = np.deg2rad(45.0)
    assert earth.gravity(latitude, 1.0) - earth.gravity(latitude) == pytest.approx(-3.086e-6, abs=2e-9)


def test_schuler_period_is_84_minutes():
    period_min = 2.0 * np.pi * np.sqrt(earth.MEAN_RADIUS / earth.gravity(np.deg2rad(45.0))) / 60.0
    assert period_min == pytest.approx(84.4, abs=0.1)


def test_units():
    np.testing.assert_allclose(DPH_TO_RADPS, 4.8481e-6, rtol=1e-5)
    np.testing.assert_allclose(DPH_TO_RADPS * RADPS_TO_DPH, 1.0)
    np.testing.assert_allclose(DEG_PER_SQRT_H_TO_SI * 60.0, np.deg2rad(1.0))
    np.testing.assert_allclose(UG_PER_SQRT_HZ_TO_SI, 9.80665e-6)
