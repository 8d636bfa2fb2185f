"""The installed dialects: this project's, and those of other packages, found by entry point.

A package that adds a dialect names it in its metadata, under the group of its class of instrument; the
object there is a :class:`~gyrobench.drivers.rate_table.TableDialect`, a
:class:`~gyrobench.drivers.chamber.ChamberDialect`, or for an emulator one of
:mod:`gyrobench.drivers.emulators.dialect`. Only the dialect in use is imported, so a broken package
affects only its users.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar

from gyrobench.bench.foundations.documents import hint
from gyrobench.bench.foundations.errors import DocumentError

#: Groups of entry points.
RATE_TABLES, CHAMBERS, EMULATORS = "gyrobench.rate_tables", "gyrobench.chambers", "gyrobench.emulators"

DialectT = TypeVar("DialectT")


@dataclass(frozen=True)
class LineDefaults:
    """Settings of a controller's line that the station file does not give.

    Attributes
    ----------
    parity : {"N", "E", "O"}
        Parity bit; eight data bits and one stop bit always.
    tcp_port : int or None
        TCP port for an address without one; None if there is no usual port.
    """

    baudrate: int = 9600
    parity: str = "N"
    tcp_port: int | None = None


def installed(group: str) -> list[str]:
    """Names of the dialects of a group, also those that can't be imported."""
    return sorted({entry.name for entry in _entries(group)})


def load(group: str, name: str, kind: type[DialectT]) -> DialectT:
    """Import one dialect.

    Parameters
    ----------
    group : str
        One of the groups of this module.
    name : str
        Name in the station file.
    kind : type
        Type that the object must have.

    Raises
    ------
    DocumentError
        No dialect of that name is installed, or several, or it can't be imported or has another type.
    """
    found = [entry for entry in _entries(group) if entry.name == name]
    if not found:
        names = installed(group)
        raise DocumentError(
            f"no dialect {name!r} is installed{hint(name, names)}; installed: {', '.join(names)}"
        )
    if len(found) > 1:
        packages = " and ".join(sorted(map(_package, found)))
        raise DocumentError(f"the dialect {name!r} is offered by {packages}; uninstall all but one")
    entry = found[0]
    origin = f"the dialect {name!r} of {_package(entry)}"
    try:
        dialect = entry.load()  # another package's code may raise anything
    except Exception as error:
        raise DocumentError(
            f"{origin} can't be imported: {type(error).__name__}: {error}. Repair or uninstall that package"
        ) from error
    if not isinstance(dialect, kind):
        raise DocumentError(
            f"{origin} is no {kind.__name__} ({entry.value}); report this to the package's author"
        )
    return dialect


@cache
def _entries(group: str) -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=group))


def _package(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else entry.value
