import json
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyrobench.bench.bias.dwell import NavigationWindow
from gyrobench.bench.bias.noise_estimate import estimate_noise
from gyrobench.bench.foundations.arrays import DEG_PER_SQRT_H_TO_SI, UG_PER_SQRT_HZ_TO_SI
from gyrobench.bench.foundations.errors import DocumentError, RunFolderError
from gyrobench.bench.runs.tables.noise_file import read_noise, write_noise

EPOCHS, INTERVAL_S = 1200, 0.25
WALKS = 0.001 * DEG_PER_SQRT_H_TO_SI, 20.0 * UG_PER_SQRT_HZ_TO_SI


def noise_of(attitude_step=1e-9, velocity_step=1e-7):
    """Estimate of random walks in an output of such resolution."""
    random = np.random.default_rng(7)
    angles, velocities = (
        np.rint(walk * math.sqrt(INTERVAL_S) * random.normal(size=(EPOCHS, 3)).cumsum(axis=0) / step) * step
        for walk, step in zip(WALKS, (attitude_step, velocity_step), strict=True)
    )
    time_s = INTERVAL_S * np.arange(EPOCHS)
    attitudes = Rotation.from_rotvec(angles).as_matrix()
    return estimate_noise([NavigationWindow(time_s, velocities, attitudes)], 9.8)


def everything(noise):
    """All that a report asks of an estimate."""
    return (
        noise.gravity,
        noise.duration_s,
        noise.angle_random_walks,
        noise.angle_random_walk,
        noise.angle_random_walk_of_tilt,
        noise.velocity_random_walk,
        noise.velocity_white,
        noise.heading_white,
        [
            (each.step, each.allan.lengths, each.allan.tau_s.tolist(), each.allan.deviation.tolist())
            for each in (*noise.gyros, noise.all_gyros, noise.acceleration)
        ],
        [
            each.fit and (each.fit.expected.tolist(), each.fit.used.tolist(), each.fit.excess)
            for each in noise.gyros
        ],
    )


@pytest.mark.parametrize(
    "steps", [(1e-9, 1e-7), (5e-6, 0.01), (1.0, 10.0)], ids=["seen", "hidden", "never changes"]
)
def test_an_estimate_survives_the_file_to_the_last_digit(tmp_path, steps):
    noise = noise_of(*steps)
    write_noise(tmp_path / "noise.json", noise)
    read = read_noise(tmp_path / "noise.json")
    assert everything(read) == everything(noise)
    assert (noise.gyros[0].fit is None) == (steps[0] > 1e-9)


def test_arrays_are_arrays_again(tmp_path):
    noise = noise_of()
    write_noise(tmp_path / "noise.json", noise)
    read = read_noise(tmp_path / "noise.json")
    for one, other in ((read.all_gyros, noise.all_gyros), (read.acceleration, noise.acceleration)):
        assert one.allan.factors.dtype == other.allan.factors.dtype
        assert one.fit.used.dtype == bool
        np.testing.assert_array_equal(one.has_motion, other.has_motion)
    assert read.noise_model() == noise.noise_model()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "not json",
        "null",
        "[]",
        "{}",
        '{"gyros": []}',
        '{"gyros": [1, 2, 3]}',
        '{"gyros": [{"fit": [1]}, {}, {}]}',
        '{"gyros": [{"fit": null, "allan": 5}, {}, {}]}',
    ],
)
def test_a_file_that_holds_something_else_is_an_error_with_its_name(tmp_path, text):
    path = tmp_path / "noise.json"
    path.write_text(text)
    with pytest.raises(DocumentError, match=r"noise\.json: holds no noise estimate"):
        read_noise(path)


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (("acceleration",), None, "acceleration"),
        (("gravity",), None, "gravity"),
        (("gyros", 0, "allan", "variance", 0), -1e-12, r"variance\.0\D+must not be below zero"),
        (("gyros", 0, "fit", "edf", 1), 0.0, r"edf\.1\D+must be above zero"),
        (("gyros", 0, "fit", "expected", 0), -1.0, r"expected\.0\D+must not be below zero"),
        (("gyros", 0, "fit", "covariance", 1, 1), -1.0, r"gyros\.0\.fit\D+must not be below zero"),
        (("gyros", 0, "step"), -1.0, r"gyros\.0\.step\D+must not be below zero"),
        (("heading", "allan", "variance", -1), None, "every averaging time needs one value of each kind"),
        (("heading", "allan", "counts", -1), None, "every averaging time needs one value of each kind"),
    ],
)
def test_what_is_missing_or_can_not_be_is_an_error_with_its_place(tmp_path, place, value, message):
    path = tmp_path / "noise.json"
    write_noise(path, noise_of())
    part = data = json.loads(path.read_text())
    for key in place[:-1]:
        part = part[key]
    if value is None:
        del part[place[-1]]
    else:
        part[place[-1]] = value
    path.write_text(json.dumps(data))
    with pytest.raises(DocumentError, match=message):
        read_noise(path)


def test_files_that_can_not_be_read_or_written_are_named_once(tmp_path):
    with pytest.raises(DocumentError) as caught:
        read_noise(tmp_path / "absent.json")
    assert str(caught.value).count("absent.json") == 1
    with pytest.raises(RunFolderError, match="can't be written"):
        write_noise(tmp_path / "absent" / "noise.json", noise_of())


def test_the_file_begins_with_units_and_a_summary_and_has_an_array_in_a_line(tmp_path):
    noise = noise_of()
    write_noise(tmp_path / "noise.json", noise)
    text = (tmp_path / "noise.json").read_text()
    data = json.loads(text)
    assert list(data)[:2] == ["units", "summary"]
    walk = data["summary"]["angle_random_walk_deg_per_sqrt_h"]
    assert walk["value"] == pytest.approx(noise.angle_random_walk.value / DEG_PER_SQRT_H_TO_SI, rel=1e-3)
    assert walk["sigma"] == pytest.approx(noise.angle_random_walk.sigma / DEG_PER_SQRT_H_TO_SI, rel=1e-3)
    assert data["summary"]["velocity_random_walk_ug_per_sqrt_hz"]["value"] == pytest.approx(20.0, rel=0.3)
    assert any(line.strip().startswith('"variance": [') and line.endswith("],") for line in text.splitlines())


def test_what_the_resolution_hides_is_summed_up_as_a_limit(tmp_path):
    noise = noise_of(5e-6, 0.01)
    write_noise(tmp_path / "noise.json", noise)
    summary = json.loads((tmp_path / "noise.json").read_text())["summary"]["angle_random_walk_deg_per_sqrt_h"]
    limit = noise.angle_random_walk.limit / DEG_PER_SQRT_H_TO_SI
    assert summary == {"below": pytest.approx(limit, rel=1e-3), "hidden_by_resolution": True}
