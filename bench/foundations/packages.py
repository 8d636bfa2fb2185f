"""Imports other Python packages: optional dependencies, and packages that extend the bench.

A package adds dialects of instruments, CAN frames of an emulated INS, and candidate effects by entry points:
its metadata name the object in the group of its kind. A dialect is imported only when a station file names
it, so a broken package affects only the stations that use it.
"""

from __future__ import annotations

import importlib
from functools import cache
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from typing import Any, TypeVar

from gyrobench.bench.foundations.errors import DocumentError, MissingPackageError
from gyrobench.bench.foundations.text import did_you_mean

#: Groups of entry points, and the noun for one entry in messages.
RATE_TABLES, CHAMBERS, EMULATORS = "gyrobench.rate_tables", "gyrobench.chambers", "gyrobench.emulators"
CAN_FORMATS, EFFECTS = "gyrobench.can_formats", "gyrobench.effects"
_NOUNS = {CAN_FORMATS: "set of CAN frames", EFFECTS: "effect"}
_INSTRUMENTS = {RATE_TABLES: " of a rate table", CHAMBERS: " of a chamber"}
#: Extra in pyproject.toml that installs each optional package.
_EXTRAS = {
    "dask": "fleet",
    "distributed": "fleet",
    "duckdb": "index",
    "fsspec": "index",
    "weasyprint": "pdf",
    "asammdf": "mf4",
    "pandas": "pandas",
    "prometheus_client": "metrics",
    "pymavlink": "logs",
    "pyulog": "logs",
    **dict.fromkeys(("cryptography", "lxml", "pkcs11", "pyhanko", "signxml"), "certificate"),
}

_ObjectT = TypeVar("_ObjectT")


def require(module: str) -> Any:
    """Import a module of an optional package, such as ``require("asammdf")``.

    For type checkers, add ``if TYPE_CHECKING: import asammdf``. Raises MissingPackageError if the package or
    one of its dependencies is not installed; the message names the extra.
    """
    package = module.partition(".")[0]
    try:
        return importlib.import_module(module)
    except ImportError as error:
        missing = error.name or package
        raise MissingPackageError(
            f"the Python package {missing} is not installed. Install it with "
            f"pip install 'gyrobench[{_EXTRAS[package]}]'"
        ) from error


def installed(group: str) -> list[str]:
    """Names of the installed entries of a group, whether or not they can be imported."""
    return sorted({entry.name for entry in _entries(group)})


def load(group: str, name: str, kind: type[_ObjectT]) -> _ObjectT:
    """Import the object of one entry.

    Raises DocumentError if no package or several packages provide the name, the object can't be imported, or
    it has another type.

    Parameters
    ----------
    group : str
        One of the groups of this module.
    name : str
        Name of the entry, as in a station file.
    kind : type
        Required type of the object.
    """
    noun = _NOUNS.get(group, "dialect")
    matches = [entry for entry in _entries(group) if entry.name == name]
    if not matches:
        if group == EMULATORS and name in (*installed(RATE_TABLES), *installed(CHAMBERS)):
            raise DocumentError(
                f"the dialect {name!r} has no emulator: no installed package names one in the entry points "
                f"{EMULATORS}. Add one there, or use the port of the instrument"
            )
        names, instrument = installed(group), _INSTRUMENTS.get(group, "")
        similar = did_you_mean(name, names)
        advice = "" if similar else f". After a change of a package's entry points {group}, install it again"
        raise DocumentError(
            f"no {noun} {name!r}{instrument} is installed{similar}; installed: {', '.join(names)}{advice}"
        )
    if len(matches) > 1:
        packages = " and ".join(sorted(map(_package, matches)))
        raise DocumentError(f"the {noun} {name!r} is provided by {packages}; uninstall all but one")
    entry = matches[0]
    try:
        loaded = entry.load()  # code of another package may raise anything
    except Exception as error:
        raise DocumentError(
            f"the {noun} {name!r} of {_package(entry)} can't be imported: {type(error).__name__}: {error}. "
            "Repair or uninstall that package"
        ) from error
    if not isinstance(loaded, kind):
        raise DocumentError(
            f"the {noun} {name!r} of {_package(entry)} is not of type {kind.__name__} ({entry.value}). "
            "Report this to the package's author"
        )
    return loaded


@cache
def _all_entries() -> dict[str, EntryPoints]:
    """Entry points of all installed packages, by group, for the groups of gyrobench; read once."""
    entries = entry_points()
    return {group: entries.select(group=group) for group in entries.groups if group.startswith("gyrobench.")}


def _entries(group: str) -> EntryPoints:
    return _all_entries().get(group, EntryPoints(()))


def _package(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else entry.value
