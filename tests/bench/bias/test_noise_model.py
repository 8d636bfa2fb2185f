import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.paper import PolynomialTrend
from gyrobench.bench.foundations.arrays import RADPS_TO_DPH
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.earth import MEAN_RADIUS, earth_rate_enu, gravity

LATITUDE = np.deg2rad(36.4)
GRAVITY = gravity(LATITUDE)
TRIALS = 2000

# Time of 600 s at 1 Hz, twice, with a turn of 20 s between.
TIME = np.arange(1221.0)
BEFORE, AFTER = slice(0, 601), slice(620, 1221)


def error_dynamics(schuler, earth):
    """Rates of (phi_E, phi_N, phi_U, dV_E, dV_N) of an INS at rest with fixed altitude."""
    _, north, up = earth_rate_enu(LATITUDE) * earth
    curvature = schuler / MEAN_RADIUS
    return np.array(
        [
            [0.0, up, -north, 0.0, -curvature],
            [-up, 0.0, 0.0, curvature, 0.0],
            [north, 0.0, 0.0, np.tan(LATITUDE) * curvature * earth, 0.0],
            [0.0, -GRAVITY, 0.0, 0.0, 0.0],
            [GRAVITY, 0.0, 0.0, 0.0, 0.0],
        ]
    )


def simulated_outputs(noise, schuler=1.0, earth=0.0, seed=1, trials=TRIALS):
    """Velocity East, velocity North and rotation about Up, each (1221, trials), of pure noise."""
    rng = np.random.default_rng(seed)
    dynamics = error_dynamics(schuler, earth)
    step, half_step = expm(dynamics), expm(0.5 * dynamics)
    sigma = np.array([noise.angle_random_walk] * 3 + [noise.velocity_random_walk] * 2)[:, np.newaxis]
    states = np.zeros((len(TIME), 5, trials))
    for k in range(1, len(TIME)):
        states[k] = step @ states[k - 1] + half_step @ (sigma * rng.normal(size=(5, trials)))
    white = rng.normal(size=(3, len(TIME), trials))
    return (
        states[:, 3] + noise.velocity_white * white[0],
        states[:, 4] + noise.velocity_white * white[1],
        -states[:, 2] + noise.heading_white * white[2],
    )


def pair_weights():
    quadratic, linear = PolynomialTrend(TIME[BEFORE], 2), PolynomialTrend(TIME[BEFORE], 1)
    level = np.concatenate([-quadratic.weights, quadratic.weights]) / (2.0 * GRAVITY)
    return level, np.concatenate([linear.weights, linear.weights]) / 2.0


def both(values):
    return np.concatenate([values[BEFORE], values[AFTER]])


@pytest.fixture(scope="module")
def gyro_noise():
    return NoiseModel.from_datasheet(arw_deg_per_sqrt_h=0.001)


NOISES = {
    "gyro": NoiseModel.from_datasheet(arw_deg_per_sqrt_h=0.001),
    "accelerometer": NoiseModel.from_datasheet(arw_deg_per_sqrt_h=1e-7, vrw_ug_per_sqrt_hz=30.0),
    "output": NoiseModel(angle_random_walk=1e-12, velocity_white=1e-3, heading_white=2e-6),
    "all": NoiseModel.from_datasheet(0.001, 100.0, velocity_lsb_mps=0.01, heading_lsb_rad=2e-5),
}


@pytest.mark.long
@pytest.mark.parametrize("name", NOISES)
def test_variance_of_slopes_is_that_of_simulated_noise(name):
    noise = NOISES[name]
    east, north, heading = simulated_outputs(noise)
    level, vertical = pair_weights()
    time = both(TIME)
    predicted_level = np.sqrt(noise.velocity_variance(time, level, GRAVITY))
    predicted_vertical = np.sqrt(noise.heading_variance(time, vertical))
    # Standard deviations of 2000 trials scatter by 1.6 %.
    for velocity in (east, north):
        assert (level @ both(velocity)).std() == pytest.approx(predicted_level, rel=0.06)
    assert (vertical @ both(heading)).std() == pytest.approx(predicted_vertical, rel=0.06)


@pytest.mark.parametrize("trials", [800, pytest.param(TRIALS, marks=pytest.mark.long)])
def test_earth_rate_coupling_changes_the_standard_deviation_little(gyro_noise, trials):
    level, vertical = pair_weights()
    east, north, heading = simulated_outputs(gyro_noise, earth=1.0, trials=trials)
    predicted_level = np.sqrt(gyro_noise.velocity_variance(both(TIME), level, GRAVITY))
    predicted_vertical = np.sqrt(gyro_noise.heading_variance(both(TIME), vertical))
    for velocity in (east, north):
        assert (level @ both(velocity)).std() == pytest.approx(predicted_level, rel=0.08)
    assert (vertical @ both(heading)).std() == pytest.approx(predicted_vertical, rel=0.08)


@pytest.mark.parametrize(
    ("arw", "level_dph", "vertical_dph"), [(0.001, 0.0025, 0.0019), (0.003, 0.0075, 0.0058)]
)
def test_uncertainty_of_a_pair_is_that_measured_with_another_mechanisation(arw, level_dph, vertical_dph):
    noise = NoiseModel.from_datasheet(arw)
    level, vertical = pair_weights()
    sigma_level = np.sqrt(noise.velocity_variance(both(TIME), level, GRAVITY)) * RADPS_TO_DPH
    sigma_vertical = np.sqrt(noise.heading_variance(both(TIME), vertical)) * RADPS_TO_DPH
    assert sigma_level == pytest.approx(level_dph, rel=0.05)
    assert sigma_vertical == pytest.approx(vertical_dph, rel=0.03)


def test_slope_of_a_random_walk_has_its_textbook_variance(gyro_noise):
    time = np.linspace(0.0, 600.0, 6001)
    variance = gyro_noise.heading_variance(time, PolynomialTrend(time, 1).weights)
    assert variance == pytest.approx(6.0 / 5.0 * gyro_noise.angle_random_walk**2 / 600.0, rel=1e-3)


def test_second_slope_of_an_integrated_random_walk_has_its_textbook_variance(gyro_noise):
    time = np.linspace(0.0, 60.0, 6001)  # short against the Schuler period
    variance = gyro_noise.velocity_variance(time, PolynomialTrend(time, 2).weights / GRAVITY, GRAVITY)
    assert variance == pytest.approx(10.0 / 7.0 * gyro_noise.angle_random_walk**2 / 60.0, rel=1e-2)


def test_variance_of_several_sums_is_that_of_each(gyro_noise):
    weights = np.random.default_rng(3).normal(size=(len(TIME), 2))
    together = gyro_noise.velocity_variance(TIME, weights, GRAVITY)
    alone = [float(gyro_noise.velocity_variance(TIME, column, GRAVITY)) for column in weights.T]
    np.testing.assert_allclose(together, alone, rtol=1e-12)


@given(
    st.lists(st.floats(0.01, 30.0), min_size=30, max_size=60), st.floats(1e-5, 1e-1), st.floats(0.0, 200.0)
)
def test_variances_are_positive_on_uneven_epochs(intervals, arw, vrw):
    noise = NoiseModel.from_datasheet(arw, vrw)
    time = np.concatenate([[0.0], np.cumsum(intervals)])
    assert noise.velocity_variance(time, PolynomialTrend(time, 2).weights, GRAVITY) > 0.0
    assert noise.heading_variance(time, PolynomialTrend(time, 1).weights) > 0.0


def test_units_of_data_sheets():
    noise = NoiseModel.from_datasheet(0.6, 100.0, velocity_lsb_mps=0.012, heading_lsb_rad=12e-6)
    assert noise.angle_random_walk == pytest.approx(np.deg2rad(0.01))
    assert noise.velocity_random_walk == pytest.approx(9.80665e-4)
    assert noise.velocity_white == pytest.approx(0.012 / 12**0.5)
    assert noise.heading_white == pytest.approx(12e-6 / 12**0.5)


@pytest.mark.parametrize(
    "wrong", [{"angle_random_walk": 0.0}, {"angle_random_walk": 1e-7, "heading_white": -1.0}]
)
def test_refuses_noise_out_of_range(wrong):
    with pytest.raises(DocumentError, match="noise of the INS"):
        NoiseModel(**wrong)
