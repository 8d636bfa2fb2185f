"""Stations and the emulated worlds that belong to them."""

import pytest

import gyrobench as gyrobench_api
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import DEFAULT_WORLD, world_for
from gyrobench.bench.runs.provenance import read_provenance
from tests.bench.command_line import gyrobench, refusal_of


@pytest.mark.parametrize(
    ("station", "world", "right"),
    [
        ("quick", None, "quick"),
        ("four_units", None, "four_units"),
        ("emulated", None, DEFAULT_WORLD),
        ("my_bench.yaml", None, DEFAULT_WORLD),
        ("quick", "quick_warm_up", "quick_warm_up"),
    ],
)
def test_a_station_has_the_shipped_world_of_its_name_by_default(station, world, right):
    assert world_for(station, world) == right


@pytest.mark.parametrize(("station", "world"), [("emulated", "quick"), ("quick", "gyro_a")])
@pytest.mark.parametrize(
    "command", ["run ten_minute_check --station", "investigate ten_minute_check --station", "check", "jog"]
)
def test_a_world_that_does_not_fit_the_station_is_refused_before_anything_is_made(
    tmp_path, command, station, world
):
    problem = refusal_of(*command.split(), station, "--world", world, cwd=tmp_path)
    assert f"{world}.yaml: the INS of this world sends an epoch in" in problem
    assert "Choose a world and a station that belong together" in problem
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_a_world_that_does_not_fit_the_station_is_refused_by_the_python_interface_too(tmp_path):
    with pytest.raises(DocumentError, match=r"quick\.yaml: the INS of this world sends an epoch in"):
        gyrobench_api.run("ten_minute_check", "emulated", world="quick", out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_procedure_beyond_the_limits_of_the_station_alone_names_the_station(tmp_path):
    problem = refusal_of("run", "quick_campaign", cwd=tmp_path)
    assert "These are limits of the station emulated. Choose another one with --station" in problem
    (tmp_path / "wrong.yaml").write_text("procedure: wrong\nsteps:\n  - align: {duration_s: 60}\n")
    assert "limits of the station" not in gyrobench("run", "wrong.yaml", cwd=tmp_path).stderr


def test_the_python_interface_emulates_the_world_of_the_station(tmp_path):
    run = gyrobench_api.run("ten_minute_check", "quick", out=tmp_path / "run")
    assert read_provenance(run.folder)["options"]["world"] == "quick"
