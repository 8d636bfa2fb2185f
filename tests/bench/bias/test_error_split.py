from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from gyrobench.bench.bias.bias_filter import estimate_state_space
from gyrobench.bench.bias.parameters import ErrorModel, PriorKnowledge
from tests.bench.bias.emulated_dwells import emulate, noise_model, sensors, site

NOISE, PRIOR = noise_model(0.0006), PriorKnowledge()
KNOWN = replace(PRIOR, accelerometer_bias=1e-4)


@cache
def dwell(position="z_up", **scenario):
    return emulate(
        position, sensors((0.05, -0.05, 0.05)), gyro_c=warming, outer_level=True, window_s=300.0, **scenario
    )


def warming(time_s):
    return 20.0 + np.outer(time_s, [1.0, 1.2, 0.8]) / 600.0


def estimate(measured, noise=NOISE, prior=PRIOR):
    return estimate_state_space(measured, ErrorModel(site(), noise, prior))


def covariance_of(part):
    return part.columns @ part.columns.T


@pytest.mark.parametrize(
    ("position", "stops_deg"),
    [("z_up", (0.0, 180.0)), ("x_down", (0.0, 180.0)), ("y_down", (0.0, 180.0, 0.0, 180.0))],
)
def test_the_parts_add_up_to_the_covariance(position, stops_deg):
    found = estimate(dwell(position, stops_deg=stops_deg))
    total = sum(map(covariance_of, found.parts.values()))
    assert total == pytest.approx(found.covariance, rel=1e-9, abs=1e-24)


@cache
def with_known_accelerometers():
    return estimate(dwell("y_down"), prior=KNOWN)


@pytest.mark.parametrize(
    ("part", "names"),
    [
        ("angle_random_walk", ["angle_random_walk"]),
        ("velocity_random_walk", ["velocity_random_walk"]),
        ("velocity_output", ["velocity_white"]),
        ("heading_output", ["heading_white"]),
        ("accelerometer_bias", ["accelerometer_bias"]),
        ("accelerometer_drift", ["accelerometer_drift"]),
        ("accelerometer_slope", ["accelerometer_slope"]),
        ("gyro_scale_factor", ["gyro_scale_factor"]),
        ("gyro_misalignment", ["gyro_misalignment"]),
        ("tilt_step", ["tilt_step"]),
        ("latitude", ["latitude"]),
        ("bias_slope", ["bias_slope"]),
    ],
)
def test_a_part_is_what_the_least_covariance_grows_by_with_its_variance(part, names):
    """At the gains of least covariance, those do not change it: its derivative is that at fixed gains."""
    measured, step = dwell("y_down"), 1e-2

    def covariance(factor):
        noise, known = (
            replace(
                each, **{name: getattr(each, name) * factor**0.5 for name in names if hasattr(each, name)}
            )
            for each in (NOISE, KNOWN)
        )
        return estimate(measured, noise, known).covariance

    slope = (covariance(1.0 + step) - covariance(1.0 - step)) / (2.0 * step)
    found = with_known_accelerometers()
    by_part = covariance_of(found.parts[part])
    tolerance = 1e-4 * np.abs(np.diag(by_part)).max() + 1e-9 * found.covariance.max()
    assert by_part == pytest.approx(slope, rel=1e-3, abs=tolerance)


def test_each_part_holds_the_uncertainty_it_follows_from():
    parts = estimate(dwell()).parts
    assert parts["angle_random_walk"].sigma == NOISE.angle_random_walk
    assert parts["velocity_output"].sigma == pytest.approx(NOISE.velocity_white)
    assert parts["heading_output"].sigma == pytest.approx(NOISE.heading_white)
    assert parts["latitude"].sigma == PRIOR.latitude
    assert "accelerometer_settling" not in parts
