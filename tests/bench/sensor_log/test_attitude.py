import numpy as np
import pytest

from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.sensor_log.attitude import earth_rate_dph, nearest_position
from gyrobench.bench.sensor_log.document import EarthRate


@pytest.mark.parametrize("name", POSITIONS)
def test_the_force_at_rest_tells_the_position_and_the_tilt(name):
    up = POSITIONS[name].C_nb()[2]
    beside = np.roll(up, 1)
    tilt = np.deg2rad(5.0)
    found, tilt_deg = nearest_position(9.8 * (np.cos(tilt) * up + np.sin(tilt) * beside))
    assert found == name
    assert tilt_deg == pytest.approx(5.0)


def test_no_force_is_near_no_position():
    assert np.isnan(nearest_position(np.zeros(3))[1])
    assert np.isnan(nearest_position(np.full(3, np.nan))[1])


@pytest.mark.parametrize("name", POSITIONS)
def test_the_earth_rate_in_the_body_turns_with_the_azimuth_about_the_vertical(name):
    axis, sign = POSITIONS[name].up_axis, POSITIONS[name].up_sign
    at_zero, turned, unknown = (
        earth_rate_dph(name, EarthRate(latitude_deg=45.0, azimuth_deg=azimuth))
        for azimuth in (0.0, 180.0, None)
    )
    vertical = sign * 15.041067 * np.sqrt(0.5) * np.eye(3)[axis]
    np.testing.assert_allclose(0.5 * (at_zero + turned), vertical, atol=1e-5)
    np.testing.assert_allclose(unknown, vertical, atol=1e-5)
    assert np.linalg.norm(at_zero) == pytest.approx(15.041067, abs=1e-5)
