from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.paper import estimate_paper
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, RADPS_TO_DPH
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.attitude import euler_rpy321
from gyrobench.bench.navigation.earth import gravity
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.navigation.euler_sequences import euler_pry231

GRAVITY = gravity(np.deg2rad(36.4))
NOISE = NoiseModel.from_datasheet(arw_deg_per_sqrt_h=0.001)
BIAS_DPH = (0.010, -0.006, 0.004)
UG = 9.80665e-6


def literal_slopes(dwell):
    """V_E'', V_N'' and phi_U' at 0 and at T, heading from the Euler sequence that the paper takes."""
    sequence = euler_pry231 if dwell.position_name.startswith("y") else euler_rpy321
    slopes = {}
    for moment, window in zip("0T", dwell.windows, strict=True):
        time = window.time_s - window.time_s.mean()
        slopes["VE" + moment] = 2.0 * np.polyfit(time, window.velocity_enu_mps[:, 0], 2)[0]
        slopes["VN" + moment] = 2.0 * np.polyfit(time, window.velocity_enu_mps[:, 1], 2)[0]
        slopes["phi" + moment] = -np.polyfit(time, np.unwrap(sequence(window.C_nb)[:, 2]), 1)[0]
    return slopes


def equation_10(s, g):
    return (s["VNT"] - s["VN0"]) / (2 * g), (s["VET"] - s["VE0"]) / (-2 * g), (s["phiT"] + s["phi0"]) / -2


def equation_12(s, g):
    return (s["VNT"] - s["VN0"]) / (-2 * g), (s["VET"] - s["VE0"]) / (-2 * g), (s["phiT"] + s["phi0"]) / 2


def equation_13(s, g):
    return (s["VNT"] - s["VN0"]) / (2 * g), (s["phiT"] + s["phi0"]) / -2, (s["VET"] - s["VE0"]) / (2 * g)


def equation_14(s, g):
    return (s["VNT"] - s["VN0"]) / (2 * g), (s["phiT"] + s["phi0"]) / 2, (s["VET"] - s["VE0"]) / (-2 * g)


def equation_15(s, g):
    return (s["phiT"] + s["phi0"]) / -2, (s["VNT"] - s["VN0"]) / (2 * g), (s["VET"] - s["VE0"]) / (-2 * g)


def equation_16(s, g):
    return (s["phiT"] + s["phi0"]) / 2, (s["VNT"] - s["VN0"]) / (-2 * g), (s["VET"] - s["VE0"]) / (-2 * g)


EQUATIONS = {
    "z_up": equation_10,
    "z_down": equation_12,
    "y_up": equation_13,
    "y_down": equation_14,
    "x_up": equation_15,
    "x_down": equation_16,
}


@pytest.mark.parametrize("position", POSITIONS)
def test_one_rule_gives_the_equation_of_each_position(dwell_of, position):
    dwell = dwell_of(position=position, gyro_bias_dph=BIAS_DPH)
    written_out = np.array(EQUATIONS[position](literal_slopes(dwell), GRAVITY)) * RADPS_TO_DPH
    difference = np.abs(estimate_paper(dwell, GRAVITY, NOISE).bias_dph - written_out)
    vertical = POSITIONS[position].up_axis
    assert np.delete(difference, vertical).max() < 1e-9
    # An Euler yaw and the Up component of the rotation vector differ by the product of two tilts.
    assert difference[vertical] < 5e-7


@pytest.mark.parametrize("position", POSITIONS)
def test_recovers_the_bias_up_to_the_known_leaks_of_the_method(dwell_of, position):
    dwell = dwell_of(position=position, gyro_bias_dph=BIAS_DPH)
    error = estimate_paper(dwell, GRAVITY, NOISE).bias_dph - BIAS_DPH
    assert np.abs(error).max() < 0.2 * max(np.abs(BIAS_DPH))


@pytest.mark.parametrize(
    ("sensors", "expected_mdph", "digit"),
    [
        ({"gyro_bias_dph": (0.010, 0.0, 0.0)}, (-0.8, -0.3, -0.2), 0.1),
        ({"gyro_bias_dph": (0.0, 0.010, 0.0)}, (0.1, 1.7, -1.8), 0.1),
        ({"gyro_bias_dph": (0.050, 0.050, 0.050)}, (-3.0, 7.0, -10.3), 0.15),
        ({"accelerometer_bias_mps2": (50 * UG, 0.0, 0.0)}, (0.7, -4.8, 3.5), 0.1),
        ({"accelerometer_bias_mps2": (0.0, 50 * UG, 0.0)}, (4.8, 0.6, 0.8), 0.1),
    ],
)
def test_leaks_of_the_method_are_those_measured_with_another_mechanisation(
    dwell_of, sensors, expected_mdph, digit
):
    bias = sensors.get("gyro_bias_dph", (0.0, 0.0, 0.0))
    error = estimate_paper(dwell_of(**sensors), GRAVITY, NOISE).bias_dph - bias
    np.testing.assert_allclose(1e3 * error, expected_mdph, rtol=0, atol=digit)


def test_perfect_sensors_give_no_bias(dwell_of):
    assert np.abs(estimate_paper(dwell_of(), GRAVITY, NOISE).bias_dph).max() < 2e-6


def test_a_turn_the_other_way_gives_the_same_bias(dwell_of):
    there, back = (
        estimate_paper(dwell_of(gyro_bias_dph=BIAS_DPH, turn_deg=turn), GRAVITY, NOISE)
        for turn in (180.0, -180.0)
    )
    np.testing.assert_allclose(there.bias_dph, back.bias_dph, rtol=0, atol=2e-4)


@pytest.mark.parametrize("turn_deg", [90.0, 178.5, -181.5])
def test_refuses_a_turn_that_is_not_half_a_turn(dwell_of, turn_deg):
    with pytest.raises(MeasurementError, match=r"needs a turn of 180 deg.*(1\.5|90\.0) deg away"):
        estimate_paper(dwell_of(turn_deg=turn_deg, window_s=60.0, step_s=1.0), GRAVITY, NOISE)


def test_level_and_vertical_gyros_have_their_own_uncertainty_in_each_position(dwell_of):
    for name, position in POSITIONS.items():
        sigma = estimate_paper(dwell_of(position=name, gyro_bias_dph=BIAS_DPH), GRAVITY, NOISE).sigma_dph
        expected = np.full(3, 0.0024)
        expected[position.up_axis] = 0.0019
        np.testing.assert_allclose(sigma, expected, rtol=0.02)


def test_refuses_a_dwell_of_other_than_two_windows(dwell_of):
    dwell = dwell_of(window_s=60.0, step_s=1.0)
    one = replace(dwell, windows=dwell.windows[:1], C_nb_table=dwell.C_nb_table[:1], turns=())
    with pytest.raises(MeasurementError, match="1 windows of navigation; the paper's method takes two"):
        estimate_paper(one, GRAVITY, NOISE)


def test_an_estimate_is_in_radians_per_second_and_degrees_per_hour(dwell_of):
    estimate = estimate_paper(dwell_of(gyro_bias_dph=BIAS_DPH), GRAVITY, NOISE)
    assert estimate.bias_radps[0] == pytest.approx(estimate.bias_dph[0] * DPH_TO_RADPS)
