"""Covariances of coefficients by source of error."""

from dataclasses import replace

import numpy as np
import pytest

from gyrobench.bench.calibration import estimator
from gyrobench.bench.calibration.coefficients import COUNT
from gyrobench.bench.calibration.estimator import calibrate, covariances_by_source
from gyrobench.bench.calibration.increment_recording import IncrementRecording, SensorNoise
from gyrobench.bench.calibration.information import CalibrationOptions
from gyrobench.bench.navigation.error_model import Site
from tests.bench.calibration.rotated_unit import EIGHTEEN, Noise, Unit

SITE = Site(np.deg2rad(45.0))
NOISE = Noise(angle_random_walk=2e-7, velocity_random_walk=5e-5, white_velocity=1e-4)
OPTIONS = CalibrationOptions(whole_turns=5e-6, gravity_sigma=1e-5)


@pytest.fixture(scope="module")
def increments():
    return Unit(gravity=SITE.gravity, sample_hz=20.0, dwell_s=60.0, rotations=EIGHTEEN).increments()


@pytest.fixture
def known_noise(monkeypatch):
    """Noise as it is, not as measured."""
    sizes = (NOISE.angle_random_walk, 0.0, NOISE.velocity_random_walk, NOISE.white_velocity)
    noise = SensorNoise(*(np.full(3, each) for each in sizes))
    monkeypatch.setattr(estimator, "measure_noise", lambda *_: noise)


def found_in(increments, noise, seed, options=OPTIONS):
    recording = IncrementRecording(0.05, *noise.added(*increments, 0.05, np.random.default_rng(seed)))
    return calibrate([recording], SITE, options)


def test_parts_of_the_place_are_the_shifts_that_wrong_gravity_and_latitude_cause(increments, known_noise):
    wrong_latitude, wrong_gravity = 1e-4, 1e-3
    uncertain = replace(OPTIONS, latitude_sigma=wrong_latitude, gravity_sigma=wrong_gravity)
    recording = IncrementRecording(0.05, *NOISE.added(*increments, 0.05, np.random.default_rng(2)))
    found = calibrate([recording], SITE, uncertain)
    parts = covariances_by_source(found)
    elsewhere = Site(SITE.latitude + wrong_latitude)
    exact = replace(OPTIONS, gravity_sigma=0.0)
    for name, site, gravity in (
        ("latitude", elsewhere, SITE.gravity),
        ("gravity", SITE, SITE.gravity + wrong_gravity),
    ):
        shift = calibrate([recording], site, replace(exact, gravity=gravity)).values - found.values
        wrong = np.sqrt(np.diag(parts[name])) - np.abs(shift)
        assert (np.abs(wrong) < 0.01 * found.sigmas).all(), name
    # Beyond half a minute of arc the latitude is what limits the biases of gyros.
    assert np.sqrt(np.diag(parts["latitude"]))[:3].max() > 5e-10
    total = np.sum([np.diag(part) for part in parts.values()], axis=0)
    assert total == pytest.approx(np.diag(found.covariance), rel=1e-9)


def test_the_parts_add_up_to_the_covariance(increments, known_noise):
    found = found_in(increments, NOISE, 1)
    parts = covariances_by_source(found)
    total = np.sum([np.diag(part) for part in parts.values()], axis=0)
    assert total == pytest.approx(np.diag(found.covariance), rel=1e-9)
    for part in parts.values():
        assert (np.diag(part) > -1e-3 * np.diag(found.covariance)).all()
    scale_factors = [each.name == "accelerometer_scale_factor" for each in found.coefficients]
    assert np.sqrt(np.diag(parts["gravity"])[scale_factors]) == pytest.approx(1e-5 / SITE.gravity)


@pytest.mark.parametrize("source", ["angle_random_walk", "velocity_random_walk", "white_velocity"])
def test_a_part_is_the_scatter_by_its_noise_alone(increments, known_noise, source):
    nothing = dict.fromkeys(("angle_random_walk", "velocity_random_walk", "white_velocity"), 0.0)
    alone = replace(NOISE, **nothing | {source: getattr(NOISE, source)})
    options = replace(OPTIONS, whole_turns=None)
    found = [found_in(increments, alone, seed, options) for seed in range(8)]
    variances = np.diag(covariances_by_source(found_in(increments, NOISE, 1, options))[source])
    values = np.array([each.values[:COUNT] for each in found])
    scatter = np.sum((values - values.mean(axis=0)) ** 2, axis=0) / (len(found) - 1)
    seen = variances > 1e-4 * np.diag(found[0].covariance)[:COUNT]
    assert seen.sum() >= 3
    assert np.sqrt(np.mean(scatter[seen] / variances[seen])) == pytest.approx(1.0, abs=0.25)
