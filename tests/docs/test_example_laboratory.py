"""The example repository of a laboratory works as its author would use it."""

import os
import shutil
import subprocess
import sys
import sysconfig

import pytest

from tests.docs.pages import DOCS

FAILING = """

@pytest.mark.emulated_bench(faults="no_frames.yaml")
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
    """The repository, and its package installed beside it."""
    folder = tmp_path_factory.mktemp("laboratory") / "repository"
    shutil.copytree(DOCS / "examples/laboratory", folder)
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*install, "--target", folder.parent / "site", folder], check=True, timeout=300)
    return folder


def run_pytest(repository, *arguments):
    """Run pytest in the repository; returns its exit code and output."""
    path = os.pathsep.join([str(repository.parent / "site"), sysconfig.get_path("purelib")])
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *arguments],
        cwd=repository, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, timeout=900,
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr


def test_its_procedures_pass_in_each_world(repository):
    code, output = run_pytest(repository, "-v")
    assert code == 0, output
    assert "test_both_positions_are_measured_without_flags[gyro_a] PASSED" in output
    assert "3 passed" in output


def test_its_dialect_conforms(repository):
    choice = ["--dialect", "acme_frost", "--dialect-option", "shelf=1"]
    code, output = run_pytest(repository, "--pyargs", "gyrobench.conformance", *choice)
    assert code == 0, output


def test_a_procedure_that_fails_shows_its_journal_and_real_instruments_are_refused(repository):
    tests = repository / "tests/test_failing.py"
    tests.write_text((repository / "tests/test_procedures.py").read_text() + FAILING)
    (repository / "no_frames.yaml").write_text(NO_FRAMES)
    station = (repository / "stations/laboratory.yaml").read_text()
    (repository / "real.yaml").write_text(
        station.replace("emulator://table", "/dev/ttyUSB0").replace("clock: virtual", "clock: wall")
    )
    code, output = run_pytest(repository, "tests/test_failing.py", "-k", "fails or real")
    assert code == 1
    assert "journal of " in output
    assert "tripped  interlocks=" in output
    assert "run_ended  ended=stopped" in output
    assert "real.yaml: has instruments that are not emulated, which a test must not move." in output


def test_the_files_of_both_services_run_the_same_commands(repository):
    github = (repository / ".github/workflows/ci.yml").read_text()
    gitlab = (repository / ".gitlab-ci.yml").read_text()
    commands = [line.strip().removeprefix("- ") for line in gitlab.splitlines() if line.startswith("    - ")]
    assert len(commands) == 4
    assert all(f"- run: {command}" in github for command in commands)
