"""Calibration of all coefficients: expected uncertainties at five latitudes; rms and coverage.

The truth is a unit on a table in closed form, independent of the estimator. The Cramer-Rao bound is the
information of the same rotations at the noise that was simulated.
"""

import os

import numpy as np
import pytest

from gyrobench.bench.calibration.coefficients import COEFFICIENTS, SensorErrors
from gyrobench.bench.calibration.estimator import CalibrationOptions, calibrate
from gyrobench.bench.calibration.recording import IncrementRecording
from gyrobench.bench.calibration.rotation_list import forecast, load_rotation_list
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.error_model import Site
from tests.bench.calibration.navigated_unit import WALKS, any_unit, rotated, six_dwells, truth
from tests.bench.calibration.rotated_unit import Noise, Unit
from tests.bench.calibration.test_rotation_list import NAMES, NOISE, SHOWN, TABLE

RUNS = int(os.environ.get("GYROBENCH_BENCHMARK_RUNS", "100"))


@pytest.mark.parametrize("latitude_deg", [5, 31, 45, 67, -34])
def test_expected_uncertainties_of_eighteen_rotations(latitude_deg):
    rotations = load_rotation_list(find_document("rotations", "eighteen_rotations"))
    found = forecast(rotations, TABLE, Site(np.deg2rad(latitude_deg)), NOISE, 100.0)
    sigmas = found.sigmas * SHOWN

    def of(part):
        values = [sigma for name, sigma in zip(NAMES, sigmas, strict=True) if part in name]
        return f"{min(values):7.3f} to {max(values):7.3f}"

    print(
        f"\n{latitude_deg} deg: scale factors {of('gyro_scale')} ppm, misalignments {of('gyro_mis')} arcsec"
    )
    print(
        f"accelerometer biases {of('accelerometer_bias')} ug, scale factors {of('accelerometer_scale')} ppm"
    )
    assert found.is_observed.all()
    assert sigmas[[NAMES.index(f"gyro_scale_factor_{axis}") for axis in "xyz"]].max() < 0.55
    assert max(sigma for name, sigma in zip(NAMES, sigmas, strict=True) if "gyro_mis" in name) < 0.44


def test_rms_over_the_cramer_rao_bound_and_coverage():
    rotations = load_rotation_list(find_document("rotations", "eighteen_rotations"))
    random, site, noise, dt = np.random.default_rng(21), Site(np.deg2rad(45.0)), Noise(), 0.05
    errors = {
        "gyro_bias": random.normal(0.0, 1e-7, 3),
        "gyro_matrix": random.normal(0.0, 5e-5, (3, 3)),
        "force_bias": random.normal(0.0, 5e-4, 3),
        "force_matrix": random.normal(0.0, 2e-4, (3, 3)),
    }
    turns = [(each.axis, each.angle_deg) for each in rotations.rotations]
    increments = Unit(turns, dwell_s=149.0, sample_hz=1.0 / dt, gravity=site.gravity, **errors).increments()
    truth = SensorErrors(**errors).vector()
    exact = CalibrationOptions(walks=(noise.angle_random_walk, noise.velocity_random_walk))
    deviations, normalised, bounds = [], [], []
    for number in range(RUNS):
        recording = IncrementRecording(dt, *noise.added(*increments, dt, random))
        found = calibrate([recording], site)
        deviations.append(found.values - truth)
        normalised.append(deviations[-1] / found.sigmas)
        if number < 3:
            bounds.append(calibrate([recording], site, exact).sigmas)
    ratio = np.sqrt(np.mean((np.array(deviations) / np.mean(bounds, axis=0)) ** 2))
    coverage = np.mean(np.abs(normalised) < 1.96)
    print(
        f"\n{RUNS} units, {len(COEFFICIENTS)} coefficients: rms / bound {ratio:.3f}, "
        f"95 % intervals hold {coverage:.1%}"
    )
    assert ratio < 1.05
    assert 0.93 < coverage < 0.97


@pytest.mark.parametrize("latitude_deg", [5, 31, 45, 67, -34])
@pytest.mark.parametrize("what", ["six dwells", "eighteen rotations"])
def test_navigation_output_gives_what_its_information_allows(what, latitude_deg):
    rotations = load_rotation_list(find_document("rotations", "eighteen_rotations"))
    random, site = np.random.default_rng([7, abs(latitude_deg)]), Site(np.deg2rad(latitude_deg), 60.0)
    heading = CalibrationOptions(walks=WALKS, table=(1e3, np.pi / 648000.0))
    deviations, normalised, bounds = [], [], []
    for _ in range(RUNS // 5 if what == "six dwells" else RUNS // 2):
        unit = any_unit(random)
        if what == "six dwells":
            recordings, rests = six_dwells(unit, latitude_deg, random)
        else:
            recordings, rests = rotated(unit, latitude_deg, random, rotations)
        found = calibrate(recordings, site, heading, rests)
        deviations.append(np.where(found.is_observed, found.values - truth(unit), np.nan))
        bounds.append(found.sigmas)
        normalised.append(deviations[-1] / found.sigmas)
    bound = np.mean(bounds, axis=0)
    seen = np.isfinite(deviations).all(axis=0)
    rms = np.sqrt(np.mean(np.array(deviations)[:, seen] ** 2, axis=0))
    ratio = np.sqrt(np.mean((rms / bound[seen]) ** 2))
    coverage = np.mean(np.abs(np.array(normalised)[:, seen]) < 1.96)
    print(f"\n{what}, {latitude_deg} deg: rms / bound {ratio:.3f}, 95 % intervals hold {coverage:.1%}")
    for name, sigma in zip(np.array(NAMES)[seen], (bound * SHOWN)[seen], strict=True):
        print(f"  {name:32s} {sigma:8.3f}")
    assert seen.sum() >= 15
    assert ratio == pytest.approx(1.0, abs=0.1)
    assert 0.92 < coverage < 0.98
