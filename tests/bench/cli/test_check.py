"""The command `check`: what it prints and its exit codes."""

import pytest
import yaml
from typer.testing import CliRunner

from gyrobench.bench.cli import app
from gyrobench.bench.cli.output import EXIT_INSTRUMENT, EXIT_NOT_FINISHED
from gyrobench.bench.foundations.shipped import find_document
from tests.bench.engine.stations import absent_station, changed_station


@pytest.fixture
def check():
    """Run the command; returns exit code and output."""

    def run(*arguments):
        result = CliRunner().invoke(app, ["check", *map(str, arguments)])
        return result.exit_code, result.output

    return run


def test_a_bench_that_is_fit_for_a_run_ends_with_zero(check, tmp_path):
    code, text = check("emulated", "--procedure", "ten_minute_check", "--out", tmp_path)
    assert code == 0
    assert ": ready for a run" in text


def test_a_fault_that_is_there_ends_with_one(check, tmp_path):
    (tmp_path / "faults.yaml").write_text("faults:\n  - {fault: chamber_alarm, at_s: 0}\n")
    code, text = check("emulated", "--faults", tmp_path / "faults.yaml", "--signs", "--out", tmp_path)
    assert code == EXIT_NOT_FINISHED
    assert "not ready for a run" in text
    assert "skipped signs and axes not measured: another check failed" in " ".join(text.split())


def test_a_bench_of_which_nothing_answers_ends_with_three(check, tmp_path):
    code, text = check(absent_station(tmp_path), "--out", tmp_path)
    assert code == EXIT_INSTRUMENT
    assert "/dev/no_chamber" in text


@pytest.mark.parametrize(
    ("sign", "found"), [(1, "agree with the tilt"), (-1, "velocity_north has the wrong sign")]
)
def test_the_signs_of_the_signal_map_are_tested_by_a_dwell(check, tmp_path, sign, found):
    right = "velocity_north: VELOCITY_NE.VELOCITY_NORTH"
    declared = f"velocity_north: {{signal: VELOCITY_NE.VELOCITY_NORTH, sign: {sign}}}"
    station = changed_station(tmp_path, {right: declared})
    code, text = check(station, "--signs", "--out", tmp_path / "runs")
    assert code == (0 if sign > 0 else EXIT_NOT_FINISHED)
    assert found in " ".join(text.split())
    assert (tmp_path / "runs" / "signal_map_check-001" / "journal.jsonl").exists()


def test_the_mounting_of_each_unit_is_tested_by_a_dwell(check, tmp_path):
    document = yaml.safe_load(find_document("stations", "four_units").read_text())
    document["units"] = document["units"][:2]
    document["units"][1]["mounting"] = {"x": "south", "y": "east", "z": "up"}
    station = tmp_path / "station.yaml"
    station.write_text(yaml.safe_dump(document, sort_keys=False))
    code, text = check(station, "--signs", "--world", "four_units", "--out", tmp_path / "runs")
    shown = " ".join(text.split())
    assert code == EXIT_NOT_FINISHED
    assert "pass signs and axes velocities and attitude agree" in shown
    assert "FAIL signs and axes z_up: INS and table in window 1 disagree by 90.0 deg" in shown
