"""The body frame of the accelerometers, and the error model in it."""

import numpy as np
import pytest

from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT, CoefficientEstimate, SensorErrors


@pytest.fixture
def errors():
    random = np.random.default_rng(5)
    return SensorErrors(
        random.normal(0.0, 1e-7, 3),
        random.normal(0.0, 3e-3, (3, 3)),
        random.normal(0.0, 1e-3, 3),
        random.normal(0.0, 3e-3, (3, 3)),
    )


def measured(errors, rate, force):
    return (
        rate + errors.gyro_matrix @ rate + errors.gyro_bias,
        force + errors.force_matrix @ force + errors.force_bias,
    )


def test_21_coefficients_are_independent_and_have_different_names():
    assert COUNT == 21
    assert len({(each.name, each.axis) for each in COEFFICIENTS}) == 21


def test_the_same_sensors_measure_the_same_in_both_body_frames(errors):
    rate, force = np.array([0.1, -0.2, 0.3]), np.array([1.0, -2.0, 9.0])
    turned, rotation = errors.in_accelerometer_frame()
    np.testing.assert_allclose(
        measured(turned, rotation @ rate, rotation @ force), measured(errors, rate, force), atol=1e-13
    )
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) > 0.0


def test_body_x_is_the_input_axis_of_the_x_accelerometer_and_that_of_y_lies_in_the_plane(errors):
    turned, _ = errors.in_accelerometer_frame()
    assert np.abs(turned.force_matrix[np.triu_indices(3, 1)]).max() < 1e-15
    np.testing.assert_allclose(
        SensorErrors.from_vector(errors.vector()).force_matrix, turned.force_matrix, atol=1e-15
    )


def test_errors_are_removed_from_increments(errors):
    random, interval_s = np.random.default_rng(6), 0.01
    rates, forces = random.normal(0.0, 1.0, (2, 50, 3))
    sensed = [measured(errors, *pair) for pair in zip(rates, forces, strict=True)]
    angle, velocity = (np.array(each) * interval_s for each in zip(*sensed, strict=True))
    corrected = errors.corrected(angle, velocity, interval_s)
    np.testing.assert_allclose(corrected, [rates * interval_s, forces * interval_s], atol=1e-16)


def test_an_estimate_in_the_gyros_frame_has_the_covariance_of_converted_values(errors):
    random = np.random.default_rng(8)
    root = 1e-6 * random.normal(0.0, 1.0, (21, 21))
    estimate = CoefficientEstimate(errors.vector(), root @ root.T, np.full(21, True))
    converted = estimate.in_gyro_frame()
    there, _ = errors.in_gyro_frame()
    assert np.abs(there.gyro_matrix[np.triu_indices(3, 1)]).max() < 1e-15
    names = [(each.name, each.axis) for each in converted.coefficients]
    np.testing.assert_allclose(
        converted.values[names.index(("accelerometer_misalignment", "xy"))], there.force_matrix[0, 1]
    )
    drawn = []
    for each in errors.vector() + random.normal(0.0, 1.0, (400, 21)) @ root.T:
        there, _ = SensorErrors.from_vector(each).in_gyro_frame()
        gyros = [there.gyro_bias, there.gyro_matrix[np.tril_indices(3)]]
        drawn.append(np.concatenate([*gyros, there.force_bias, there.force_matrix.ravel()]))
    np.testing.assert_allclose(np.std(drawn, axis=0), converted.sigmas, rtol=0.15)


def test_what_rests_on_coefficients_not_observed_is_not_observed_in_the_gyros_frame(errors):
    is_observed = np.array([each.sensor == "accelerometer" for each in COEFFICIENTS])
    converted = CoefficientEstimate(errors.vector(), 1e-12 * np.eye(21), is_observed).in_gyro_frame()
    seen = {
        each.name
        for each, is_seen in zip(converted.coefficients, converted.is_observed, strict=True)
        if is_seen
    }
    assert seen == {"accelerometer_bias", "accelerometer_scale_factor"}
