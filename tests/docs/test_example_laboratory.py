"""The example repository of a laboratory works as its author would use it."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig

import pytest

from tests.docs.pages import DOCS

FAILING = """import pytest


@pytest.mark.emulated_bench(station="held.yaml", faults="no_frames.yaml")
def test_that_fails(run_procedure):
    run_procedure("procedures/two_positions.yaml")


@pytest.mark.emulated_bench(station="real.yaml")
def test_on_real_instruments(run_procedure):
    run_procedure("procedures/two_positions.yaml")
"""
NO_FRAMES = """
faults:
  - {fault: bus_off, at_s: 300, for_s: 100000}
"""


@pytest.fixture(scope="module")
def repository(tmp_path_factory):
    """The repository with two failing tests, and its package installed beside it."""
    folder = tmp_path_factory.mktemp("laboratory") / "repository"
    shutil.copytree(DOCS / "examples/laboratory", folder)
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*install, "--target", folder.parent / "site", folder], check=True, timeout=300)
    (folder / "tests/test_failing.py").write_text(FAILING)
    (folder / "no_frames.yaml").write_text(NO_FRAMES)
    station = (folder / "stations/laboratory.yaml").read_text()
    (folder / "held.yaml").write_text(f"{station}\ninterlocks: {{max_hold_s: 300}}\n")
    (folder / "real.yaml").write_text(
        station.replace("emulator://table", "/dev/ttyUSB0").replace("clock: virtual", "clock: wall")
    )
    return folder


@pytest.fixture(scope="module")
def output(repository):
    """What pytest prints for the repository's tests and those of its dialect."""
    path = os.pathsep.join([str(repository.parent / "site"), sysconfig.get_path("purelib")])
    chosen = ["tests", "--pyargs", "gyrobench.conformance"]
    chosen += ["--dialect", "acme_frost", "--dialect-option", "shelf=1"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-v", "-p", "no:cacheprovider", *chosen],
        cwd=repository, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, timeout=900,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    return done.stdout


@pytest.mark.long
def test_its_procedures_pass_in_each_world(output):
    passed = re.findall(r"tests/test_procedures\.py::(\S+) PASSED", output)
    both = "test_both_positions_are_measured_without_flags"
    assert passed == [f"{both}[ideal]", f"{both}[gyro_a]", "test_the_bias_of_the_world_is_found"]


@pytest.mark.long
def test_its_dialect_conforms(output):
    assert len(re.findall(r"test_chamber\.py::\S*acme_frost\S* PASSED", output)) > 10
    assert set(re.findall(r"(\S+) (?:FAILED|ERROR)", output)) == {
        "tests/test_failing.py::test_that_fails",
        "tests/test_failing.py::test_on_real_instruments",
    }


@pytest.mark.long
def test_a_procedure_that_fails_shows_its_journal_and_real_instruments_are_refused(output):
    assert "journal of " in output
    assert "tripped  interlocks=" in output
    assert "run_ended  ended=stopped" in output
    assert "real.yaml: has instruments that are not emulated, which a test must not move." in output


def test_the_files_of_both_services_run_the_same_commands():
    repository = DOCS / "examples/laboratory"
    github = (repository / ".github/workflows/ci.yml").read_text()
    gitlab = (repository / ".gitlab-ci.yml").read_text()
    commands = [line.strip().removeprefix("- ") for line in gitlab.splitlines() if line.startswith("    - ")]
    assert len(commands) == 4
    assert all(f"- run: {command}" in github for command in commands)
