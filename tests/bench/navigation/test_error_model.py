import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.earth import earth_rate_enu
from gyrobench.bench.navigation.error_model import Site, dynamics, integrate
from gyrobench.drivers.emulators.world.sensor_errors import sense
from gyrobench.drivers.emulators.world.strapdown import matrix_of, navigate, true_increments

EAST, UP = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
HEIGHT, STEP_S, DURATION_S = 150.0, 0.1, 600.0
COUNT = round(DURATION_S / STEP_S)
#: Attitude error, velocity error, latitude error; gyro and accelerometer error.
STATE_SIZES = np.array([1e-6, 1e-6, 1e-6, 1e-4, 1e-4, 1e-5])
INPUT_SIZES = np.array([1e-9, 1e-9, 1e-9, 1e-6, 1e-6])
NO_ERROR = np.zeros(6)
LATITUDES_DEG = [-60.0, -20.0, 0.0, 36.4, 75.0]


def site(latitude_deg=36.4):
    return Site(np.radians(latitude_deg), HEIGHT)


def final_error(latitude_deg, error=NO_ERROR, inputs=NO_ERROR[:5], count=COUNT):
    """Error state (6,) of the strapdown INS that starts with ``error`` and has sensor errors ``inputs``."""
    latitude, still = np.radians(latitude_deg), np.zeros(count + 1)
    rotation, velocity = true_increments(EAST, UP, np.eye(3), still, still, latitude, HEIGHT, STEP_S)
    none = np.zeros((count, 3)), 0.0, np.zeros(3)
    rotation = sense(rotation, np.zeros((3, 3)), inputs[:3], none[0], STEP_S, *none[1:])
    velocity = sense(velocity, np.zeros((3, 3)), np.append(inputs[3:], 0.0), none[0], STEP_S, *none[1:])
    state = np.zeros(8)
    state[:4] = Rotation.from_rotvec(-error[:3]).as_quat(scalar_first=True)
    state[4:6], state[6] = error[3:5], latitude + error[5]
    navigate(state, rotation, velocity, STEP_S, HEIGHT, count, 1)
    phi = -Rotation.from_matrix(matrix_of(state[:4])).as_rotvec()
    return np.concatenate([phi, state[4:6], [state[6] - latitude]])


def relative_difference(model, ins, sizes):
    """Largest difference of any component over the largest size that it takes for any cause, (6,)."""
    return (np.abs(model - ins) * sizes).max(axis=1) / (np.abs(ins) * sizes).max(axis=1)


@pytest.mark.parametrize("latitude_deg", LATITUDES_DEG)
def test_initial_errors_develop_as_in_the_strapdown_ins(latitude_deg):
    nominal = final_error(latitude_deg)
    ins = [
        (final_error(latitude_deg, size * unit) - nominal) / size
        for size, unit in zip(STATE_SIZES, np.eye(6), strict=True)
    ]
    model = integrate(site(latitude_deg), np.array([DURATION_S]), 0.0, 0.0).transition[0]
    assert relative_difference(model, np.array(ins).T, STATE_SIZES).max() < 1e-3


@pytest.mark.parametrize("latitude_deg", LATITUDES_DEG)
def test_sensor_errors_act_as_in_the_strapdown_ins(latitude_deg):
    nominal = final_error(latitude_deg)
    ins = [
        (final_error(latitude_deg, inputs=size * unit) - nominal) / size
        for size, unit in zip(INPUT_SIZES, np.eye(5), strict=True)
    ]
    model = integrate(site(latitude_deg), np.array([DURATION_S]), 0.0, 0.0).response[0]
    assert relative_difference(model, np.array(ins).T, INPUT_SIZES).max() < 1e-3


def test_the_loop_oscillates_with_the_schuler_period():
    """The Earth's rotation splits it in two about its middle, as it turns a Foucault pendulum."""
    frequencies = np.sort(np.abs(np.linalg.eigvals(dynamics(site())).imag))[-4:]
    assert 2.0 * np.pi / frequencies.mean() / 60.0 == pytest.approx(84.4, abs=0.2)
    _, _, rate_up = earth_rate_enu(site().latitude)
    assert 0.5 * (frequencies[-1] - frequencies[0]) == pytest.approx(rate_up, rel=0.02)


def test_a_gyrocompassed_ins_has_no_tilt_rate_and_no_acceleration():
    """Tilts of accelerometer bias over gravity and a heading that lets the East gyro's error rest."""
    acceleration, gyro_east = np.array([3e-4, -5e-4]), 2e-8
    _, rate_north, rate_up = earth_rate_enu(site().latitude)
    east, north = -acceleration[1] / site().gravity, acceleration[0] / site().gravity
    up = (north * rate_up - gyro_east) / rate_north
    derivative = dynamics(site()) @ np.array([east, north, up, 0.0, 0.0, 0.0])
    derivative[0] -= gyro_east
    derivative[3:5] += acceleration
    np.testing.assert_allclose(derivative[[0, 3, 4, 5]], 0.0, atol=1e-20)


@pytest.mark.parametrize("duration_s", [1.0, 300.0, 900.0])
def test_two_times_one_after_the_other_are_one_time(duration_s):
    first, second, whole = (
        integrate(site(), np.array([share * duration_s]), 1e-7, 5e-5) for share in (0.3, 0.7, 1.0)
    )
    F = second.transition[0]
    together = (
        F @ first.transition[0],
        F @ first.response[0] + second.response[0],
        F @ first.covariance[0] @ F.T + second.covariance[0],
    )
    for joined, direct in zip(together, (whole.transition, whole.response, whole.covariance), strict=True):
        scale = np.abs(direct[0]).max(axis=1, keepdims=True)
        np.testing.assert_allclose(joined / scale, direct[0] / scale, rtol=0, atol=1e-7)


def test_no_time_changes_nothing():
    nothing = integrate(site(), np.array([0.0]), 1e-7, 5e-5)
    np.testing.assert_array_equal(nothing.transition[0], np.eye(6))
    assert not nothing.response.any()
    assert not nothing.covariance.any()


def test_covariance_is_that_of_the_strapdown_ins_with_noisy_sensors():
    """A unit of noise of one sensor at one moment, sent through the INS; summed over the moments."""
    walks, pieces = np.array([3e-7] * 3 + [5e-5] * 2), 30
    spread = np.zeros((6, 6))
    for k in range(pieces):
        count = round(COUNT * (k + 0.5) / pieces)
        nominal = final_error(36.4, count=count)
        for axis, walk in enumerate(walks):
            size = STATE_SIZES[axis]
            change = (final_error(36.4, size * np.eye(6)[axis], count=count) - nominal) * walk / size
            spread += np.outer(change, change) * DURATION_S / pieces
    covariance = integrate(site(), np.array([DURATION_S]), walks[0], walks[3]).covariance[0]
    scale = np.outer(*(np.sqrt(np.diag(covariance)),) * 2)
    np.testing.assert_allclose(covariance / scale, spread / scale, rtol=0, atol=2e-3)


def test_each_time_is_integrated_by_itself():
    durations = np.array([0.1, 1.0, 25.0])
    together = integrate(site(), durations, 1e-7, 5e-5)
    for k, duration in enumerate(durations):
        alone = integrate(site(), np.array([duration]), 1e-7, 5e-5)
        np.testing.assert_allclose(together.covariance[k], alone.covariance[0], rtol=1e-12)


@pytest.mark.parametrize("latitude_deg", [85.1, -90.0, 91.0, np.nan, np.inf])
def test_refuses_a_site_where_gyrocompassing_has_no_answer(latitude_deg):
    with pytest.raises(MeasurementError, match="gyrocompassing fails"):
        Site(np.radians(latitude_deg))


def test_a_site_knows_its_gravity():
    assert Site(np.radians(45.0)).gravity == pytest.approx(9.80619, abs=2e-5)
    assert Site(0.0, 1000.0).gravity == pytest.approx(9.78033 - 3.086e-3, abs=2e-5)
