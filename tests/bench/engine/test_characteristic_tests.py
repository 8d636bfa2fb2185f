"""Further tests of laser gyros on the emulated bench, against what the world declares."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.stats import chi2

from gyrobench.bench.bias.dwell_table import read_dwells
from gyrobench.bench.characteristics.results import read_characteristics
from gyrobench.bench.dwells.run_dwells import finished_marks
from gyrobench.bench.dwells.run_results import recompute_run
from gyrobench.bench.engine.job import prepare_job
from gyrobench.bench.engine.operator import ConsentingOperator
from gyrobench.bench.engine.run import run_job
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.report.journal_sections import durations_by_kind
from gyrobench.bench.report.run_content import read_run
from gyrobench.bench.report.run_report import write_report
from gyrobench.bench.station.instruments import Emulation
from tests.bench.characteristics.simulated_rows import holds
from tests.bench.engine.test_resumption import KilledError, Watcher, resumed

DWELL = """
              - go_to: {position: z_up, rate_dps: 30}
              - align: {duration_s: 16}
              - navigate: {duration_s: 90}
              - turn: {angle_deg: 180, rate_dps: 30, settle_s: 1}
              - navigate: {duration_s: 90}
"""
TURN_ON = f"""procedure: turn_on
tests: {{turn_on_repeatability: {{}}}}
steps:
  - repeat:
      over: {{power_cycle: [1, 2, 3, 4, 5, 6, 7, 8]}}
      steps:
        - chamber: {{temperature_c: 25, ramp_c_per_min: 10}}
        - soak: {{for_s: 300}}
        - power_on: {{settle_s: 600}}
        - repeat:
            over: {{number: [1, 2]}}
            steps: {DWELL}
        - power_off
"""
WARM_UP = f"""procedure: warm_up
tests: {{warm_up: {{within_dph: 0.002}}}}
steps:
  - power_on
  - repeat:
      over: {{number: {list(range(26))}}}
      steps: {DWELL}
  - power_off
"""
THERMAL = f"""procedure: thermal
tests: {{thermal_sensitivity: {{reference_c: 25, degree: 2}}}}
disturbed_dwell: flag
steps:
  - power_on: {{settle_s: 600}}
  - repeat:
      over: {{ramp_c_per_min: [10.0, 5.0], temperature_c: [60, 20, -20, 20]}}
      steps:
        - chamber: {{temperature_c: $temperature_c, ramp_c_per_min: $ramp_c_per_min, within_c: 50}}
        - repeat:
            over: {{number: [1, 2]}}
            steps: {DWELL}
        - soak: {{for_s: 480}}
        - repeat:
            over: {{number: [3, 4]}}
            steps: {DWELL}
  - power_off
"""
NOISE = """procedure: noise
tests: {allan_variance: {}}
steps:
  - power_on: {settle_s: 1200}
  - go_to: {position: y_up, rate_dps: 30}
  - align: {duration_s: 16}
  - navigate: {duration_s: 10800, purpose: noise}
  - power_off
"""
SPIN = "rates_dps: [10, 20], rest_s: 30}"
HALF = "{axis: outer, angle_deg: -90}"
REST = "rate_dps: 20, rest_s: 180}"
STABILITY = f"""procedure: stability
tests: {{scale_factor_stability: {{min_measurements: 6}}}}
steps:
  - repeat:
      over: {{power_cycle: [1, 2]}}
      steps:
        - power_on: {{settle_s: 10800}}
        - repeat:
            over: {{measurement: [1, 2, 3]}}
            steps:
              - go_to: {{position: z_up, rate_dps: 20}}
              - align: {{duration_s: 300}}
              - spin: {{axis: inner, turns: 1, {SPIN}
              - rotate: {{rotations: [{HALF}, {HALF}], {REST}
              - spin: {{axis: outer, turns: 1, {SPIN}
              - rotate: {{rotations: [{{axis: inner, angle_deg: 90}}], {REST}
              - spin: {{axis: outer, turns: 1, {SPIN}
        - power_off
"""
DRIFT = {"drift_ppm_per_h": [2.0, -3.0, 4.0], "swing_ppm": [1.5, 2.0, 1.0], "period_h": 3.4}
HYSTERESIS = {
    "kind": "thermal_hysteresis",
    "half_width_c": 2.0,
    "sensitivity_dph_per_c": [0.003, -0.002, 0.004],
}
RATE = {"kind": "temperature_rate", "sensitivity_dph_per_c_per_h": [2e-5, -1.5e-5, 1e-5]}
WARMING = {"kind": "warm_up", "bias_dph": [0.02, -0.015, 0.018], "time_constant_s": 1800}


@pytest.fixture
def job(tmp_path):
    """Job of a procedure in a shipped world with other gyros and effects."""

    def make(procedure, effects=(), world="quick", station="quick", **gyro):
        document = yaml.safe_load(find_document("worlds", world).read_text())
        document["gyro"].update(gyro)
        document["undeclared_effects"] = list(effects)
        (tmp_path / "world.yaml").write_text(yaml.safe_dump(document))
        (tmp_path / "procedure.yaml").write_text(procedure)
        return prepare_job(
            str(tmp_path / "procedure.yaml"), station, Emulation(str(tmp_path / "world.yaml"), 3, "")
        )

    return make


def result_of(job, folder: Path):
    folder, outcome = run_job(job, folder, Watcher(), ConsentingOperator())
    assert outcome.ended == "finished", outcome.reason
    (result,) = read_characteristics(folder.characteristics)
    assert outcome.results.characteristics == [result]
    return folder, result


def named(result, start):
    return [each for each in result.coefficients if each.name.startswith(start)]


@pytest.mark.long
def test_the_turn_on_scatter_of_the_world_is_found_also_by_a_run_killed_within_a_power_cycle(job, tmp_path):
    made = job(TURN_ON, power_on_repeatability_dph=0.004)
    with pytest.raises(KilledError):
        run_job(made, tmp_path / "run", Watcher("turn", 8), ConsentingOperator())
    folder, _, _ = resumed(tmp_path / "run")
    (result,) = read_characteristics(folder.characteristics)
    assert len({row.run for row in read_dwells(folder.dwells)}) == 9
    assert result.notes == []
    assert [len(curve.x) for curve in result.curves] == [9, 9, 9]  # the killed one counts with its dwell
    scatter = named(result, "turn-on standard deviation")
    assert all(holds(each, 0.004) and 0.002 < each.value < 0.008 for each in scatter)
    recomputed = recompute_run(folder.path)
    assert read_characteristics(recomputed.characteristics) == [result]


def test_a_warm_up_is_found(job, tmp_path):
    folder, result = result_of(job(WARM_UP, [WARMING]), tmp_path / "run")
    for each, truth in zip(named(result, "first bias"), WARMING["bias_dph"], strict=True):
        assert holds(each, truth) or each.value == pytest.approx(truth, rel=0.12)  # self-heating adds to it
    for each, truth in zip(named(result, "time until"), WARMING["bias_dph"], strict=True):
        assert holds(each, 1800.0 * np.log(abs(truth) / 0.002))
    page = write_report(folder).path.read_text()
    assert "<h2" in page
    assert "Warm-up" in page
    assert (folder.figures / "warm_up.png").exists()


@pytest.mark.long
def test_sensitivities_to_temperature_its_rate_and_direction_are_found(job, tmp_path):
    _, result = result_of(job(THERMAL, [HYSTERESIS, RATE]), tmp_path / "run")
    truths = {
        "temperature": [1.2e-4, -9.0e-5, 7.0e-5],
        "ramp": [60.0 * each for each in RATE["sensitivity_dph_per_c_per_h"]],
        "hysteresis": [4.0 * each for each in HYSTERESIS["sensitivity_dph_per_c"]],
    }
    held = [
        holds(each, true)
        for start, truth in truths.items()
        for each, true in zip(named(result, start), truth, strict=True)
    ]
    assert len(held) == 9
    assert sum(held) >= 8  # of 95 % intervals one in twenty misses
    assert all(abs(each.value) > 0.004 for each in named(result, "hysteresis"))


@pytest.mark.long
def test_the_noise_coefficients_of_the_world_are_found_in_a_long_navigation(job, tmp_path):
    drift = {"kind": "time_drift", "drift_dph_per_day": [0.2, -0.2, 0.3]}
    gyro = {"bias_instability_dph": 0.002, "rate_random_walk_dph_per_sqrt_h": 0.004, "pulse_arcsec": 0.02}
    folder, result = result_of(job(NOISE, [drift], **gyro), tmp_path / "run")
    truths = {"angle": 0.0002, "bias": 0.002, "rate random": 0.004}
    held = [holds(each, truth) for start, truth in truths.items() for each in named(result, start)]
    ramps = zip(named(result, "rate ramp"), drift["drift_dph_per_day"], strict=True)
    held += [holds(each, per_day / 24.0) for each, per_day in ramps]
    assert len(held) == 12
    assert sum(held) >= 11  # of 95 % intervals one in twenty misses
    for each in named(result, "quantisation"):
        assert each.value == pytest.approx(0.02 / np.sqrt(12.0), rel=0.1)
    assert not folder.dwells.exists()


@pytest.mark.long
def test_drift_scatter_and_dependence_on_rate_of_the_scale_factors_are_found(job, tmp_path):
    gyro = {
        "scale_factor_ppm": {"x": 10.0, "y": -20.0, "z": 5.0},
        "scale_factor_repeatability_ppm": 3.0,
        "scale_factor_asymmetry_ppm": [0.0, 0.0, -3.0],
        "scale_factor_ppm_per_dps": [0.1, -0.1, 0.2],
    }
    effect = {"kind": "scale_factor_drift", **DRIFT}
    made = job(STABILITY, [effect], world="all_coefficients", station="emulated", **gyro)
    folder, _ = run_job(made, tmp_path / "run", Watcher(), ConsentingOperator())
    (result,) = read_characteristics(folder.characteristics)
    assert result.notes == []
    scatter = 0.0
    marks = finished_marks(folder)
    since_h = np.array([each.since_power_on_s for each in marks]) / 3600.0
    length_h = np.array([each.end_s - each.start_s for each in marks]) / 3600.0
    # Of the dwell's length: the middle of the spins of x, y and z.
    for axis, part in enumerate((0.55, 0.92, 0.08)):
        at_h = since_h + part * length_h
        swing = DRIFT["swing_ppm"][axis] * np.sin(2.0 * np.pi * at_h / DRIFT["period_h"])
        left = result.curves[axis].value - DRIFT["drift_ppm_per_h"][axis] * at_h - swing
        sigma = np.subtract(result.curves[axis].high, result.curves[axis].value)
        apart = np.reshape(left, (2, 3)) - np.reshape(left, (2, 3)).mean(axis=1, keepdims=True)
        scatter += float(np.sum(np.square(apart.ravel() / sigma)))
    assert scatter < chi2.ppf(0.999, 12)  # three values less their mean, of three gyros in two power cycles
    held = [holds(each, truth) for each, truth in zip(named(result, "worst asym"), (0, 0, 3.0), strict=True)]
    held += [
        holds(each, truth) for each, truth in zip(named(result, "worst non"), (0.5, 0.5, 1.0), strict=True)
    ]
    assert sum(held) >= 5  # of 95 % intervals one in twenty misses
    *_, whole = durations_by_kind(read_run(folder).step_durations)
    assert whole.actual_s == pytest.approx(whole.planned_s, rel=0.02)
    assert (write_report(folder).path.parent / "figures" / "scale_factor_stability.png").exists()
