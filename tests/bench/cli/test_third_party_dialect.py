"""A third-party package adds a chamber's dialect and its emulator; nothing here knows of it."""

import re
import shutil
from pathlib import Path

import pytest

from gyrobench.bench.cli.output import EXIT_WRONG_INPUT
from gyrobench.bench.foundations import packages
from gyrobench.bench.foundations.shipped import find_document
from tests.bench.command_line import gyrobench, output_of, refusal_of

PACKAGE = Path(__file__).parents[3] / "docs/examples/laboratory/acme_frost"
METADATA = "Metadata-Version: 2.1\nName: acme-frost\nVersion: 1.2\n"
ENTRY_POINTS = """
[gyrobench.chambers]
acme_frost = acme_frost.chamber:DIALECT
acme_broken = acme_frost.broken:DIALECT

[gyrobench.emulators]
acme_frost = acme_frost.emulator:DIALECT
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder with the package as pip would leave it."""
    folder = tmp_path_factory.mktemp("site")
    package, metadata = folder / "acme_frost", folder / "acme_frost-1.2.dist-info"
    shutil.copytree(PACKAGE, package)
    metadata.mkdir()
    (package / "broken.py").write_text("import a_library_that_is_not_installed\n")
    (metadata / "METADATA").write_text(METADATA)
    (metadata / "entry_points.txt").write_text(ENTRY_POINTS)
    return folder


@pytest.fixture
def acme_station(tmp_path):
    """Make a station file of that dialect with these keys."""

    def make(dialect="acme_frost", keys="  shelf: 3\n"):
        text = find_document("stations", "emulated").read_text()
        text = text.replace("  dialect: watlow_f4\n", f"  dialect: {dialect}\n").replace(
            "  address: 1\n", keys
        )
        path = tmp_path / "acme.yaml"
        path.write_text(text)
        return path

    return make


@pytest.fixture
def installed(site, monkeypatch):
    """The package as if it had been installed before this process began."""
    monkeypatch.syspath_prepend(site)
    packages._all_entries.cache_clear()
    yield site
    packages._all_entries.cache_clear()


def test_a_run_goes_through_a_dialect_of_another_package(acme_station, installed, tmp_path):
    options = ("--station", acme_station(), "--world", "ideal", "--out", "acme-run")
    output_of("run", "ten_minute_check", *options, cwd=tmp_path)
    assert "Acme Frost, shelf 3" in (tmp_path / "acme-run" / "provenance.json").read_text()


def test_a_check_names_the_instrument_of_another_package(acme_station, installed, tmp_path):
    assert "Acme Frost, shelf 3" in output_of("check", acme_station(), "--world", "ideal", cwd=tmp_path)


def test_mistakes_in_the_keys_of_another_package_are_shown_with_their_place(
    acme_station, installed, tmp_path
):
    problem = refusal_of("plan", "ten_minute_check", "--station", acme_station(keys=""), cwd=tmp_path)
    assert re.search(r"acme\.yaml:\d+:1: the key 'shelf' is missing: shelf that the unit", problem)


def test_a_broken_package_is_named_without_a_traceback(acme_station, installed, tmp_path):
    station = acme_station(dialect="acme_broken")
    problem = refusal_of("plan", "ten_minute_check", "--station", station, cwd=tmp_path)
    assert re.search(
        r"acme\.yaml:\d+:3: the dialect 'acme_broken' of acme-frost 1\.2 can't be imported", problem
    )
    assert "ModuleNotFoundError: No module named 'a_library_that_is_not_installed'" in problem
    assert "Traceback" not in problem


def test_a_broken_package_hurts_no_other_station(installed, tmp_path):
    assert gyrobench("plan", "ten_minute_check", "--station", "emulated", cwd=tmp_path).returncode == 0


def test_a_dialect_without_an_emulator_says_so(acme_station, installed, tmp_path):
    entry_points = installed / "acme_frost-1.2.dist-info" / "entry_points.txt"
    before = entry_points.read_text()
    entry_points.write_text(before.partition("[gyrobench.emulators]")[0])
    try:
        done = gyrobench("check", acme_station(), "--world", "ideal", cwd=tmp_path)
    finally:
        entry_points.write_text(before)
    assert done.returncode == EXIT_WRONG_INPUT
    said = " ".join((done.stdout + done.stderr).split())
    assert "the dialect 'acme_frost' has no emulator: no installed package names one in the entry" in said
