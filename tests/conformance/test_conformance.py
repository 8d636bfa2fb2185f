"""The conformance suite finds each mistake of a broken dialect; ``conformance/`` tests the shipped ones."""

import os
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.conformance.broken_dialects import MISTAKES

ROOT = Path(__file__).parents[2]


def suite(tmp_path, *arguments, path=()):
    """Run the suite as another package's author does; returns its output and the outcome of each test."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, path)), "PYTHONSAFEPATH": "1"}
    report = tmp_path / "results.xml"
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--pyargs", "gyrobench.conformance"]
    done = subprocess.run(
        [*command, *arguments, "--junit-xml", report],
        cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=900,
    )  # fmt: skip
    cases = ElementTree.parse(report).iter("testcase") if report.exists() else ()  # noqa: S314 - our own file
    return done, {case.get("name"): {child.tag for child in case} for case in cases}


@pytest.mark.long
def test_each_mistake_is_found_by_the_test_for_it(tmp_path):
    metadata = tmp_path / "site" / "acme_broken-1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-broken\nVersion: 1.0\n")
    groups = {"chamber": "gyrobench.chambers", "table": "gyrobench.rate_tables"}
    lines = []
    for name in MISTAKES:
        module = "tests.conformance.broken_dialects"
        lines += [f"[{groups[name.partition('_')[0]]}]", f"{name} = {module}:{name}"]
        lines += ["[gyrobench.emulators]", f"{name} = {module}:{name}_emulator"]
    (metadata / "entry_points.txt").write_text("\n".join(lines))
    chosen = [argument for name in MISTAKES for argument in ("--dialect", name)]
    done, outcomes = suite(
        tmp_path, "-p", "tests.conformance.broken_dialects", *chosen, path=[tmp_path / "site", ROOT]
    )
    failed = [test for test, ends in outcomes.items() if "failure" in ends]
    found = {name for name in MISTAKES if any(name in test for test in failed)}
    assert set(MISTAKES) - found == set(), done.stdout[-3000:]


def test_every_test_of_the_suite_has_a_mistake_to_find(tmp_path):
    tests = {
        f"{kind}_{line.split('(')[0].removeprefix('def test_')}"
        for kind, file in (("chamber", "test_chamber.py"), ("table", "test_rate_table.py"))
        for line in (ROOT / "conformance" / file).read_text(encoding="utf-8").splitlines()
        if line.startswith("def test_")
    }
    assert tests == set(MISTAKES)


def test_a_dialect_that_no_package_offers_is_named(tmp_path):
    done, _ = suite(tmp_path, "--dialect", "acme_glacier")
    assert done.returncode != 0
    assert "--dialect acme_glacier: no installed package offers it; installed: acutrol3000" in done.stdout
    assert "entry points, install it again" in done.stdout


def test_a_wrong_key_of_the_dialect_ends_the_suite_with_what_is_allowed(tmp_path):
    options = ("--dialect", "watlow_f4", "--dialect-option", "adress=2")
    done, _ = suite(tmp_path, *options, path=(ROOT / "src",))
    assert done.returncode != 0
    assert "--dialect watlow_f4: unknown key 'adress' (did you mean 'address'?); allowed here:" in done.stdout
    assert "Give its keys by --dialect-option KEY=VALUE" in done.stdout
