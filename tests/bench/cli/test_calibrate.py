"""Coefficients from a log of rates or increments."""

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.error_model import Site
from tests.bench.calibration.rotated_unit import EIGHTEEN, Noise, Unit
from tests.bench.command_line import gyrobench, output_of, refusal_of

LN100 = Path(__file__).parents[4] / "shared" / "data" / "ln100"
MAP = """
unit: "7"
text: {separator: comma}
time: {column: t, unit: ms}
gyro: {unit: GYRO, x: gx, y: {column: gy, sign: -1}, z: gz}
calibration:
  accelerometers: {unit: FORCE, x: ax, y: ay, z: {column: az, sign: -1}}
  latitude_deg: 45
  clock_sigma_ppm: CLOCK
"""


def unit(**changes):
    return Unit(
        **{
            "rotations": EIGHTEEN[:9],
            "dwell_s": 40.0,
            "sample_hz": 20.0,
            "gravity": Site(np.deg2rad(45.0)).gravity,
            "gyro_matrix": np.diag([50e-6, -30e-6, 20e-6]),
            "force_bias": np.array([5e-4, -3e-4, 2e-4]),
        }
        | changes
    )


def write_log(folder, unit, gyro="urad", force="m/s", clock_ppm="0", noise=None):
    """A log with y gyro and z accelerometer upside down, and its map."""
    dt = 1.0 / unit.sample_hz
    angle, velocity = (noise or Noise()).added(*unit.increments(), dt, np.random.default_rng(2))
    angle *= {"urad": 1e6, "deg/s": 180.0 / np.pi / dt}[gyro]
    velocity *= {"m/s": 1.0, "mg": 1e3 / 9.80665 / dt}[force]
    time_ms = 1000.0 * dt * np.arange(1, len(angle) + 1)
    columns = np.column_stack([time_ms, angle * [1, -1, 1], velocity * [1, 1, -1]])
    np.savetxt(folder / "log.csv", columns, "%.12g", ",", header="t,gx,gy,gz,ax,ay,az", comments="")
    text = MAP.replace("GYRO", gyro).replace("FORCE", force).replace("CLOCK", clock_ppm)
    (folder / "map.yaml").write_text(text)


@pytest.mark.parametrize("units", [("urad", "m/s"), ("deg/s", "mg")])
def test_a_log_gives_a_table_of_coefficients_with_their_uncertainties(tmp_path, units):
    write_log(tmp_path, unit(), *units)
    output = output_of("calibrate", "log.csv", "--map", "map.yaml", "--out", "found", cwd=tmp_path)
    printed = " ".join(output.split())
    assert "10 rests and 9 rotations" in printed
    assert "z up at the start, then first turned about x by +90 deg, z by +90 deg and z by +90 deg" in printed
    with (tmp_path / "found/coefficients.csv").open() as table:
        rows = {(row["coefficient"], row["axis"]): row for row in csv.DictReader(table)}
    assert len(rows) == 21
    for axis, ppm in zip("xyz", (50.0, -30.0, 20.0), strict=True):
        row = rows["gyro_scale_factor", axis]
        assert row["unit"] == "ppm"
        assert abs(float(row["value"]) - ppm) < 4.0 * float(row["sigma"]) < 20.0
    row = rows["accelerometer_bias", "x"]
    assert abs(float(row["value"]) - 5e-4 / 9.80665e-6) < 4.0 * float(row["sigma"])
    with (tmp_path / "found/correlations.csv").open() as table:
        correlations = list(csv.DictReader(table))
    assert [float(row[row["coefficient"]]) for row in correlations] == [1.0] * 21
    record = json.loads((tmp_path / "found/calibration.json").read_text())
    assert record["fit"]["p_value"] > 1e-4
    assert record["gravity_sigma_mps2"] == 3e-4
    assert float(rows["accelerometer_scale_factor", "z"]["sigma"]) > 30.0
    assert "31 ppm of the accelerometer scale factors" in " ".join(output.split())


def test_the_deflection_of_the_vertical_is_in_the_uncertainty_of_the_gyro_biases(tmp_path):
    write_log(tmp_path, unit())
    command, text = ("calibrate", "log.csv", "--map", "map.yaml"), (tmp_path / "map.yaml").read_text()
    variances = []
    for line in ("  latitude_uncertainty_arcmin: 0\n", "", "  latitude_uncertainty_arcmin: 3.3\n"):
        (tmp_path / "map.yaml").write_text(text + line)
        rows = json.loads(gyrobench(*command, "--json", cwd=tmp_path).stdout)["coefficients"]
        variances.append(np.array([row["sigma"] for row in rows if row["coefficient"] == "gyro_bias"]) ** 2)
    added = variances[1:] - variances[0]
    np.testing.assert_allclose(added[1], 100.0 * added[0], rtol=1e-3)
    # All of them see the rate North or Up at times: 1 arcmin is 0.003 deg/h of either at 45 deg.
    assert 0.33 * 0.001 < np.sqrt(added[0]).max() < 0.33 * 0.005
    printed = " ".join(gyrobench(*command, cwd=tmp_path).stdout.split())
    assert "Latitude ± 3.3 arcmin: up to 0.0" in printed


def test_gravity_that_is_stated_to_be_known_without_its_value_is_doubted(tmp_path):
    write_log(tmp_path, unit())
    with (tmp_path / "map.yaml").open("a") as file:
        file.write("  gravity_uncertainty_mps2: 1e-6\n")
    output = output_of("calibrate", "log.csv", "--map", "map.yaml", "--out", "found", cwd=tmp_path)
    assert "Warning: gravity_uncertainty_mps2 is 1e-06 without gravity_mps2." in " ".join(output.split())
    (warning,) = json.loads((tmp_path / "found/calibration.json").read_text())["warnings"]
    assert "Normal gravity, used then, differs" in warning


def test_the_body_frame_may_be_that_of_the_gyros(tmp_path):
    write_log(tmp_path, unit())
    command = ("calibrate", "log.csv", "--map", "map.yaml", "--body-frame", "gyros")
    record = json.loads(gyrobench(*command, "--json", cwd=tmp_path).stdout)
    assert record["body_frame"] == "gyros"
    names = [row["coefficient"] for row in record["coefficients"]]
    assert (names.count("gyro_misalignment"), names.count("accelerometer_misalignment")) == (3, 6)
    for row in record["coefficients"]:
        assert row["sigma"] > 0.0
        if "misalignment" in row["coefficient"]:
            assert abs(row["value"]) < 4.0 * row["sigma"] < 20.0
    assert "in the body frame of the gyros" in gyrobench(*command, cwd=tmp_path).stdout


def test_spins_against_the_table_are_listed_with_linearity_and_asymmetry(tmp_path):
    spins = [("inner", sign * 3600.0, rate) for rate in (30.0, 90.0) for sign in (1.0, -1.0)]
    write_log(tmp_path, unit(rotations=(*EIGHTEEN[:6], *spins)))
    with (tmp_path / "map.yaml").open("a") as file:
        file.write("  whole_turns_arcsec: 1\n")
    command = ("calibrate", "log.csv", "--map", "map.yaml")
    (spun,) = json.loads(gyrobench(*command, "--json", cwd=tmp_path).stdout)["spins"]
    assert [round(each["rate_dps"]) for each in spun["spins"]] == [30, -30, 90, -90]
    assert abs(spun["scale_factor_ppm"] - 20.0) < 4.0 * spun["sigma_ppm"] < 0.5
    text = " ".join(gyrobench(*command, cwd=tmp_path).stdout.split())
    assert "4 spins at 30 and 90 deg/s: 20." in text
    assert "asymmetry" in text


@pytest.mark.parametrize(
    ("wrong", "common_ppm"), [("gravity_mps2: 9.8\n  gravity_sigma_mps2: 0.1", "+6"), ("height_m: 700", "+2")]
)
def test_scale_factors_that_all_sensors_share_are_named(tmp_path, wrong, common_ppm):
    write_log(tmp_path, unit())
    text = (tmp_path / "map.yaml").read_text()
    (tmp_path / "map.yaml").write_text(f"{text}  {wrong}\n")
    result = gyrobench("calibrate", "log.csv", "--map", "map.yaml", cwd=tmp_path)
    printed = " ".join(result.stdout.split())
    assert f"all accelerometer scale factors are about {common_ppm}" in printed
    assert "a height (3.2 m a ppm)" in printed


def test_what_an_asymmetry_would_do_that_is_not_estimated_is_stated(tmp_path):
    write_log(tmp_path, unit(rotations=((("outer", 90.0), ("outer", -90.0)) * 3 + EIGHTEEN[:9])))
    command = ("calibrate", "log.csv", "--map", "map.yaml")
    text, estimated = (
        " ".join(gyrobench(*command, *options, cwd=tmp_path).stdout.split())
        for options in ([], ["--asymmetry"])
    )
    assert "not estimated for all gyros: 1 ppm would move a gyro bias by up to 0.0" in text
    assert "1 ppm would move" not in estimated


@pytest.mark.parametrize(("white_angle", "is_stated"), [(60e-6, True), (2e-6, False)])
def test_what_vibration_between_samples_may_do_to_the_biases_is_stated(tmp_path, white_angle, is_stated):
    write_log(tmp_path, unit(), noise=Noise(white_angle=white_angle))
    with (tmp_path / "map.yaml").open("a") as file:
        file.write(
            "  noise: {angle_random_walk_deg_per_sqrt_h: 6e-4, velocity_random_walk_ug_per_sqrt_hz: 5}\n"
        )
    result = gyrobench("calibrate", "log.csv", "--map", "map.yaml", cwd=tmp_path)
    text = " ".join(result.stdout.split())
    assert result.returncode == 0
    assert ("coning between samples may pass for a bias" in text) == is_stated


def test_a_misfit_is_stated_once_and_its_test_names_where(tmp_path):
    write_log(tmp_path, unit())
    text = (tmp_path / "map.yaml").read_text()
    (tmp_path / "map.yaml").write_text(text.replace("latitude_deg: 45", "latitude_deg: 44.9"))
    answer = gyrobench("calibrate", "log.csv", "--map", "map.yaml", cwd=tmp_path)
    text = " ".join(answer.stdout.split())
    assert text.count("noise does not explain") == text.count("multiplied by") == 1
    assert re.search(r"Fit chi2 \d+ for \d+ degrees of freedom, p \S+: see Check", text)


def test_what_the_data_leave_open_is_no_number(tmp_path):
    write_log(tmp_path, unit(rotations=(), dwell_s=200.0))
    result = gyrobench("calibrate", "log.csv", "--map", "map.yaml", "--json", cwd=tmp_path)
    record = json.loads(result.stdout)
    assert {row["finding"] for row in record["coefficients"]} == {"not observable"}
    assert {row["value"] for row in record["coefficients"]} == {None}
    (rest,) = record["rests"]
    assert abs(rest["rate_dph"] - 15.041) < 0.1
    assert abs(rest["up_rate_dph"] - record["earth_rate_up_dph"]) < 4.0 * rest["up_sigma_dph"] + 0.001
    text = gyrobench("calibrate", "log.csv", "--map", "map.yaml", cwd=tmp_path).stdout
    assert "the unit was not turned" in " ".join(text.split())


def test_quiet_stretches_of_a_disturbed_record_give_the_earth_rate(tmp_path):
    write_log(tmp_path, unit(rotations=(), dwell_s=1847.0))
    table = np.loadtxt(tmp_path / "log.csv", delimiter=",", skiprows=1)
    for begin, column in ((8000, 1), (15000, 2), (27000, 3)):
        table[begin : begin + 600, column] += 300.0 * np.sin(0.9 * np.arange(600))
    np.savetxt(tmp_path / "log.csv", table, "%.12g", ",", header="t,gx,gy,gz,ax,ay,az", comments="")
    record = json.loads(gyrobench("calibrate", "log.csv", "--map", "map.yaml", "--json", cwd=tmp_path).stdout)
    assert [turn["kind"] for turn in record["rotations"]] == ["disturbance"] * 3
    assert len(record["rests"]) == 4
    assert sum(rest["duration_s"] for rest in record["rests"]) > 1847.0 - 3 * 35.0
    for rest in record["rests"]:
        assert abs(rest["up_rate_dph"] - record["earth_rate_up_dph"]) < 4.0 * rest["up_sigma_dph"] + 0.001
    walk = np.array(record["noise"]["angle_random_walk_deg_per_sqrt_h"])
    assert walk == pytest.approx(0.0006, rel=0.3)


def test_a_log_of_another_format_than_the_map_has_is_named(tmp_path):
    (tmp_path / "part-00001.blf").write_bytes(b"LOGG" + bytes(500))
    problem = refusal_of("calibrate", "part-00001.blf", "--map", "ln100", cwd=tmp_path)
    assert "is a log of format blf, which the import map reads as text or records" in problem
    (tmp_path / "log.blf").write_bytes(b"PAR1" + bytes(500))
    result = gyrobench("calibrate", "log.blf", "--map", "emulated_ins", cwd=tmp_path)
    assert "format parquet, which the import map reads as 'signals: {format: blf}'" in result.stderr


@pytest.mark.parametrize("recorded", ["time,x,y,z\n0,1,2,3\n", "\ufefftime;x;y;z °/s\n0;1;2;3\n"])
def test_a_text_log_with_a_map_of_can_logs_is_named_as_such(recorded, tmp_path):
    (tmp_path / "log.csv").write_text(recorded, encoding="utf-8")
    problem = refusal_of("calibrate", "log.csv", "--map", "emulated_ins", cwd=tmp_path)
    assert "is a log of format text, which the import map reads as 'signals: {format: blf}'" in problem


def test_a_folder_or_a_log_that_is_not_there_is_named_with_what_to_give(tmp_path):
    (tmp_path / "run/can").mkdir(parents=True)
    for log, text in (("run", "Give its log files, as run/can/*.blf"), ("none.blf", "there is no such file")):
        assert text in refusal_of("calibrate", log, "--map", "emulated_ins", cwd=tmp_path)


def test_missing_samples_divide_the_log(tmp_path):
    write_log(tmp_path, unit(rotations=(), dwell_s=200.0))
    lines = (tmp_path / "log.csv").read_text().splitlines()
    del lines[2000:2010]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    record = json.loads(gyrobench("calibrate", "log.csv", "--map", "map.yaml", "--json", cwd=tmp_path).stdout)
    assert [round(rest["duration_s"]) for rest in record["rests"]] == [100, 100]


def test_a_map_of_increments_or_without_windows_is_not_imported(tmp_path):
    write_log(tmp_path, unit(rotations=(), dwell_s=100.0))
    problem = refusal_of("import", "log.csv", "--map", "map.yaml", cwd=tmp_path)
    assert "lacks 'temperatures', 'position', 'window_s'" in " ".join(problem.split())


def test_a_map_without_accelerometers_is_refused_with_the_missing_section(tmp_path):
    write_log(tmp_path, unit(rotations=(), dwell_s=100.0))
    problem = refusal_of("calibrate", "log.csv", "--map", "tofupilot_imu", cwd=tmp_path)
    assert "has no section 'calibration'" in " ".join(problem.split())


@pytest.mark.skipif(not LN100.exists(), reason="the measured LN100 records are not beside the checkout")
def test_a_measured_pair_at_rest_gives_the_earth_rate_and_says_what_it_does_not_show(tmp_path):
    logs = [LN100 / f"x_LN100_{name}.ins" for name in ("down", "up")]
    record = json.loads(gyrobench("calibrate", *logs, "--map", "ln100", "--json", cwd=tmp_path).stdout)
    down, up = record["rests"]
    half_sum = 0.5 * (down["up_rate_dph"] + up["up_rate_dph"])
    assert abs(half_sum - record["earth_rate_up_dph"]) < 3.0 * up["up_sigma_dph"]
    assert all(row["finding"] for row in record["coefficients"] if row["coefficient"] == "gyro_scale_factor")
    assert record["fit"]["p_value"] > 1e-3


def test_plan_proposes_a_list_that_reaches_given_uncertainties(tmp_path):
    reach = "accelerometer_bias_ug=20"
    command = ("plan", "nineteen_positions", "--observability", "--reach", reach, "--json")
    record = json.loads(gyrobench(*command, cwd=tmp_path).stdout)
    reached = [row["sigma"] for row in record["coefficients"] if row["coefficient"] == "accelerometer_bias"]
    assert max(reached) <= 20.0
    again = gyrobench("plan", record["file"], "--observability", "--json", cwd=tmp_path)
    assert json.loads(again.stdout)["duration_s"] == record["duration_s"] < 2000.0


def test_plan_shows_what_a_list_of_rotations_will_show(tmp_path):
    printed = output_of("plan", "outer_axis", "--observability", cwd=tmp_path)
    assert "outer_axis: 8 rotations in 24 min" in printed
    assert "not observable" in printed
    document = yaml.safe_load(find_document("stations", "emulated").read_text())
    del document["ins"]["signals"]["increments"], document["ins"]["commands"]["send_increments"]
    (tmp_path / "station.yaml").write_text(yaml.safe_dump(document))
    command = ("plan", "outer_axis", "--observability", "--station", "station.yaml", "--json")
    record = json.loads(gyrobench(*command, cwd=tmp_path).stdout)
    sigmas = {(row["coefficient"], row["axis"]): row["sigma"] for row in record["coefficients"]}
    assert sigmas["accelerometer_scale_factor", "x"] is None
    assert sigmas["gyro_scale_factor", "x"] < 0.6
    assert sigmas["gyro_scale_factor", "z"] is None
    text = " ".join(printed.split())
    assert "Included: gravity 1e-06 m/s^2, latitude 0.02 arcmin" in text
    problem = refusal_of("plan", "outer_axi", "--observability", cwd=tmp_path)
    assert "Shipped rotations: eighteen_rotations" in " ".join(problem.split())


@pytest.mark.parametrize(
    ("gyro", "force", "sensors"),
    [
        ("urad", "m/s", ["accelerometer"]),
        ("deg/s", "mg", ["gyro"]),
        ("deg/s", "m/s", ["gyro", "accelerometer"]),
    ],
)
def test_the_clock_of_the_log_is_part_of_the_scale_factors_uncertainty(tmp_path, gyro, force, sensors):
    write_log(tmp_path, unit(), gyro, force, "29")
    command = ("calibrate", "log.csv", "--map", "map.yaml")
    rows = json.loads(gyrobench(*command, "--json", cwd=tmp_path).stdout)["coefficients"]
    wide = {row["coefficient"] for row in rows if row["unit"] == "ppm" and 29.0 < row["sigma"] < 50.0}
    narrow = {row["coefficient"] for row in rows if row["unit"] == "ppm" and row["sigma"] < 29.0}
    assert {f"{sensor}_scale_factor" for sensor in sensors} <= wide
    assert not wide & narrow
    text = " ".join(gyrobench(*command, cwd=tmp_path).stdout.split())
    assert f"29 ppm of the {sensors[0]} scale factors" in text


def test_a_log_counts_once(tmp_path):
    write_log(tmp_path, unit())
    (tmp_path / "copy.csv").write_bytes((tmp_path / "log.csv").read_bytes())
    problem = refusal_of("calibrate", "log.csv", "copy.csv", "--map", "map.yaml", cwd=tmp_path)
    assert "two logs have the same content" in " ".join(problem.split())


def test_whole_turns_that_are_not_there_are_named(tmp_path):
    write_log(tmp_path, unit())
    with (tmp_path / "map.yaml").open("a") as file:
        file.write("  whole_turns_arcsec: 1\n")
    text = gyrobench("calibrate", "log.csv", "--map", "map.yaml", cwd=tmp_path).stdout
    assert "Spins none found" in " ".join(text.split())
