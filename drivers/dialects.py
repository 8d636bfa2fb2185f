"""The installed dialects: this project's own, and those that other packages add by entry point.

A package that adds one names it in its metadata, under the group of its class of instrument; the
object there is a :class:`~gyrobench.drivers.rate_table.TableDialect`, a
:class:`~gyrobench.drivers.chamber.ChamberDialect`, or for an emulator one of
:mod:`gyrobench.drivers.emulators.dialect`. Only the dialect that is asked for is imported, so that a broken
package hurts nobody who does not use it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.text import did_you_mean

#: Groups of entry points.
RATE_TABLES, CHAMBERS, EMULATORS = "gyrobench.rate_tables", "gyrobench.chambers", "gyrobench.emulators"

DialectT = TypeVar("DialectT")


@dataclass(frozen=True)
class LineDefaults:
    """How a controller is reached unless the station file says otherwise.

    Attributes
    ----------
    baudrate : int
        Bits per second.
    parity : {"N", "E", "O"}
        Parity bit; eight data bits and one stop bit always.
    tcp_port : int or None
        Its TCP port, for an address that names none; None where it has no usual one.
    """

    baudrate: int = 9600
    parity: str = "N"
    tcp_port: int | None = None


def installed(group: str) -> list[str]:
    """Names of the dialects of a group, whether or not they can be imported."""
    return sorted({entry.name for entry in _entries(group)})


def load(group: str, name: str, kind: type[DialectT]) -> DialectT:
    """Import one dialect.

    Parameters
    ----------
    group : str
        One of the groups of this module.
    name : str
        Its name, as a station file gives it.
    kind : type
        What it has to be.

    Raises
    ------
    DocumentError
        None of that name is installed, or several, or it can't be imported, or it is no such object.
    """
    found = [entry for entry in _entries(group) if entry.name == name]
    if not found:
        names = installed(group)
        raise DocumentError(
            f"no dialect {name!r} is installed{did_you_mean(name, names)}; installed: {', '.join(names)}"
        )
    if len(found) > 1:
        packages = " and ".join(sorted(map(_package, found)))
        raise DocumentError(f"the dialect {name!r} is offered by {packages}; uninstall all but one")
    entry = found[0]
    origin = f"the dialect {name!r} of {_package(entry)}"
    try:
        dialect = entry.load()  # another package's code may raise whatever it likes
    except Exception as error:
        raise DocumentError(
            f"{origin} can't be imported: {type(error).__name__}: {error}. Repair or uninstall that package"
        ) from error
    if not isinstance(dialect, kind):
        raise DocumentError(f"{origin} is no {kind.__name__} ({entry.value}); tell its maker")
    return dialect


@cache
def _entries(group: str) -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=group))


def _package(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else entry.value
