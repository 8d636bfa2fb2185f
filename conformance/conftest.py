"""Selects the dialects under test, and provides them as fixtures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import ValidationError

from gyrobench.bench.foundations.packages import CHAMBERS, RATE_TABLES, installed, load
from gyrobench.conformance.instruments import ChamberUnderTest, Noise, TableUnderTest
from gyrobench.drivers.chamber import ChamberDialect
from gyrobench.drivers.rate_table import TableDialect

_GROUPS = {"test_chamber.py": CHAMBERS, "test_rate_table.py": RATE_TABLES}


@pytest.fixture
def chamber(request: pytest.FixtureRequest) -> ChamberUnderTest:
    """Provide a chamber of each dialect under test."""
    return ChamberUnderTest(request.param, _options(request.config))


@pytest.fixture
def table(request: pytest.FixtureRequest) -> TableUnderTest:
    """Provide a table of each dialect under test."""
    return TableUnderTest(request.param, _options(request.config))


@pytest.fixture(params=range(4))
def noise(request: pytest.FixtureRequest) -> Callable[[], Noise]:
    """Return a function that makes equal noise at each call."""
    return lambda: Noise(request.param)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Ignore the tests of a kind of instrument for which there is no dialect under test."""
    group = _GROUPS.get(collection_path.name)
    return True if group and not _under_test(config, group) else None


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run each test with each dialect."""
    for fixture, group in (("chamber", CHAMBERS), ("table", RATE_TABLES)):
        if fixture in metafunc.fixturenames:
            names = _under_test(metafunc.config, group)
            for name in names if metafunc.config.getoption("dialect") else ():
                _check_options(metafunc.config, group, name)
            metafunc.parametrize(fixture, names, indirect=True)


def _under_test(config: pytest.Config, group: str) -> list[str]:
    """Names of the dialects of a group that are under test."""
    selected: list[str] = config.getoption("dialect")
    by_group = {name: installed(name) for name in (CHAMBERS, RATE_TABLES)}
    available = sorted({name for names in by_group.values() for name in names})
    if unknown := sorted(set(selected) - set(available)):
        raise pytest.UsageError(
            f"--dialect {unknown[0]}: no installed package offers it; installed: {', '.join(available)}. "
            "After a change of a package's entry points, install it again"
        )
    return [name for name in by_group[group] if name in selected or not selected]


def _check_options(config: pytest.Config, group: str, name: str) -> None:
    is_chamber = group == CHAMBERS
    options = (load(group, name, ChamberDialect) if is_chamber else load(group, name, TableDialect)).options
    try:
        options.model_validate(_options(config))
    except ValidationError as error:
        problems = "; ".join(each["msg"] for each in error.errors())
        raise pytest.UsageError(
            f"--dialect {name}: {problems}. Give its keys by --dialect-option KEY=VALUE"
        ) from error


def _options(config: pytest.Config) -> dict[str, Any]:
    """Additional keys of the dialect, as in a station file, from ``--dialect-option KEY=VALUE``."""
    texts: list[str] = config.getoption("dialect_option")
    return {key: yaml.safe_load(value) for key, _, value in (text.partition("=") for text in texts)}
