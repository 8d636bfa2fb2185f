"""Parameters of a dwell and prior knowledge of them."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from gyrobench.bench.bias import parameters
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.foundations.arrays import DPH_TO_RADPS, STANDARD_GRAVITY
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.earth import earth_rate_enu
from gyrobench.bench.navigation.positions import POSITIONS

LATITUDE = np.radians(36.4)
EARTH = earth_rate_enu(LATITUDE)
TWO_WINDOWS = parameters.COMMON_COUNT + 2 * parameters.PER_WINDOW


def covariance(prior, windows=2):
    root = parameters.prior_root(prior, windows, EARTH)
    return root @ root.T


def nothing(**sizes):
    """Prior knowledge that nothing acts but what is named."""
    return PriorKnowledge(**dict.fromkeys(PriorKnowledge.__dataclass_fields__, 0.0) | sizes)


@pytest.mark.parametrize("position", POSITIONS)
def test_inputs_are_the_sensors_errors_in_the_navigation_frame(position):
    """The paper's (1) and (2): a matrix times what is felt, plus a bias."""
    random = np.random.default_rng(4)
    C_nb = POSITIONS[position].C_nb(0.7)
    values = random.standard_normal(TWO_WINDOWS)
    values[parameters.ACCELEROMETER_DRIFT] = 0.0
    gyro_bias, accelerometer_bias = values[parameters.GYRO_BIAS], values[parameters.ACCELEROMETER_BIAS]
    matrix, rate_body = values[parameters.GYRO_MATRIX].reshape(3, 3), random.standard_normal(3)
    gyros = C_nb @ (gyro_bias + matrix @ rate_body)
    gyros[1:] += values[parameters.NAVIGATION_RATE]
    expected = np.concatenate([gyros, (C_nb @ accelerometer_bias)[:2]])
    given = parameters.inputs(C_nb, rate_body, TWO_WINDOWS) @ values
    np.testing.assert_allclose(given, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("position", POSITIONS)
def test_a_drift_of_the_accelerometers_acts_as_the_bias_of_the_level_gyro_across_it(position):
    """V_E'' = drift_E + g b_N and V_N'' = drift_N - g b_E: one cancels the other."""
    C_nb = POSITIONS[position].C_nb(0.7)
    drift = np.array([1e-6, -2e-6, 3e-6])
    east, north, _ = C_nb @ drift / STANDARD_GRAVITY
    values = np.zeros(TWO_WINDOWS)
    values[parameters.ACCELEROMETER_DRIFT] = drift
    values[parameters.GYRO_BIAS] = C_nb.T @ [north, -east, 0.0]
    np.testing.assert_allclose(parameters.inputs(C_nb, np.zeros(3), TWO_WINDOWS) @ values, 0.0, atol=1e-20)


def test_a_window_acts_at_its_start_alone():
    inputs = parameters.inputs(np.eye(3), np.ones(3), TWO_WINDOWS)
    assert not inputs[:, parameters.COMMON_COUNT :].any()
    assert not inputs[:, parameters.GYRO_SLOPE].any()
    assert not inputs[:, parameters.ACCELEROMETER_SLOPE].any()


def test_every_unknown_has_its_own_place():
    places = [
        np.arange(TWO_WINDOWS)[part]
        for part in (
            parameters.GYRO_BIAS,
            parameters.GYRO_SLOPE,
            parameters.ACCELEROMETER_BIAS,
            parameters.NAVIGATION_RATE,
            parameters.GYRO_MATRIX,
            parameters.ACCELEROMETER_DRIFT,
            parameters.ACCELEROMETER_SLOPE,
            slice(parameters.DAMPING, parameters.DAMPING + 1),
        )
    ]
    assert np.concatenate(places).tolist() == list(range(parameters.COMMON_COUNT))
    own = [
        [parameters.HEADING],
        *(
            np.arange(parameters.PER_WINDOW)[p]
            for p in (parameters.VELOCITY, parameters.ATTITUDE, parameters.TRANSIENT)
        ),
    ]
    assert np.concatenate(own).tolist() == list(range(parameters.PER_WINDOW))


def test_sizes_of_prior_knowledge_are_standard_deviations_of_the_parameters():
    prior = PriorKnowledge(2e-3, 3e-6, 4e-5, 5e-6, 0.0, 6e-9)
    sigmas = np.sqrt(np.diag(covariance(prior)))
    np.testing.assert_allclose(sigmas[parameters.ACCELEROMETER_BIAS], 2e-3)
    np.testing.assert_allclose(sigmas[parameters.GYRO_SLOPE], 6e-9)
    matrix = sigmas[parameters.GYRO_MATRIX].reshape(3, 3)
    np.testing.assert_allclose(np.diag(matrix), 3e-6)
    np.testing.assert_allclose(matrix[~np.eye(3, dtype=bool)], 4e-5)


def test_the_sensors_may_tilt_in_a_turn_but_the_first_attitude_is_free():
    sigmas = np.sqrt(np.diag(covariance(nothing(tilt_step=5e-6), windows=3)))
    own = sigmas[parameters.COMMON_COUNT :].reshape(3, parameters.PER_WINDOW)
    np.testing.assert_allclose(own[1:, parameters.ATTITUDE], 5e-6)
    assert own[0, parameters.ATTITUDE].min() > np.radians(5.0)


def test_accelerometers_settle_after_turns_alone():
    sigmas = np.sqrt(np.diag(covariance(nothing(accelerometer_transient=2e-4), windows=3)))
    np.testing.assert_allclose(sigmas[parameters.transients(3)], 2e-4)
    first = sigmas[parameters.COMMON_COUNT :][: parameters.PER_WINDOW]
    assert not first[parameters.TRANSIENT].any()


def test_what_the_data_decide_is_free():
    sigmas = np.sqrt(np.diag(covariance(nothing(), windows=4)))
    assert sigmas[parameters.GYRO_BIAS].min() > 1000.0 * DPH_TO_RADPS
    own = sigmas[parameters.COMMON_COUNT :].reshape(4, parameters.PER_WINDOW)
    assert own[:, parameters.VELOCITY].min() > 1.0
    assert own[:, parameters.HEADING].min() > np.radians(5.0)


def test_a_wrong_latitude_is_one_cause_of_the_rates_north_and_up():
    """The INS takes away the Earth rate of the wrong latitude: what is left is fixed to the Earth."""
    size = 1e-5
    spread = covariance(nothing(latitude=size))[parameters.NAVIGATION_RATE, parameters.NAVIGATION_RATE]
    left = (earth_rate_enu(LATITUDE) - earth_rate_enu(LATITUDE + size))[1:]
    np.testing.assert_allclose(spread, np.outer(left, left), rtol=1e-4)


def test_causes_are_independent_of_one_another_otherwise():
    spread = covariance(PriorKnowledge())
    spread[parameters.NAVIGATION_RATE, parameters.NAVIGATION_RATE] = 0.0
    assert not (spread - np.diag(np.diag(spread))).any()


def test_units_of_data_sheets():
    prior = PriorKnowledge.from_datasheet(100.0, 10.0, 3600.0, 7200.0, 60.0, 3600.0)
    assert prior.accelerometer_bias == pytest.approx(9.80665e-4)
    assert prior.gyro_scale_factor == pytest.approx(1e-5)
    assert prior.gyro_misalignment == pytest.approx(np.deg2rad(1.0))
    assert prior.tilt_step == pytest.approx(np.deg2rad(2.0))
    assert prior.latitude == pytest.approx(np.deg2rad(1.0))
    assert prior.bias_slope == pytest.approx(np.deg2rad(1.0))


def test_defaults_are_the_same_in_both_units():
    plain, datasheet = PriorKnowledge(), PriorKnowledge.from_datasheet()
    for field in fields(PriorKnowledge):
        assert getattr(plain, field.name) == pytest.approx(getattr(datasheet, field.name), rel=1e-12)


def test_accelerometer_biases_are_left_to_the_data():
    assert PriorKnowledge().accelerometer_bias > 5.0 * 100.0 * 9.80665e-6


@pytest.mark.parametrize("name", [field.name for field in fields(PriorKnowledge)])
@pytest.mark.parametrize("value", [-1e-9, np.nan, np.inf])
def test_refuses_a_size_out_of_range(name, value):
    with pytest.raises(DocumentError, match=f"prior knowledge: {name} must not be negative; found"):
        PriorKnowledge(**{name: value})


def test_a_size_may_be_zero():
    assert PriorKnowledge(tilt_step=0.0).tilt_step == 0.0
