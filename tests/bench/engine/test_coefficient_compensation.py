"""The loop is closed on a scale factor: found over CAN frames, compensated in the INS, and proved."""

import csv

import pytest
import yaml

from gyrobench.bench.foundations.documents import read_document
from gyrobench.bench.foundations.shipped import find_document
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.runs.compensation_file import read_compensation
from tests.bench.closure.campaigns import write_world
from tests.bench.command_line import gyrobench

pytestmark = [pytest.mark.long, pytest.mark.draws]

RATE_PPM = (0.5, -0.4, 0.3)
#: Of each accelerometer to Up along x, y and z at 25 degC, and its relative change.
UG_PER_G, PER_C = [[0.0, 150.0, -120.0], [0.0, 0.0, 140.0], [0.0, -160.0, 0.0]], 0.01
SCALE_FACTOR_PPM = {"x": [40.0, 0.3], "y": [-30.0, 0.2], "z": [25.0, -0.25]}


def station():
    """The quick station with an INS that sends increments."""
    quick, other = (read_document(find_document("stations", name)).data for name in ("quick", "emulated"))
    quick["ins"]["signals"]["increments"] = other["ins"]["signals"]["increments"]
    quick["ins"]["commands"]["send_increments"] = other["ins"]["commands"]["send_increments"]
    return quick


def plateau(on_ramp, positions=("z_up",)):
    """A dwell in each position and 18 rotations, on a ramp or after it."""
    full = read_document(find_document("procedures", "full_calibration")).data
    [repeated] = [step["repeat"]["steps"] for step in full["steps"] if "repeat" in step]
    rotate = next(step["rotate"] for step in repeated if "rotate" in step) | {"rest_s": 25, "rate_dps": 30}
    ramp = {"temperature_c": "$temperature_c", "ramp_c_per_min": 0.6 if on_ramp else 5.0}
    navigate = {"navigate": {"duration_s": 60}}
    return [
        {"chamber": ramp | ({"within_c": 50} if on_ramp else {})},
        {"wait": {"duration_s": 600}} if on_ramp else {"soak": {"for_s": 900}},
        *(
            step
            for position in positions
            for step in (
                {"go_to": {"position": position, "azimuth_deg": 0, "rate_dps": 30}},
                {"align": {"duration_s": 16}},
                navigate,
                {"turn": {"angle_deg": 180, "rate_dps": 30, "settle_s": 1}},
                navigate,
            )
        ),
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


def after_soaks(name, cycles, temperatures):
    """Dwells in all positions and rotations after soaks."""
    over = {"over": {"cycle": cycles, "temperature_c": temperatures}, "steps": plateau(False, POSITIONS)}
    return {"procedure": name, "steps": [{"power_on": {"settle_s": 60}}, {"repeat": over}]}


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


def position_errors(run):
    """Largest position error of a mission over the plateaus, by compensation and hours."""
    worst = {}
    for row in csv.DictReader((run / "verify/mission.csv").read_text().splitlines()):
        key = row["compensation"], row["hours"]
        worst[key] = max(worst.get(key, 0.0), float(row["position_nmi"]))
    return worst


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
    worst = position_errors(folder / "run")
    assert worst["effect", "24"] < worst["declared", "24"] < worst["none", "24"]
    page = (folder / "run/verify/verification.html").read_text()
    assert "A mission of a rotational INS" in page
    assert "search, gyro scale factors" in page
    assert "A day of a rotational INS" not in page  # on ramps there is one position


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
    assert "tried: misalignment or g-sensitivity" in done.stdout
    model = yaml.safe_load((tmp_path / "run/closure_accelerometer_bias/model.yaml").read_text())
    [effect] = model["effects"]
    assert effect["effect"] == "g_sensitivity"
    for (sensor, sensed), true in arcsec.items():
        ug = effect["terms_ug"][sensor][f"Up along {sensed}"]
        assert ug == pytest.approx(true * 4.848, abs=3.0)


@pytest.fixture(scope="module")
def attitude(tmp_path_factory):
    """Two cycles of dwells and rotations with accelerometer biases that follow gravity, more so when hot."""
    folder = tmp_path_factory.mktemp("attitude")
    effect = {"kind": "accelerometer_gravity", "sensitivity_ug_per_g": UG_PER_G, "per_c": PER_C}
    write_world(folder, [effect])
    files = {
        "station": station(),
        "campaign": after_soaks("campaign", [1, 2], [-15, 60, 40, 10]),
        "proof": after_soaks("proof", [1], [25]),
    }
    for name, data in files.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
    measure(folder, "campaign.yaml", "run")
    return folder


def test_a_bias_that_follows_attitude_counts_as_a_misalignment_and_is_compensated_as_one(attitude):
    done = gyrobench("close", "run", "--coefficient", "accelerometer_bias", cwd=attitude)
    text = " ".join(done.stdout.split())
    assert text.startswith("Search for effects: accelerometer biases Explained.")
    assert "misalignment or g-sensitivity and misalignment or g-sensitivity over temperature" in text
    assert "cannot be distinguished from misalignments of gyros or accelerometers" in text
    assert "magnetic field cannot" not in text
    model = yaml.safe_load((attitude / "run/closure_accelerometer_bias/model.yaml").read_text())
    terms = {each["effect"]: each["terms_ug"] for each in model["effects"]}
    for axis, row in zip("xyz", UG_PER_G, strict=True):
        for sensed, ug in zip("xyz", row, strict=True):
            if ug:
                per_c = terms["thermal_g_sensitivity"][axis][f"temperature by Up along {sensed}, K"]
                assert per_c == pytest.approx(PER_C * ug, rel=0.05)
    command = "verify", "run", "--coefficients", "--view", "lines", "--procedure"
    done = gyrobench(*command, "quick_verification", cwd=attitude)
    assert done.returncode == 2
    assert "the procedure measures no coefficients" in done.stderr
    done = gyrobench(*command, "proof.yaml", cwd=attitude)
    assert done.returncode == 0, done.stderr
    text = " ".join(done.stdout.split())
    assert "The effect misalignment or g-sensitivity in the accelerometer bias is left out: scale" in text
    assert "No effect was found." not in text
    assert "search, accelerometer biases explained." in text
    errors = position_errors(attitude / "run")
    for hours in ("1", "8", "24"):
        assert errors["declared", hours] < 0.15 * errors["none", hours]
