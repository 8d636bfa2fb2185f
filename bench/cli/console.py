"""The console of all commands."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gyrobench.bench.live.console import PatientConsole


def console(as_json: bool = False) -> PatientConsole:
    """Make a console that prints text as it is; on standard error where standard output is for JSON."""
    from gyrobench.bench.live.console import PatientConsole

    return PatientConsole(stderr=as_json, markup=False, highlight=False)
