"""Options that several commands have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

#: The station of commands that are given none.
EMULATED = "emulated"

STATION_HELP = "Station file, or the name of a shipped one."
WORLD_HELP = "World behind emulated instruments: file or shipped name."
SEED_HELP = "Seed of everything random in the emulated world."

ProcedureArgument = Annotated[str, typer.Argument(help="Procedure file, or the name of a shipped one.")]
StationOption = Annotated[str, typer.Option(help=STATION_HELP)]
WorldOption = Annotated[str, typer.Option(help=WORLD_HELP)]
SeedOption = Annotated[int, typer.Option(min=0, help=SEED_HELP)]
FaultsOption = Annotated[
    str | None, typer.Option(help="Faults that emulated instruments have: file or shipped name.")
]
RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="Run folder.")]
