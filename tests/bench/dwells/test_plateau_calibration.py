"""Coefficients over temperature from runs of the emulated bench, beside the declared truth of its world."""

import itertools
import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from scipy.signal import lfilter
from scipy.stats import chi2

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.calibration.coefficients import COEFFICIENTS, COUNT, CoefficientEstimate, SensorErrors
from gyrobench.bench.calibration.estimator import calibrate
from gyrobench.bench.dwells import dwell_output
from gyrobench.bench.dwells.measurement_setup import measurement_setup
from gyrobench.bench.dwells.plateau_calibration import (
    PlateauCalibration,
    calibrate_plateaus,
    with_temperature_change,
)
from gyrobench.bench.dwells.run_dwells import undisturbed_dwells
from gyrobench.bench.dwells.run_results import recompute_run
from gyrobench.bench.dwells.run_rotations import PlateauRotations, RunRotations
from gyrobench.bench.exchange.import_map import load_log_map
from gyrobench.bench.exchange.increments import calibration_settings, read_logs
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.report.coefficient_sections import coefficients_section
from gyrobench.bench.report.journal_sections import durations_by_kind
from gyrobench.bench.report.run_content import read_run
from gyrobench.bench.runs.tables.coefficient_table import COEFFICIENT_TABLE
from gyrobench.bench.station.station import Station
from gyrobench.drivers.emulators.world.sensor_errors import accelerometer_errors, gyro_errors
from gyrobench.drivers.emulators.world.world_file import load_world
from tests.bench.bias.emulated_groups import any_unit, joint_solution_of, measure

WORLD = "all_coefficients"
#: One in a thousand sound runs exceeds it.
MAX_QUANTILE = 0.999


def short_procedure(tmp_path, dwell=()):
    """Rotations and spins of full_calibration with shorter rests and without the slowest, after a dwell."""
    document = yaml.safe_load(find_document("procedures", "full_calibration").read_text())
    plateau = document["steps"][2]["repeat"]["steps"]
    first = next(i for i, step in enumerate(plateau) if "rotate" in step) - 2
    steps = [{"power_on": {"settle_s": 20}}, *dwell, *plateau[first:], "power_off"]
    for step in steps:
        if "rotate" in step:
            step["rotate"]["rest_s"] = 30
        if "spin" in step:
            step["spin"] |= {"rates_dps": [10, 20], "rest_s": 15}
    path = tmp_path / "short.yaml"
    path.write_text(yaml.safe_dump({"procedure": "short", "bin_width_c": 5, "steps": steps}))
    return path


def without_increments(tmp_path):
    """The emulated station as of an INS that sends neither increments nor rates."""
    document = yaml.safe_load(find_document("stations", "emulated").read_text())
    del document["ins"]["signals"]["increments"]
    del document["ins"]["commands"]["send_increments"]
    path = tmp_path / "station.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


def truth(gyro_c, case_c):
    """Coefficients of the world at temperatures (3,) of gyros and case."""
    world = load_world(find_document("worlds", WORLD))
    return SensorErrors(
        *gyro_errors(world.gyro).at(gyro_c - world.reference_temperature_c),
        *accelerometer_errors(world.accelerometer).at(case_c - world.reference_temperature_c),
    ).vector()


def deviations(rows):
    """Differences from the world's truth at the temperatures of the plateaus, in standard uncertainties."""
    found = []
    for _, plateau in itertools.groupby(rows, lambda row: row.plateau):
        by_name = {(row.coefficient, row.axis): row for row in plateau}
        gyro_c = np.array([by_name["gyro_bias", axis].temperature_c for axis in "xyz"])
        case_c = np.full(3, by_name["accelerometer_bias", "x"].temperature_c)
        for each, true in zip(COEFFICIENTS, truth(gyro_c, case_c), strict=True):
            row = by_name[each.name, each.axis]
            found.append((row.value - true * each.per_si) / row.sigma)
    return np.array(found)


def assert_consistent(rows, observed):
    away = deviations(rows)
    seen = away[np.isfinite(away)]
    assert len(seen) == observed
    assert seen @ seen < chi2.ppf(MAX_QUANTILE, observed)
    # Uncertainties that are too large would pass the bound above.
    assert seen @ seen > chi2.ppf(1.0 - MAX_QUANTILE, observed)


@pytest.fixture(scope="module")
def folder(run_procedure, tmp_path_factory):
    """Of a short run of the emulated station, whose INS sends increments."""
    procedure = short_procedure(tmp_path_factory.mktemp("p"))
    folder, outcome, _ = run_procedure(procedure, tmp_path_factory.mktemp("run"), WORLD)
    assert outcome.ended == "finished"
    return folder


@pytest.fixture(scope="module")
def setup(folder):
    return measurement_setup(Station(folder.station))


def test_rotations_give_every_coefficient_within_its_uncertainty(folder):
    rows = COEFFICIENT_TABLE.read(folder.coefficients)
    assert_consistent(rows, len(COEFFICIENTS))
    sigma = {(row.coefficient, row.axis): row.sigma for row in rows}
    assert max(sigma["gyro_scale_factor", axis] for axis in "xyz") < 0.2
    assert max(sigma["accelerometer_bias", axis] for axis in "xyz") < 1.0
    assert all(np.isnan(row.sigma_with_force) for row in rows)


def test_biases_that_follow_attitude_are_found_by_the_rotations_and_leave_the_other_coefficients_right(
    run_procedure, tmp_path
):
    world, warmed = (yaml.safe_load(find_document("worlds", each).read_text()) for each in (WORLD, "gyro_a"))
    [effect] = warmed["undeclared_effects"]
    strong = effect | {"sensitivity_dph_per_w": [0.4, -0.4, 0.4]}
    path = tmp_path / "world.yaml"
    path.write_text(yaml.safe_dump(world | {"thermal": warmed["thermal"], "undeclared_effects": [strong]}))
    one_position = [
        {"go_to": {"position": "z_up", "azimuth_deg": 0, "rate_dps": 10}},
        {"align": {"duration_s": 300}},
        {"navigate": {"duration_s": 300}},
        {"turn": {"angle_deg": 180, "rate_dps": 10, "settle_s": 5}},
        {"navigate": {"duration_s": 300}},
    ]
    procedure = short_procedure(tmp_path, one_position)
    folder, outcome, _ = run_procedure(procedure, tmp_path / "run", path)
    assert (outcome.ended, len(outcome.dwells)) == ("finished", 1)
    rows = COEFFICIENT_TABLE.read(folder.coefficients)
    assert all("follow the specific force" in row.note and row.finding == "" for row in rows)
    assert_consistent(rows, len(COEFFICIENTS))


def test_the_log_gives_the_coefficients_that_were_measured_during_the_run(folder, tmp_path):
    again = recompute_run(shutil.copytree(folder.path, tmp_path / "copy"))
    for one, other in zip(
        *(COEFFICIENT_TABLE.read(each.coefficients) for each in (folder, again)), strict=True
    ):
        assert other.value == pytest.approx(one.value, abs=1e-6 * one.sigma)
        assert other.sigma == pytest.approx(one.sigma, rel=1e-6)


def test_the_can_log_of_a_run_gives_the_coefficients_by_an_import_map(folder):
    log_map = load_log_map(find_document("imports", "emulated_ins"), for_calibration=True)
    paths = sorted(folder.can.glob("*.blf"))
    logs = read_logs(paths, log_map)
    assert [log.samples > 0 for log in logs] == [False, True, True]  # the first part ends with the alignment
    with pytest.raises(DocumentError, match=r"part-00001\.blf: has no frame of ANGLE_INCREMENT\. Choose"):
        read_logs(paths[:1], log_map)
    assert sum(log.left_out for log in logs) == 0
    site, options = calibration_settings(log_map)
    found = calibrate([recording for log in logs for recording in log.recordings], site, options)
    rows = {row.coefficient: row.temperature_c for row in COEFFICIENT_TABLE.read(folder.coefficients)}
    at_c = [np.full(3, rows[name]) for name in ("gyro_bias", "accelerometer_bias")]
    assert found.is_observed.all()  # and the asymmetry of the gyro with whole turns both ways, which is zero
    away = (found.values - [*truth(*at_c), 0.0, 0.0, 0.0]) / found.sigmas
    assert np.abs(away).max() < 4.0


def rotated_dwells(folder):
    return undisturbed_dwells(folder, DwellPurpose.ROTATIONS)


def calibrated(dwells, setup):
    rotations = RunRotations()
    for each in dwells:
        rotations.add(*each, setup)
    return rotations.calibrate(setup)


@pytest.mark.parametrize(
    ("axes", "names"),
    [((1, 2, 0), ("angle", "velocity")), ((1, 0, 2), ("angle",)), ((1, 0, 2), ("velocity",))],
)
def test_exchanged_axes_of_increments_give_no_coefficients(folder, setup, axes, names):
    def exchanged(frames):
        sent = setup.decode_increments(frames)
        return replace(sent, **{name: getattr(sent, name)[:, axes] for name in names})

    first = next(iter(rotated_dwells(folder)))
    [found] = calibrated([first], replace(setup, decode_increments=exchanged))
    assert found.calibration is None
    assert "Check axes, signs and units of ins.signals.increments" in found.finding


@pytest.mark.parametrize("name", ["angle", "velocity"])
def test_a_scale_of_the_increments_that_attitude_and_velocity_contradict_is_refused_or_noted(
    folder, setup, name
):
    dwells = list(rotated_dwells(folder))

    def scaled(factor):
        def decode(frames):
            sent = setup.decode_increments(frames)
            return replace(sent, **{name: factor * getattr(sent, name)})

        return replace(setup, decode_increments=decode)

    def noted(factor):
        rotations = calibrated(dwells, scaled(factor))
        [plateau] = calibrate_plateaus([], [], rotations, setup)
        return plateau.note

    [found] = calibrated(dwells[:1], scaled(1.024))
    assert "Check axes, signs and units of ins.signals.increments" in found.finding
    sensor = {"angle": "gyro", "velocity": "accelerometer"}[name]
    assert f"all {sensor} scale factors are about +2" in noted(1.002)
    assert "scale factors" not in noted(1.0)


def _late(values, samples):
    return np.vstack([np.repeat(values[:1], samples, axis=0), values[:-samples]])


def _filtered(values, interval_s, time_constant_s=0.1):
    keep = np.exp(-interval_s / time_constant_s)
    return lfilter([1.0 - keep], [1.0, -keep], values - values[0], axis=0) + values[0]


@pytest.mark.long
@pytest.mark.parametrize(
    ("sent", "table", "text"),
    [
        (
            lambda each: {"velocity": _late(each.velocity, 1)},
            None,
            "A delay of the accelerometers (gyrobench calibrate --delay)",
        ),
        (
            lambda each: {k: _filtered(getattr(each, k), each.interval_s) for k in ("angle", "velocity")},
            None,
            "times the noise",
        ),
        (lambda each: {k: _late(getattr(each, k), 10) for k in ("angle", "velocity")}, None, ""),
        (None, lambda outer, inner: (1.001 * outer, 1.001 * inner), "whole turns contradict the rotations"),
        (None, lambda outer, inner: (inner, outer), ""),
    ],
    ids=["velocity late", "increments filtered", "increments late", "encoders' scale", "axes exchanged"],
)
def test_wrong_rotations_are_stated_or_leave_the_coefficients_right(folder, setup, sent, table, text):
    right, [plateau] = list(rotated_dwells(folder)), calibrated(rotated_dwells(folder), setup)

    def decode(frames):
        found = setup.decode_increments(frames)
        return replace(found, **sent(found)) if sent else found

    def read(mark):
        outer, inner = table(mark.outer_deg, mark.inner_deg) if table else (mark.outer_deg, mark.inner_deg)
        return replace(mark, outer_deg=outer, inner_deg=inner)

    wrong = [(replace(marks, windows=tuple(map(read, marks.windows))), frames) for marks, frames in right]
    [found] = calibrated(wrong, replace(setup, decode_increments=decode))
    findings = " ".join(found.findings)
    assert text in findings
    assert bool(text) == bool(findings)
    if found.calibration is not None:
        away = (found.calibration.values - plateau.calibration.values) / found.calibration.sigmas
        assert np.abs(away).max() < 3.0


@pytest.mark.parametrize("period_s", [0.009, 0.01, 0.02])
def test_rotations_give_no_coefficients_with_a_wrong_period_of_the_increments(folder, setup, period_s):
    def declared(frames):
        return replace(setup.decode_increments(frames), interval_s=period_s)

    [found] = calibrated([next(iter(rotated_dwells(folder)))], replace(setup, decode_increments=declared))
    is_wrong = "period_s is" in found.finding
    assert is_wrong == (found.calibration is None) == (period_s != 0.01)


def test_navigation_output_that_is_rounded_counts_with_its_rounding(folder, setup):
    coarse = replace(setup, decode_increments=lambda _: None, heading_lsb_rad=8e-5, velocity_lsb_mps=0.01)
    [found] = calibrated([next(iter(rotated_dwells(folder)))], coarse)
    assert found.calibration.problem.noise.white_angle == pytest.approx(8e-5 / np.sqrt(12.0))
    assert (found.calibration.problem.noise.white_velocity >= 0.01 / np.sqrt(12.0)).all()


def test_a_temperature_that_changes_within_the_plateau_adds_the_slope_between_plateaus_times_its_range():
    slopes = np.linspace(-1.0, 1.0, COUNT) * 1e-6  # per K

    def plateau(number, temperature_c, change_c):
        estimate = CoefficientEstimate(slopes * temperature_c, 1e-16 * np.eye(COUNT), np.ones(COUNT, bool))
        around_c = np.full((2, 4), temperature_c) + 0.5 * change_c * np.array([[-1.0], [1.0]])
        at_c = (temperature_c,) * 3
        variances = {"dwells": np.ones(COUNT)}
        return PlateauCalibration(
            number, 1, temperature_c, at_c, temperature_c, estimate, variances, range_c=around_c
        )

    plateaus = [plateau(1, 60.0, 1.5), plateau(2, 25.0, 0.0), plateau(3, -35.0, 0.5)]
    for found, change_c in zip(with_temperature_change(plateaus), (1.5, 0.0, 0.5), strict=True):
        added = np.diag(found.estimate.covariance) - 1e-16
        assert found.variances["temperature_change"] == pytest.approx(added, abs=1e-25)
        assert added == pytest.approx((slopes * change_c) ** 2 / 12.0, abs=1e-25)
    [alone] = with_temperature_change(plateaus[:1])
    assert not alone.variances["temperature_change"].any()
    poor = replace(plateaus[1].estimate, covariance=np.eye(COUNT))
    known, _, _ = with_temperature_change([plateaus[0], replace(plateaus[1], estimate=poor), plateaus[0]])
    assert not known.variances["temperature_change"].any()  # noise shows no slope


def test_rotations_on_the_ramp_and_after_the_soak_of_one_set_point_are_two_plateaus(run_procedure, tmp_path):
    rotations = [{"axis": axis, "angle_deg": angle} for axis in ("outer", "inner") for angle in (90, -90)]
    rotated_once = [
        {"go_to": {"position": "z_up", "rate_dps": 10}},
        {"align": {"duration_s": 120}},
        {"rotate": {"rest_s": 60, "rate_dps": 10, "rotations": rotations}},
    ]
    steps = [
        {"power_on": {"settle_s": 20}},
        {"chamber": {"temperature_c": 32, "ramp_c_per_min": 1.0, "within_c": 50}},
        *rotated_once,
        {"soak": {"until_gyro_rate_below_c_per_h": 2, "at_least_s": 1800, "at_most_s": 14400}},
        *rotated_once,
        *rotated_once,
        "power_off",
        "chamber_off",
    ]
    path = tmp_path / "ramp.yaml"
    path.write_text(yaml.safe_dump({"procedure": "ramp", "bin_width_c": 5, "steps": steps}))
    folder, _, _ = run_procedure(path, tmp_path / "run", WORLD)
    rows = [row for row in COEFFICIENT_TABLE.read(folder.coefficients) if row.coefficient == "gyro_bias"]
    rates = {row.plateau: row.gyro_rate_c_per_h for row in rows if row.axis == "x"}
    assert list(rates) == [1, 2]
    assert rates[1] > 5.0
    assert abs(rates[2]) < 2.0


def test_a_latitude_that_contradicts_the_rotations_is_named_while_the_run_goes_and_in_its_report(
    folder, setup, monkeypatch
):
    monkeypatch.setattr(dwell_output, "latitude_fault", lambda *_: "")  # of an INS that sends no latitude
    wrong = replace(setup, site=replace(setup.site, latitude=setup.site.latitude + np.deg2rad(0.1)))
    rotations = RunRotations()
    measured = list(rotated_dwells(folder))
    said = [text for each in measured for text in rotations.add(*each, wrong)]
    plateaus = calibrate_plateaus([], [], rotations.calibrate(wrong), wrong)
    for plateau in plateaus:
        assert "rotations: noise does not explain the velocity at rest" in plateau.finding
    (first, *_), rows = said or [plateaus[0].finding], plateaus[0].rows()
    assert "noise does not explain the velocity at rest" in first
    assert any("noise does not explain" in text for text in coefficients_section(rows).paragraphs)


def test_a_contradiction_of_dwells_and_rotations_is_corrected_for_the_number_of_plateaus(folder, setup):
    [rotations] = calibrated(rotated_dwells(folder), setup)
    others = [replace(rotations, marks=replace(rotations.marks, cycle=cycle)) for cycle in (1, 2)]
    solutions, rows = [], []
    for cycle in (1, 2):
        same = {"run": rotations.marks.run, "cycle": cycle, "gyro_c": rotations.gyro_c}
        dwells = measure(any_unit(np.random.default_rng(1)), None, ("z_up", "z_down"), first=10 * cycle)
        same["chamber_set_c"] = rotations.marks.chamber_set_c
        solutions.append(joint_solution_of([replace(each, **same) for each in dwells], setup.prior))
        rows += [
            SimpleNamespace(
                dwell=each.number,
                gyro_c=rotations.gyro_c,
                gyro_rate_c_per_h=rotations.gyro_rate_c_per_h,
                case_c=rotations.case_c,
                start_s=0.0,
            )
            for each in dwells
        ]
    for count, ending in ((1, r"p = \S+\)$"), (2, r"p = \S+, corrected for 2 plateaus\)$")):
        for plateau in calibrate_plateaus(solutions[:count], rows, others[:count], setup):
            assert re.search(f"dwells and rotations contradict each other .{ending}", plateau.finding)


def test_biases_that_follow_attitude_in_the_dwells_and_not_in_the_rotations_are_a_finding(folder, setup):
    [rotations] = calibrated(rotated_dwells(folder), setup)
    same = {each: getattr(rotations, each) for each in ("gyro_c", "case_c", "gyro_rate_c_per_h")}
    marks = {each: getattr(rotations.marks, each) for each in ("run", "cycle", "chamber_set_c")}
    random, sensitivities, sigmas = np.random.default_rng(3), 0.01 * np.eye(3)[[1, 2, 0]], []
    for follows in (False, True):
        unit = any_unit(random)
        for name, position in POSITIONS.items():
            unit.bias_dph[name] = follows * sensitivities @ position.C_nb()[2]
        dwells = [replace(each, gyro_c=rotations.gyro_c, **marks) for each in measure(unit, random)]
        rows = [SimpleNamespace(dwell=each.number, start_s=1600.0 * each.number, **same) for each in dwells]
        solution = joint_solution_of(dwells, setup.prior)
        [plateau] = calibrate_plateaus([solution], rows, [rotations], setup)
        assert ("follow the attitude in the dwells" in plateau.finding) == follows
        sigmas.append(plateau.estimate.sigmas[:3])
    # With the finding, the gyro biases are those of the dwells alone; the short rests add little to them.
    assert (sigmas[1] > 1.01 * sigmas[0]).all()


def test_rotations_that_give_nothing_are_a_section_that_states_why(folder, setup):
    marks, _ = next(iter(rotated_dwells(folder)))
    nothing = PlateauRotations(marks, finding="the rotations give no coefficients: check axes")
    [plateau] = calibrate_plateaus([], [], [nothing], setup)
    section = coefficients_section(plateau.rows())
    assert section.paragraphs == [
        "The rotations of this run give no coefficients.",
        "Plateau 1: the rotations give no coefficients: check axes.",
    ]
    assert not section.tables


def test_report_has_table_and_figure_of_the_coefficients(folder):
    section = coefficients_section(read_run(folder).coefficients)
    assert len(section.tables[0].rows) == len(COEFFICIENTS)
    assert [each.name for each in section.figures] == ["coefficients"]


def test_an_ins_without_specific_force_leaves_the_accelerometers_scale_factors_open(
    run_procedure, tmp_path_factory
):
    tmp_path = tmp_path_factory.mktemp("without")
    folder, _, _ = run_procedure(
        short_procedure(tmp_path), tmp_path / "run", WORLD, 3, without_increments(tmp_path)
    )
    rows = COEFFICIENT_TABLE.read(folder.coefficients)
    open_ones = [(row.coefficient, row.axis) for row in rows if row.finding == "not observable"]
    assert open_ones == [("accelerometer_scale_factor", axis) for axis in "xyz"]
    assert "Not observable (–): accel. scale factor x, y, z." in coefficients_section(rows).paragraphs
    assert_consistent(rows, len(COEFFICIENTS) - 3)
    # Vertical accelerometers have quadratic terms beside their biases: the force adds scale factors alone.
    with_force = {f"{row.coefficient}_{row.axis}": row.sigma_with_force / row.sigma for row in rows}
    assert 0.9 < with_force["accelerometer_bias_z"] < 1.0
    assert all(row.sigma_with_force < 40.0 for row in rows if row.coefficient == "accelerometer_scale_factor")


def test_a_plateau_of_the_full_calibration_takes_less_than_five_hours():
    document, procedure = load_procedure(find_document("procedures", "full_calibration"))
    plan = Station(find_document("stations", "emulated")).plan(document, procedure)
    measuring = [step for step in plan.steps if step.step.name not in ("chamber", "soak", "power_on")]
    per_plateau = {}
    for step in measuring:
        set_point_c = step.before.set_point_c
        per_plateau[set_point_c] = per_plateau.get(set_point_c, 0.0) + step.duration_s / 3600.0
    assert 3.0 < max(per_plateau.values()) < 5.0


@pytest.mark.long
def test_full_calibration_agrees_with_the_truth_at_each_temperature(run_procedure, tmp_path):
    folder, _, _ = run_procedure("full_calibration", tmp_path / "run", WORLD, 5)
    rows = COEFFICIENT_TABLE.read(folder.coefficients)
    assert len({row.plateau for row in rows}) == 4
    assert_consistent(rows, 4 * len(COEFFICIENTS))
    *_, whole = durations_by_kind(read_run(folder).step_durations)
    assert abs(whole.actual_s / whole.planned_s - 1.0) < 0.02
