"""The options that select runs of an index, the same for every command on many runs."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from gyrobench.bench.cli.output import console
from gyrobench.bench.runs.index.selection import Selection

if TYPE_CHECKING:
    from gyrobench.bench.runs.index.run_index import RunIndex

_DAYS = ["%Y-%m-%d"]
_Search = Literal["clean", "explained", "ambiguous", "unexplained", "stale"]
#: As ``RunVerdict`` of the acceptance, whose module would import pydantic for every ``--help``.
AcceptanceVerdict = Literal["accepted", "marginal", "rejected", "not judged"]
_Verdict = Literal[_Search, AcceptanceVerdict]

RootArgument = Annotated[
    str,
    typer.Argument(metavar="ROOT", help="Folder or URL (s3://..., memory://...) that contains run folders."),
]
IndexOption = Annotated[
    Path | None,
    typer.Option(
        help="Index file; default: ROOT/index.duckdb, for a URL or read-only ROOT a file in the user's cache."
    ),
]


def _selection(
    unit: Annotated[str | None, typer.Option(help="Serial number of the INS.")] = None,
    batch: Annotated[str | None, typer.Option(help="Batch of the unit's gyros, from ROOT/units.csv.")] = None,
    bench: Annotated[str | None, typer.Option(help="Name of the station.")] = None,
    procedure: Annotated[
        str | None, typer.Option(help="Procedure: its name, or the beginning of its file's SHA-256.")
    ] = None,
    since: Annotated[
        datetime | None, typer.Option(formats=_DAYS, metavar="DATE", help="First day (UTC) of the start.")
    ] = None,
    until: Annotated[
        datetime | None, typer.Option(formats=_DAYS, metavar="DATE", help="Last day (UTC) of the start.")
    ] = None,
    verdict: Annotated[
        _Verdict | None,
        typer.Option(
            metavar="VERDICT",
            help="Verdict of the search for effects (clean, explained, ambiguous, unexplained, stale) or of "
            "acceptance (accepted, marginal, rejected, 'not judged').",
        ),
    ] = None,
    ended: Annotated[
        Literal["finished", "failed", "stopped", "not ended"] | None, typer.Option(help="End of the run.")
    ] = None,
) -> Selection:
    first, last = (None if day is None else day.date() for day in (since, until))
    return Selection(unit, batch, bench, procedure, first, last, verdict, ended)


def with_selection(command: Callable[..., None]) -> Callable[..., None]:
    """Replace a command's parameter ``selection`` by the options that make a :class:`Selection`."""
    options = inspect.signature(_selection, eval_str=True).parameters
    signature = inspect.signature(command, eval_str=True)

    @functools.wraps(command)
    def with_options(**values: Any) -> None:
        command(selection=_selection(**{name: values.pop(name) for name in options}), **values)

    parameters = [
        each
        for name, parameter in signature.parameters.items()
        for each in (options.values() if name == "selection" else [parameter])
    ]
    with_options.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    with_options.__annotations__ = {each.name: each.annotation for each in parameters}
    return with_options


def open_index(root: str, path: Path | None = None, *, rebuild: bool = False) -> RunIndex:
    """Open and update the index of a store; a terminal shows progress and changes."""
    from gyrobench.bench.runs.index.run_index import RunIndex
    from gyrobench.bench.runs.index.store import open_store

    index = RunIndex(open_store(root), path)
    terminal = console(as_json=True)
    if not terminal.is_terminal:
        index.update(rebuild=rebuild)
        return index
    with terminal.status("searching for runs") as status:
        changes = index.update(
            rebuild=rebuild,
            progress=lambda done, total: status.update(f"{done} of {total} changed runs read"),
        )
    if changes.text:
        terminal.print(changes.text)
    return index
