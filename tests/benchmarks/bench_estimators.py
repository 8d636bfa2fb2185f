"""Error, uncertainty and speed of the state-space estimator of gyro bias beside the paper's.

The truth is the strapdown INS of the emulated bench and, for accelerometers that drift, that of pyins.
Errors and uncertainties in the tables are in 0.001 deg/h.
"""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import kstest

from gyrobench.bench.bias.bias_filter import BiasFilter, StateSpaceEstimate, estimate_state_space
from gyrobench.bench.bias.dwell import Dwell, RestOutput
from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.paper import estimate_paper
from gyrobench.bench.bias.parameters import ErrorModel, PriorKnowledge
from gyrobench.bench.foundations.errors import MeasurementError
from gyrobench.bench.navigation.positions import POSITIONS
from tests.bench.bias import disturbances
from tests.bench.bias.cramer_rao import CramerRao
from tests.bench.bias.emulated_dwells import CLEAN, DPH, LATITUDE_DEG, UG, emulate, noise_model, sensors, site
from tests.bench.bias.pyins_dwells import RestingIns, simulate

#: With a surveyed latitude.
DEFAULT = PriorKnowledge.from_datasheet(latitude_arcmin=0.02)
NOISE = noise_model(0.0006)
LATITUDES_DEG = (-60.0, -36.4, -1.0, 0.0, 15.0, 36.4, 60.0)
WINDOWS_S = (300.0, 600.0, 1200.0)
ARCSEC = np.pi / 180.0 / 3600.0
TRUTH_DPH, TRUTH_UG = np.array([0.02, -0.01, 0.015]), (30.0, -50.0, 0.0)
DWELLS, QUANTISED_DWELLS, FIT_DWELLS = 2000, 400, 20


def ours(
    dwell: Dwell, noise: NoiseModel, prior: PriorKnowledge = DEFAULT, latitude_deg: float = LATITUDE_DEG
):
    return estimate_state_space(dwell, ErrorModel(site(latitude_deg), noise, prior))


def papers(dwell: Dwell, noise: NoiseModel = NOISE, latitude_deg: float = LATITUDE_DEG):
    """Bias by the paper's method; NaN where it does not apply."""
    try:
        return estimate_paper(dwell, site(latitude_deg).gravity, noise).bias_dph
    except MeasurementError:
        return np.full(3, np.nan)


def title(text: str) -> None:
    print(f"\n{text}")


def triple(values: Any, digits: int = 2) -> str:
    return " ".join("      --" if np.isnan(v) else f"{1e3 * v:>8.{digits}f}" for v in values)


# Without noise -----------------------------------------------------------------------------------


def worst_errors(latitude_deg: float, window_s: float, random: np.random.Generator) -> np.ndarray:
    """Largest error of the state-space estimate and of the paper's, deg/h."""
    worst = np.zeros(2)
    for position in POSITIONS:
        for signs in itertools.product((1.0, -1.0), repeat=3):
            bias_dph = 0.05 * np.array(signs)
            accelerometer_ug = 100.0 * random.choice([-1.0, 1.0], 3)
            dwell = emulate(
                position, sensors(bias_dph, accelerometer_ug), window_s=window_s, latitude_deg=latitude_deg,
                outer_level=True,
            )  # fmt: skip
            found = ours(dwell, NOISE, latitude_deg=latitude_deg).bias_dph, papers(dwell, NOISE, latitude_deg)
            worst = np.maximum(worst, np.abs(np.array(found) - bias_dph).max(axis=1))
    return worst


def test_error_without_noise():
    title(
        "Without noise: largest error of any gyro in six positions, biases ±0.05 deg/h in all signs,\n"
        "accelerometers ±100 ug, state-space and paper's estimator"
    )
    print(f"{'latitude':>8}" + "".join(f"{f'windows {w:.0f} s':>20}" for w in WINDOWS_S))
    random, rows = np.random.default_rng(1), []
    for latitude_deg in LATITUDES_DEG:
        rows.append([worst_errors(latitude_deg, window_s, random) for window_s in WINDOWS_S])
        cells = "".join(f"{1e3 * a:>11.3f}{1e3 * b:>9.1f}" for a, b in rows[-1])
        print(f"{latitude_deg:>8.1f}{cells}")
    worst = np.array(rows).max(axis=0)
    print(f"{'worst':>8}" + "".join(f"{1e3 * a:>11.3f}{1e3 * b:>9.1f}" for a, b in worst))
    assert worst[:, 0].max() <= 2e-4


# Noise -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Scatter:
    """What many dwells that differ in their noise gave; arrays (n, 3) in deg/h, p-values (n,)."""

    errors: np.ndarray
    sigmas: np.ndarray
    p_values: np.ndarray
    paper_errors: np.ndarray

    @property
    def rms(self) -> np.ndarray:
        return np.sqrt((self.errors**2).mean(axis=0))

    @property
    def paper_rms(self) -> np.ndarray:
        return np.sqrt((self.paper_errors**2).mean(axis=0))

    @property
    def coverage(self) -> np.ndarray:
        return (np.abs(self.errors) < 1.96 * self.sigmas).mean(axis=0)

    @property
    def uniform(self) -> float:
        return float(kstest(self.p_values, "uniform").pvalue)


def scatter(
    count: int, declared: NoiseModel, prior: PriorKnowledge = CLEAN, seed: int = 2, **dwell: Any
) -> Scatter:
    random = np.random.default_rng(seed)
    rows = []
    for _ in range(count):
        each = emulate(ins=sensors(TRUTH_DPH, TRUTH_UG, declared), random=random, **dwell)
        found = ours(each, declared, prior)
        rows.append(
            (found.bias_dph - TRUTH_DPH, found.sigma_dph, found.fit.p_value, papers(each) - TRUTH_DPH)
        )
    return Scatter(*(np.array(column) for column in zip(*rows, strict=True)))


def test_noise_against_the_cramer_rao_bound():
    title(
        f"Noise: rms error of {DWELLS} dwells (known to {100 / np.sqrt(2 * DWELLS):.1f} %) against the\n"
        "Cramer-Rao bound of the simulated INS, (i) with the velocity going on through the turn, (ii) with\n"
        "a velocity that may jump; velocity noise 1 mm/s and heading noise 2 urad at 1 Hz, 5 ug/sqrt(Hz);\n"
        "sigma with declared errors, and by default. Paper: rms error with its leaks, and scatter"
    )
    print(
        f"{'ARW':>7}{'gyro':>5}{'bound i':>9}{'bound ii':>9}{'rms':>8}{'rms/i':>7}{'rms/ii':>7}{'sigma':>8}"
        f"{'default':>9}{'95 %':>7}{'p unif.':>8}{'paper rms':>10}{'scatter':>9}"
    )
    cramer_rao = CramerRao()
    for arw in (0.0005, 0.001, 0.003):
        noise = noise_model(arw)
        found = scatter(DWELLS, noise, noise=noise)
        going_on, jumping = (
            cramer_rao.bias_sigma(noise, velocity_jump=jump)[:3] / DPH for jump in (False, True)
        )
        default = ours(emulate(), noise).sigma_dph
        for k, gyro in enumerate("xyz"):
            bounds = f"{1e3 * going_on[k]:>9.3f}{1e3 * jumping[k]:>9.3f}{1e3 * found.rms[k]:>8.3f}"
            ratios = f"{found.rms[k] / going_on[k]:>7.3f}{found.rms[k] / jumping[k]:>7.3f}"
            sigmas = (
                f"{1e3 * found.sigmas[0, k]:>8.3f}{1e3 * default[k]:>9.3f}{100 * found.coverage[k]:>7.1f}"
            )
            paper = f"{1e3 * found.paper_rms[k]:>10.3f}{1e3 * found.paper_errors[:, k].std():>9.3f}"
            print(f"{arw:>7}{gyro:>5}{bounds}{ratios}{sigmas}{found.uniform:>8.2f}{paper}")
        assert np.all(np.abs(found.rms / jumping - 1.0) < 0.05)
        assert np.all(np.abs(found.coverage - 0.95) <= 0.02)
        assert found.uniform > 1e-3


def test_outputs_with_the_resolution_of_the_emulated_ins():
    title(
        f"Resolution: outputs of 10 Hz rounded to 1e-4 m/s and 1e-6 deg, noise by NoiseModel.from_datasheet, "
        f"{QUANTISED_DWELLS} dwells"
    )
    print(f"{'ARW':>7}{'rms / sigma':>27}{'95 %':>24}{'p unif.':>9}")
    for arw in (0.0005, 0.003):
        declared = NoiseModel.from_datasheet(arw, 5.0, 1e-4, np.radians(1e-6))
        found = scatter(QUANTISED_DWELLS, declared, lsb=(1e-4, 1e-6), epoch_s=0.1)
        print(
            f"{arw:>7}   {''.join(f'{v:>8.3f}' for v in found.rms / found.sigmas[0])}"
            f"{''.join(f'{100 * v:>8.1f}' for v in found.coverage)}{found.uniform:>9.2f}"
        )
        assert abs(found.coverage.mean() - 0.95) <= 0.02
        assert found.uniform > 1e-3


# What acts beside the biases ---------------------------------------------------------------------


@dataclass(frozen=True)
class Disturbed:
    """A dwell without noise in which something acts, and the prior knowledge that declares its size."""

    name: str
    dwell: Dwell
    declared: dict[str, float]

    @property
    def prior(self) -> PriorKnowledge:
        nothing = dict.fromkeys(
            ("gyro_scale_factor_ppm", "gyro_misalignment_arcsec", "tilt_step_arcsec", "latitude_arcmin"), 0.0
        )
        return PriorKnowledge.from_datasheet(**nothing | {"bias_slope_dph_per_c": 0.0} | self.declared)


def turn_errors(position: str) -> Iterator[Disturbed]:
    """What acts in the turn: of both axes for the gyros' errors, of a vertical one for the tilt."""
    off_axis = 5.0 * ARCSEC * np.array([[0, 1, -1], [1, 0, 1], [-1, 1, 0]])
    for name, matrix, declared in (
        ("scale factor 5 ppm", 5e-6 * np.eye(3), "gyro_scale_factor_ppm"),
        ("misalignment 5 arcsec", off_axis, "gyro_misalignment_arcsec"),
    ):
        dwell = emulate(position, sensors(gyro_matrix=matrix), outer_level=True)
        yield Disturbed(f"{position}: {name}", dwell, {declared: 5.0})
    tilted = disturbances.tilt_step(position, 0, 5.0 * ARCSEC, 612.505, np.pi / 2.0)
    dwell = emulate(position, sensors(gyro_bias_change=tilted))
    yield Disturbed(f"{position}: tilt of 5 arcsec in the turn", dwell, {"tilt_step_arcsec": 5.0})


def navigation_errors(position: str) -> Iterator[Disturbed]:
    """What the INS starts with, and what goes along with the Earth."""
    dwell = emulate(position, latitude_error_arcmin=1.0)
    yield Disturbed(f"{position}: latitude wrong by 1 arcmin", dwell, {"latitude_arcmin": 1.0})
    for heading_deg in (0.05, 0.5, 2.0):
        dwell = emulate(position, sensors(gyro_bias_change=disturbances.heading_error(position, heading_deg)))
        yield Disturbed(f"{position}: initial heading {heading_deg:g} deg", dwell, {})
    for axis, rate_enu_dph in zip(("East", "North", "Up"), 0.005 * np.eye(3), strict=True):
        change = disturbances.navigation_rate(position, rate_enu_dph)
        dwell = emulate(position, sensors(gyro_bias_change=change))
        yield Disturbed(f"{position}: fixed rate {axis} 0.005 deg/h", dwell, {})


def disturbed_dwells() -> Iterator[Disturbed]:
    for position in ("z_up", "y_up", "x_down"):
        yield from turn_errors(position)
        yield from navigation_errors(position)
    for window_s in WINDOWS_S:
        dwell = simulate(RestingIns(accelerometer_drift_mps2=(10.0 * UG, 0.0, 0.0), window_s=window_s))
        yield Disturbed(f"z_up: accelerometer x drifts 10 ug, {window_s:g} s", dwell, {})


def test_what_acts_beside_the_biases():
    title(
        "Disturbances, no noise: error x y z, standard uncertainty where the size is declared (ARW 0.0006), "
        "share of\nit that the declaration adds, and error of the paper's estimator"
    )
    print(f"{'':<42}{'error':>26} {'sigma':>26} {'added':>26} {'paper':>26}")
    for each in disturbed_dwells():
        found, plain = ours(each.dwell, NOISE, each.prior), ours(each.dwell, NOISE, CLEAN)
        added = np.sqrt(np.maximum(found.sigma_dph**2 - plain.sigma_dph**2, 0.0))
        print(
            f"{each.name:<42}{triple(found.bias_dph)} {triple(found.sigma_dph)} {triple(added)} "
            f"{triple(papers(each.dwell))}"
        )
        if not ("fixed rate Up" in each.name or "drifts" in each.name):
            assert np.all(np.abs(found.bias_dph) < 3.0 * added + 2e-4)


# Test of fit -------------------------------------------------------------------------------------


def spiked(dwell: Dwell, at: int, size_mps: float) -> Dwell:
    first = dwell.windows[0]
    velocity = first.velocity_enu_mps.copy()
    velocity[at, 0] += size_mps
    return replace(dwell, windows=(replace(first, velocity_enu_mps=velocity), *dwell.windows[1:]))


def misfits(arw: float) -> Iterator[tuple[str, Callable[[np.random.Generator], Dwell]]]:
    noise = noise_model(arw)

    def dwell_with(ins: Any, after: Callable[[Dwell], Dwell] = lambda dwell: dwell) -> Any:
        return lambda random: after(emulate(ins=ins, noise=noise, random=random))

    def changed(change: Any) -> Any:
        return dwell_with(sensors(noise=noise, gyro_bias_change=change))

    yield "nothing", dwell_with(sensors(noise=noise))
    for dph in (0.05, 0.02):
        yield f"bias x jumps {dph:g} deg/h in mid-window", changed(disturbances.bias_step(0, dph, 300.0))
    for rad in (1e-4, 1e-5):
        yield f"tilt jumps {rad:g} rad in mid-window", changed(disturbances.tilt_step("z_up", 0, rad, 300.05))
    for factor in (3.0, 1.5):
        yield f"ARW {factor:g} times the declared one", dwell_with(sensors(noise=noise_model(factor * arw)))
    for at, mps in ((300, 1.0), (300, 0.1), (600, 0.1)):
        yield (
            f"velocity spike {mps:g} m/s at {at} s",
            dwell_with(sensors(noise=noise), lambda dwell, at=at, mps=mps: spiked(dwell, at, mps)),
        )


def test_what_the_test_of_fit_flags():
    title(
        f"Test of fit: share of {FIT_DWELLS} dwells with p < 0.01 and p < 1e-5, median of p and of the "
        "ratio, mean error of x"
    )
    print(f"{'ARW':>7}  {'':<40}{'p<0.01':>8}{'p<1e-5':>8}{'p':>10}{'ratio':>8}{'error x':>9}")
    for arw in (0.0006, 0.003):
        for name, make in misfits(arw):
            random = np.random.default_rng(3)
            found = [ours(make(random), noise_model(arw)) for _ in range(FIT_DWELLS)]
            p = np.array([each.fit.p_value for each in found])
            print(
                f"{arw:>7}  {name:<40}{(p < 0.01).mean():>8.2f}{(p < 1e-5).mean():>8.2f}{np.median(p):>10.1e}"
                f"{np.median([each.fit.ratio for each in found]):>8.2f}"
                f"{1e3 * np.mean([each.bias_dph[0] for each in found]):>9.2f}"
            )


# Temperature, azimuths, recursion ----------------------------------------------------------------


def test_bias_that_changes_with_temperature():
    title("Temperature ramps, 0.001 deg/h/K on each gyro, no noise: error at the mean temperature x y z")
    print(f"{'':<36}{'temperatures given':>26} {'not given':>26} {'paper':>26}")
    for rate_c_per_h in (10.0, 30.0, -60.0):

        def warmth(time_s: np.ndarray, rate: float = rate_c_per_h) -> np.ndarray:
            return rate * (np.maximum(time_s, -300.0) - 612.5) / 3600.0

        for position in ("z_up", "y_up"):
            ins = sensors(gyro_bias_change=disturbances.warming((0.001, -0.001, 0.001), warmth))
            declared = emulate(
                position, ins, gyro_c=lambda time_s: 40.0 + np.multiply.outer(warmth(time_s), np.ones(3))
            )
            undeclared = emulate(position, ins)
            errors = [ours(declared, NOISE).bias_dph, ours(undeclared, NOISE).bias_dph]
            name = f"{position}: {rate_c_per_h:g} degC/h"
            print(f"{name:<36}{triple(errors[0], 3)} {triple(errors[1], 3)} {triple(papers(declared), 2)}")
            assert np.abs(errors).max() <= 2e-4


def test_azimuths():
    count = 200
    title(
        f"Azimuths, {count} noisy dwells of 300 s windows, ARW 0.001: rms over sigma, mean over its "
        "uncertainty, sigma"
    )
    print(f"{'stops, deg':<28}{'rms/sigma x y z':>26}{'mean/its sigma':>26}{'sigma':>28}")
    noise = noise_model(0.001)
    for stops_deg in ((0, 180), (0, -180), (30, 210), (0, 120), (0, 90), (0, 90, 180, 270), (0, 180, 0, 180)):
        found = scatter(
            count, noise, noise=noise, stops_deg=tuple(map(float, stops_deg)), window_s=300.0, seed=4
        )
        z = found.errors / found.sigmas
        print(
            f"{stops_deg!s:<28}  {''.join(f'{v:>8.2f}' for v in np.sqrt((z**2).mean(axis=0)))}"
            f"  {''.join(f'{v:>8.2f}' for v in z.mean(axis=0) * np.sqrt(count))}  {triple(found.sigmas[0])}"
        )
        assert np.abs(np.sqrt((z**2).mean(axis=0)) - 1.0).max() < 4.0 / np.sqrt(2 * count)
        assert np.abs(z.mean(axis=0) * np.sqrt(count)).max() < 4.0


def recursive(dwell: Dwell, chunk: int, noise: NoiseModel) -> StateSpaceEstimate:
    bias_filter = BiasFilter(ErrorModel(site(), noise, DEFAULT))
    for number, window in enumerate(dwell.windows):
        bias_filter.begin_window(
            window.time_s[0], window.C_nb[0], dwell.turns[number - 1] if number else None
        )
        for start in range(0, len(window.time_s), chunk):
            part = slice(start, start + chunk)
            bias_filter.add(RestOutput(window.time_s[part], window.velocity_enu_mps[part], window.C_nb[part]))
    return bias_filter.estimate()


def test_recursive_and_at_once():
    title("Recursive against at once: largest difference of bias and sigma, 0.001 deg/h")
    print(f"{'output':>8}{'chunk':>9}{'bias':>12}{'sigma':>12}")
    for epoch_s in (1.0, 0.1):
        dwell = emulate(
            ins=sensors(TRUTH_DPH, TRUTH_UG, NOISE),
            noise=NOISE,
            random=np.random.default_rng(5),
            epoch_s=epoch_s,
        )
        whole = ours(dwell, NOISE)
        for chunk_s in (1.0, 7.0, 100.0):
            part = recursive(dwell, round(chunk_s / epoch_s), NOISE)
            bias, sigma = (
                np.abs(a - b).max()
                for a, b in ((part.bias_dph, whole.bias_dph), (part.sigma_dph, whole.sigma_dph))
            )
            print(f"{1 / epoch_s:>5.0f} Hz{chunk_s:>7.0f} s{1e3 * bias:>12.1e}{1e3 * sigma:>12.1e}")
            assert max(bias, sigma) < 1e-7


# Speed -------------------------------------------------------------------------------------------


def best_ms(estimate: Callable[[Dwell], Any], dwells: list[Dwell], rounds: int = 5) -> float:
    estimate(dwells[0])
    times_s = []
    for _ in range(rounds):
        begin = time.perf_counter()
        for dwell in dwells:
            estimate(dwell)
        times_s.append(time.perf_counter() - begin)
    return 1e3 * min(times_s) / len(dwells)


def measure_speed() -> dict[str, list[float]]:
    """Milliseconds a dwell of the state-space and the paper's estimator, by output rate."""
    random, result = np.random.default_rng(6), {}
    for epoch_s, count in ((1.0, 100), (0.1, 10)):
        dwells = [
            emulate(ins=sensors(TRUTH_DPH, TRUTH_UG, NOISE), noise=NOISE, random=random, epoch_s=epoch_s)
            for _ in range(count)
        ]
        result[f"{1 / epoch_s:.0f} Hz"] = [
            best_ms(lambda dwell: ours(dwell, NOISE), dwells), best_ms(papers, dwells)
        ]  # fmt: skip
    return result


def test_speed():
    title("Speed (best of five rounds), the linear algebra on one thread, and on as many as it likes")
    print(f"{'threads':>8}{'output':>8}{'state-space':>14}{'100 dwells':>12}{'paper':>10}{'ratio':>8}")
    free = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    for threads, environment in (("1", free | {"OMP_NUM_THREADS": "1"}), ("any", free)):
        command = [sys.executable, "-m", "tests.benchmarks.bench_estimators"]
        process = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE)
        for rate, (state_space_ms, paper_ms) in json.loads(process.stdout).items():
            print(
                f"{threads:>8}{rate:>8}{state_space_ms:>11.2f} ms{state_space_ms / 10:>10.2f} s"
                f"{paper_ms:>7.2f} ms{state_space_ms / paper_ms:>8.1f}"
            )


if __name__ == "__main__":
    print(json.dumps(measure_speed()))
