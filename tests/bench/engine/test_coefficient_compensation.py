"""The loop is closed on a scale factor: found over CAN frames, compensated in the INS, and proved."""

import csv

import pytest
import yaml

from gyrobench.bench.foundations.documents import read_document
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.runs.compensation_file import read_compensation
from tests.bench.closure.campaigns import write_world
from tests.bench.command_line import gyrobench

pytestmark = [pytest.mark.long, pytest.mark.draws]

RATE_PPM = (0.5, -0.4, 0.3)
SCALE_FACTOR_PPM = {"x": [40.0, 0.3], "y": [-30.0, 0.2], "z": [25.0, -0.25]}


def station():
    """The quick station with an INS that sends increments."""
    quick, other = (read_document(find_document("stations", name)).data for name in ("quick", "emulated"))
    quick["ins"]["signals"]["increments"] = other["ins"]["signals"]["increments"]
    quick["ins"]["commands"]["send_increments"] = other["ins"]["commands"]["send_increments"]
    return quick


def plateau(on_ramp):
    """A dwell and 18 rotations, on a ramp or after it."""
    full = read_document(find_document("procedures", "full_calibration")).data
    [repeated] = [step["repeat"]["steps"] for step in full["steps"] if "repeat" in step]
    rotate = next(step["rotate"] for step in repeated if "rotate" in step) | {"rest_s": 25, "rate_dps": 30}
    ramp = {"temperature_c": "$temperature_c", "ramp_c_per_min": 0.6 if on_ramp else 5.0}
    navigate = {"navigate": {"duration_s": 60}}
    return [
        {"chamber": ramp | ({"within_c": 50} if on_ramp else {})},
        {"wait": {"duration_s": 600}} if on_ramp else {"soak": {"for_s": 900}},
        {"go_to": {"position": "z_up", "azimuth_deg": 0, "rate_dps": 30}},
        {"align": {"duration_s": 16}},
        navigate,
        {"turn": {"angle_deg": 180, "rate_dps": 30, "settle_s": 1}},
        navigate,
        {"go_to": {"position": "z_up", "azimuth_deg": 0, "rate_dps": 30}},
        {"align": {"duration_s": 16}},
        {"rotate": rotate},
    ]


def procedure(name, cycles, cold, upward, hot, downward):
    legs = [(cold, False), (upward, True), (hot, False), (downward, True)]
    return {
        "procedure": name,
        "steps": [
            {"power_on": {"settle_s": 60}},
            *(
                {
                    "repeat": {
                        "over": {"cycle": [cycle], "temperature_c": temperatures},
                        "steps": plateau(on_ramp),
                    }
                }
                for cycle in cycles
                for temperatures, on_ramp in legs
            ),
        ],
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A campaign on ramps and after soaks, in which the scale factors follow the rate of temperature."""
    folder = tmp_path_factory.mktemp("campaign")
    write_world(
        folder,
        [{"kind": "scale_factor_rate", "sensitivity_ppm_per_c_per_h": list(RATE_PPM)}],
        gyro={"scale_factor_ppm": SCALE_FACTOR_PPM},
        accelerometer={"bias_ug": {"x": 60.0, "y": -45.0, "z": 80.0}},
    )
    files = {
        "station": station(),
        "campaign": procedure("ramps", [1, 2], [-20, -8], [5, 20, 35, 50], [60, 55], [45, 30, 15, 0]),
        "one_cycle": procedure("one_cycle", [1], [-20, -8], [5, 20, 35, 50], [60, 55], [45, 30, 15, 0]),
        "proof": procedure("ramps_proof", [1], [-15], [12, 28], [52], [40, 25]),
    }
    for name, data in files.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
    measure(folder, "campaign.yaml", "run")
    return folder


def measure(folder, procedure, out):
    done = gyrobench(
        *("run", procedure, "--station", "station.yaml", "--world", "world.yaml"),
        *("--seed", "6", "--out", out, "--view", "lines"),
        cwd=folder,
    )
    assert done.returncode == 0, done.stderr


def remaining(run):
    """Rms of each coefficient by compensation, and coefficient with its axis."""
    rows = csv.DictReader((run / "verify/coefficient_comparison.csv").read_text().splitlines())
    return {(row["compensation"], row["coefficient"]): float(row["rms"]) for row in rows}


@pytest.fixture(scope="module")
def closed(folder):
    done = gyrobench("close", "run", "--coefficient", "gyro_scale_factor_x", cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_effect_is_found_with_its_true_size(folder, closed):
    assert closed.splitlines()[1].startswith("Explained.")
    model = yaml.safe_load((folder / "run/closure_gyro_scale_factor/model.yaml").read_text())
    [effect] = model["effects"]
    assert effect["effect"] == "temperature_rate"
    sizes = [effect["terms_ppm"][axis]["temperature rate, K/h"] for axis in "xyz"]
    assert sizes == pytest.approx(RATE_PPM, rel=0.05)


def test_it_is_compensated_over_can_and_proved_on_new_measurements(folder, closed):
    done = gyrobench(
        "verify", "run", "--coefficients", "--procedure", "proof.yaml", "--view", "lines", cwd=folder
    )
    assert done.returncode == 0, done.stderr
    loaded = read_compensation(folder / "run/verify/effect/compensation.yaml").coefficients
    assert loaded["gyro_scale_factor_x"].rate_per_c_per_h == pytest.approx(RATE_PPM[0], rel=0.05)
    assert len(loaded) == 18
    left = remaining(folder / "run")
    for axis in "xyz":
        none, declared, effect = (
            left[name, f"gyro_scale_factor_{axis}"] for name in ("none", "declared", "effect")
        )
        assert effect < 0.2 * declared < 0.2 * none
        assert (
            left["declared", f"accelerometer_bias_{axis}"] < 0.05 * left["none", f"accelerometer_bias_{axis}"]
        )
    missions = csv.DictReader((folder / "run/verify/mission.csv").read_text().splitlines())
    worst = {}
    for row in missions:
        if row["hours"] == "24":
            worst[row["compensation"]] = max(worst.get(row["compensation"], 0.0), float(row["position_nmi"]))
    assert worst["effect"] < worst["declared"] < worst["none"]
    page = (folder / "run/verify/verification.html").read_text()
    assert "A mission of a rotational INS" in page


def test_polynomials_of_one_cycle_are_proved_by_the_same_procedure_without_a_search(folder):
    measure(folder, "one_cycle.yaml", "one")
    done = gyrobench("verify", "one", "--coefficients", "--view", "lines", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert "Not searched. A search needs a second cycle" in done.stdout
    assert not (folder / "one/verify/effect").exists()
    left = remaining(folder / "one")
    for axis in "xyz":
        for name, share in (("gyro_scale_factor", 0.7), ("accelerometer_bias", 0.05)):
            assert left["declared", f"{name}_{axis}"] < share * left["none", f"{name}_{axis}"]


def test_an_accelerometer_bias_that_follows_attitude_is_found_with_its_true_size(tmp_path):
    arcsec = {"xy": 30.0, "xz": -25.0, "yx": 0.0, "yz": 28.0, "zx": 0.0, "zy": -32.0}
    write_world(tmp_path, accelerometer={"misalignment_arcsec": arcsec})
    done = gyrobench(
        *("run", "quick_campaign", "--station", "quick", "--world", "world.yaml"),
        *("--seed", "3", "--out", "run", "--view", "lines"),
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    done = gyrobench("close", "run", "--coefficient", "accelerometer_bias", cwd=tmp_path)
    assert done.stdout.splitlines()[1].startswith("Explained."), done.stdout
    model = yaml.safe_load((tmp_path / "run/closure_accelerometer_bias/model.yaml").read_text())
    [effect] = model["effects"]
    assert effect["effect"] == "g_sensitivity"
    for (sensor, sensed), true in arcsec.items():
        ug = effect["terms_ug"][sensor][f"Up along {sensed}"]
        assert ug == pytest.approx(true * 4.848, abs=3.0)
