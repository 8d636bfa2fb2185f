"""Calibration of all coefficients: expected uncertainties at five latitudes; rms and coverage.

The truth is a unit on a table in closed form, independent of the estimator. The Cramer-Rao bound is the
information of the same rotations at the noise that was simulated.
"""

import os

import numpy as np
import pytest
import yaml

from gyrobench.bench.calibration.coefficients import COEFFICIENTS, SensorErrors
from gyrobench.bench.calibration.estimator import calibrate
from gyrobench.bench.calibration.increment_recording import IncrementRecording
from gyrobench.bench.calibration.information import CalibrationOptions
from gyrobench.bench.calibration.rotation_list import (
    RotationSetup,
    expected_uncertainties,
    load_rotation_list,
)
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.runs.tables.coefficient_table import COEFFICIENT_TABLE
from tests.bench.calibration.navigated_unit import (
    WALKS,
    any_unit,
    rotated,
    rotated_schedule,
    six_dwells,
    six_schedules,
    truth,
)
from tests.bench.calibration.rotated_unit import Noise, Unit
from tests.bench.calibration.test_rotation_list import NAMES, NOISE, SHOWN, TABLE
from tests.bench.command_line import gyrobench
from tests.bench.dwells.test_plateau_calibration import WORLD, deviations
from tests.benchmarks.fisher_information import fisher_sigmas

LATITUDES_DEG = (5, 31, 45, 67, -34)
ARCSEC = np.pi / 648000.0
SEEDS = int(os.environ.get("GYROBENCH_BENCHMARK_SEEDS", "8"))
RUNS = int(os.environ.get("GYROBENCH_BENCHMARK_RUNS", "100"))


@pytest.mark.parametrize("latitude_deg", LATITUDES_DEG)
def test_expected_uncertainties_of_eighteen_rotations(latitude_deg):
    rotations = load_rotation_list(find_document("rotations", "eighteen_rotations"))
    setup = RotationSetup(TABLE, Site(np.deg2rad(latitude_deg)), NOISE, 100.0)
    found = expected_uncertainties(rotations, setup)
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
    assert sigmas[[NAMES.index(f"gyro_scale_factor_{axis}") for axis in "xyz"]].max() < 0.5
    assert max(sigma for name, sigma in zip(NAMES, sigmas, strict=True) if "gyro_mis" in name) < 0.25


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


@pytest.mark.parametrize("what", ["six dwells", "eighteen rotations"])
def test_navigation_output_gives_what_its_information_allows(what):
    rotations = load_rotation_list(find_document("rotations", "eighteen_rotations"))
    heading = CalibrationOptions(walks=WALKS, heading=ARCSEC)
    schedules = six_schedules() if what == "six dwells" else [rotated_schedule(rotations)]
    normalised, ratios, beyond = [], [], []
    for latitude_deg in LATITUDES_DEG:
        random, site = np.random.default_rng([7, abs(latitude_deg)]), Site(np.deg2rad(latitude_deg), 60.0)
        deviations, sigmas = [], []
        for _ in range(RUNS // 5):
            unit = any_unit(random)
            recordings = (
                six_dwells(unit, latitude_deg, random)
                if what == "six dwells"
                else rotated(unit, latitude_deg, random, rotations)
            )
            found = calibrate(recordings, site, heading)
            deviations.append(np.where(found.is_observed, found.values - truth(unit), np.nan))
            sigmas.append(found.sigmas)
        seen = np.isfinite(deviations).all(axis=0)
        names, deviations, sigmas = (
            np.array(NAMES)[seen],
            np.array(deviations)[:, seen],
            np.array(sigmas)[:, seen],
        )
        normalised.append((deviations / sigmas).ravel())
        turned = np.hypot(ARCSEC, np.sqrt(2.0) * 0.4 * ARCSEC)
        bounds = fisher_sigmas(latitude_deg, schedules, 1e-3, turned, WALKS)
        bound, stated = np.array([bounds[name] for name in names]), sigmas.mean(axis=0)
        ratios.append(np.sqrt(np.mean(deviations**2, axis=0)) / bound)
        beyond.append(stated / bound)
        coverage = np.mean(np.abs(normalised[-1]) < 1.96)
        print(
            f"\n{what}, {latitude_deg} deg: rms / Fisher {np.sqrt(np.mean(ratios[-1] ** 2)):.3f}, stated / "
            f"Fisher {beyond[-1].min():.3f} to {beyond[-1].max():.3f}, 95 % intervals hold {coverage:.1%}"
        )
        if latitude_deg == 45:
            for name, sigma, ratio in zip(names, stated * SHOWN[seen], beyond[-1], strict=True):
                print(f"  {name:32s} {sigma:8.3f} {ratio:.3f}")
        assert seen.sum() >= 15
        assert beyond[-1].max() < 1.03
        assert beyond[-1].min() > 0.97
    ratio, coverage = np.sqrt(np.mean(np.square(ratios))), np.mean(np.abs(np.concatenate(normalised)) < 1.96)
    print(
        f"{what}, all: rms / Fisher {ratio:.3f}, 95 % intervals hold {coverage:.1%} of {np.size(normalised)}"
    )
    assert ratio < 1.1
    assert 0.93 < coverage < 0.97


def test_whole_runs_of_a_short_full_calibration_hold(tmp_path):
    """Two plateaus through engine, CAN and both estimators, from several seeds."""
    document = yaml.safe_load(find_document("procedures", "full_calibration").read_text())
    repeat = document["steps"][2]["repeat"]
    repeat["over"]["temperature_c"] = [40, 10]
    for step in repeat["steps"]:
        for kind, shorter in (("rotate", {"rest_s": 40}), ("soak", {"at_least_s": 1800, "at_most_s": 5400})):
            if kind in step:
                step[kind] |= shorter
        for dwell in step.get("repeat", {}).get("steps", ()):
            if "navigate" in dwell:
                dwell["navigate"]["duration_s"] = 180
    path = tmp_path / "short.yaml"
    path.write_text(yaml.safe_dump(document))
    normalised = []
    for seed in range(SEEDS):
        out = tmp_path / str(seed)
        run = gyrobench("run", path, "--world", WORLD, "--seed", seed, "--out", out, cwd=tmp_path)
        assert run.returncode == 0, run.stderr
        normalised.append(deviations(COEFFICIENT_TABLE.read(out / "coefficients.csv")))
    found = np.array(normalised)
    found = found[np.isfinite(found)]
    held = np.count_nonzero(np.abs(found) < 1.96)
    print(
        f"\n{SEEDS} runs, {len(found)} coefficients: 95 % intervals hold {held} ({held / len(found):.1%}), "
        f"rms in standard uncertainties {np.sqrt(np.mean(found**2)):.3f}"
    )
    # Coefficients of a run are correlated: as many as half are independent.
    assert abs(held / len(found) - 0.95) < 3.0 * np.sqrt(0.95 * 0.05 / (0.5 * len(found)))


@pytest.mark.parametrize(("lag_s", "dph_per_g"), [(600.0, 0.0), (200.0, 0.01), (600.0, 0.01), (600.0, 0.005)])
def test_gyro_biases_that_lag_the_attitude_are_a_finding(tmp_path, lag_s, dph_per_g):
    """The dwells, rotations and whole turns of a plateau at room temperature, from several seeds."""
    document = yaml.safe_load(find_document("procedures", "full_calibration").read_text())
    plateau = [
        each for each in document["steps"][2]["repeat"]["steps"] if not {"chamber", "soak"} & each.keys()
    ]
    procedure, world_path = tmp_path / "plateau.yaml", tmp_path / "world.yaml"
    steps = [{"power_on": {"settle_s": 600}}, *plateau, "power_off"]
    procedure.write_text(yaml.safe_dump({"procedure": "plateau", "bin_width_c": 5, "steps": steps}))
    world = yaml.safe_load(find_document("worlds", WORLD).read_text())
    flagged, silent, worst = 0, 0, []
    for seed in range(SEEDS):
        sensitivities = dph_per_g * np.random.default_rng([seed, 77]).standard_normal((3, 3))
        effect = {"kind": "g_sensitivity", "sensitivity_dph_per_g": sensitivities.tolist(), "lag_s": lag_s}
        world_path.write_text(yaml.safe_dump(world | {"undeclared_effects": [effect]}))
        out = tmp_path / str(seed)
        run = gyrobench("run", procedure, "--world", world_path, "--seed", seed, "--out", out, cwd=tmp_path)
        assert run.returncode == 0, run.stderr
        rows = COEFFICIENT_TABLE.read(out / "coefficients.csv")
        worst.append(float(np.nanmax(np.abs(deviations(rows)))))
        is_flagged = any("follow the attitude" in row.finding for row in rows)
        flagged += is_flagged
        silent += not any(row.finding or row.note for row in rows) and worst[-1] > 5.0
    print(
        f"\n{dph_per_g:g} deg/h/g, lag {lag_s:g} s: {flagged} of {SEEDS} runs flagged, {silent} silent; "
        f"largest error {np.median(worst):.1f} (median), {max(worst):.1f} standard uncertainties"
    )
    assert silent == 0
    if not dph_per_g:
        assert flagged == 0
    elif dph_per_g == 0.01:
        assert flagged >= 0.95 * SEEDS
