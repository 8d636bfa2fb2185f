import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from gyrobench.bench.foundations import packages
from gyrobench.bench.foundations.errors import DocumentError, MissingPackageError
from gyrobench.bench.foundations.packages import CHAMBERS, EMULATORS, RATE_TABLES, installed, load, require
from gyrobench.drivers import chamber, emulators, rate_table
from gyrobench.drivers.chamber import ChamberDialect, watlow_f4
from gyrobench.drivers.emulators.dialect import ChamberEmulation, TableEmulation
from gyrobench.drivers.rate_table import TableDialect


@pytest.fixture
def offered(monkeypatch):
    """Make packages offer dialects of chambers."""

    def offer(**values):
        entries = tuple(EntryPoint(name, value, CHAMBERS) for name, value in values.items())
        monkeypatch.setattr(packages, "_entries", lambda group: entries)

    return offer


def dialects_in(package):
    """Modules of a package that offer a dialect."""
    path = Path(package.__file__).parent
    return {each.stem for each in path.glob("*.py") if "\nDIALECT = " in each.read_text(encoding="utf-8")}


def test_each_module_with_a_dialect_is_an_entry_point_and_has_an_emulator():
    missing = "add it to the entry points in pyproject.toml, and install gyrobench again"
    assert dialects_in(rate_table) <= {*installed(RATE_TABLES)}, missing
    assert dialects_in(chamber) <= {*installed(CHAMBERS)}, missing
    assert dialects_in(rate_table) | dialects_in(chamber) == dialects_in(emulators) <= {*installed(EMULATORS)}


@pytest.mark.parametrize("name", sorted(dialects_in(rate_table)))
def test_own_dialects_of_tables_can_be_imported(name):
    assert load(RATE_TABLES, name, TableDialect).max_axes >= 1
    assert callable(load(EMULATORS, name, TableEmulation).make)


@pytest.mark.parametrize(
    ("name", "tcp_port"), [("thermotron_8800", 8888), ("watlow_f4", None), ("watlow_f4t", 5025)]
)
def test_own_dialects_of_chambers_can_be_imported(name, tcp_port):
    assert load(CHAMBERS, name, ChamberDialect).line.tcp_port == tcp_port
    assert callable(load(EMULATORS, name, ChamberEmulation).make)


def test_an_unknown_name_is_reported_with_the_installed_ones():
    with pytest.raises(
        DocumentError,
        match=r"no dialect 'watlow_f5' of a chamber is installed \(did you mean 'watlow_f4'\?\); "
        "installed: ther",
    ):
        load(CHAMBERS, "watlow_f5", ChamberDialect)
    with pytest.raises(
        DocumentError, match=r"'movit' .*entry points gyrobench\.rate_tables, install it again"
    ):
        load(RATE_TABLES, "movit", TableDialect)


def test_a_dialect_without_emulator_is_reported_with_where_to_name_one(monkeypatch):
    entries = {RATE_TABLES: (EntryPoint("mine", "mine:DIALECT", RATE_TABLES),)}
    monkeypatch.setattr(packages, "_entries", lambda group: entries.get(group, ()))
    with pytest.raises(
        DocumentError, match=r"'mine' has no emulator: .* gyrobench\.emulators\. Add one there"
    ):
        load(EMULATORS, "mine", TableEmulation)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("no_such_package.module:DIALECT", r"can't be imported: ModuleNotFoundError: No module named"),
        ("gyrobench.drivers.chamber.watlow_f4:NOTHING", "can't be imported: AttributeError"),
        ("gyrobench.drivers.chamber.watlow_f4:WatlowF4", "is not of type ChamberDialect .*Report this to"),
        ("gyrobench.drivers.rate_table.acutrol3000:DIALECT", "is not of type ChamberDialect"),
    ],
)
def test_a_broken_package_affects_only_its_users(offered, value, message):
    offered(broken=value, watlow_f4="gyrobench.drivers.chamber.watlow_f4:DIALECT")
    with pytest.raises(DocumentError, match=f"the dialect 'broken' of .*{message}"):
        load(CHAMBERS, "broken", ChamberDialect)
    assert load(CHAMBERS, "watlow_f4", ChamberDialect) is watlow_f4.DIALECT
    assert installed(CHAMBERS) == ["broken", "watlow_f4"]


def test_a_dialect_provided_by_two_packages_is_refused(monkeypatch):
    twice = tuple(EntryPoint("acme", f"package_{which}:DIALECT", CHAMBERS) for which in "ab")
    monkeypatch.setattr(packages, "_entries", lambda group: twice)
    with pytest.raises(DocumentError, match="'acme' is provided by package_a:DIALECT and package_b:DIALECT"):
        load(CHAMBERS, "acme", ChamberDialect)


def test_module_of_an_installed_package_is_returned() -> None:
    assert require("fsspec.spec") is sys.modules["fsspec.spec"]


@pytest.mark.parametrize(
    ("module", "extra"),
    [("dask", "fleet"), ("duckdb", "index"), ("weasyprint", "pdf"), ("asammdf.blocks", "mf4")],
)
def test_missing_package_is_named_with_its_extra(
    module: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module.partition(".")[0], None)
    monkeypatch.delitem(sys.modules, module if "." in module else "", raising=False)
    with pytest.raises(MissingPackageError, match=rf"pip install 'gyrobench\[{extra}\]'"):
        require(module)
