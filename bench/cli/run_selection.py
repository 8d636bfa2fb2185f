"""The options that choose runs from an index, and what they mean."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gyrobench.bench.cli.output import console

if TYPE_CHECKING:
    from gyrobench.bench.runs.index import RunIndex
    from gyrobench.bench.runs.index_selection import Selection

_DAYS = ["%Y-%m-%d"]

RootArgument = Annotated[
    str,
    typer.Argument(metavar="[ROOT]", help="Folder or URL (s3://..., memory://...) that holds run folders."),
]
UnitOption = Annotated[str | None, typer.Option(help="Serial number of the INS.")]
BatchOption = Annotated[str | None, typer.Option(help="Batch of the unit's gyros, as in ROOT/units.csv.")]
BenchOption = Annotated[str | None, typer.Option(help="Name of the station.")]
ProcedureOption = Annotated[
    str | None, typer.Option(help="Procedure: its name, or the beginning of its file's SHA-256.")
]
SinceOption = Annotated[
    datetime | None, typer.Option(formats=_DAYS, metavar="DATE", help="First day (UTC) of the start.")
]
UntilOption = Annotated[
    datetime | None, typer.Option(formats=_DAYS, metavar="DATE", help="Last day (UTC) of the start.")
]
VerdictOption = Annotated[
    str | None,
    typer.Option(help="Verdict of the search for effects (clean ...) or the limits (accepted ...)."),
]
EndedOption = Annotated[
    str | None, typer.Option(help="How the run ended: finished, failed, stopped or 'not ended'.")
]
IndexOption = Annotated[
    Path | None,
    typer.Option(help="Index file; by default ROOT/index.duckdb, for a URL one in the user's cache."),
]


def selection_of(
    unit: str | None = None,
    batch: str | None = None,
    bench: str | None = None,
    procedure: str | None = None,
    since: datetime | None = None,
    until: datetime | None = None,
    verdict: str | None = None,
    ended: str | None = None,
) -> Selection:
    """What the options above choose."""
    from gyrobench.bench.runs.index_selection import Selection

    first, last = (None if day is None else day.date() for day in (since, until))
    return Selection(unit, batch, bench, procedure, first, last, verdict, ended)


def open_index(root: str, path: Path | None = None, *, rebuild: bool = False) -> RunIndex:
    """Open the index of a store, up to date; a terminal is told how far it has come, and what changed."""
    from gyrobench.bench.runs.index import RunIndex
    from gyrobench.bench.runs.index_run_files import open_store

    opened = RunIndex(open_store(root), path)
    terminal = console(as_json=True)
    if not terminal.is_terminal:
        opened.update(rebuild=rebuild)
        return opened
    with terminal.status("looking for runs") as status:
        changes = opened.update(
            rebuild=rebuild, progress=lambda done, of: status.update(f"{done} of {of} changed runs read")
        )
    if changes.text:
        terminal.print(changes.text)
    return opened
