"""Options that several commands have."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.completion import (
    complete_faults,
    complete_procedure,
    complete_run,
    complete_station,
    complete_world,
)

#: The station of commands that are given none.
EMULATED = "emulated"

STATION_HELP = "Station file, or the name of a shipped one."
WORLD_HELP = "World behind emulated instruments: file or shipped name."
SEED_HELP = "Seed of everything random in the emulated world."


class View(StrEnum):
    """How a run is shown in the terminal."""

    LIVE = "live"
    LINES = "lines"


PROCEDURE_HELP = "Procedure file, or the name of a shipped one."

ProcedureArgument = Annotated[str, typer.Argument(help=PROCEDURE_HELP, autocompletion=complete_procedure)]
StationArgument = Annotated[str, typer.Argument(help=STATION_HELP, autocompletion=complete_station)]
StationOption = Annotated[str, typer.Option(help=STATION_HELP, autocompletion=complete_station)]
WorldOption = Annotated[str, typer.Option(help=WORLD_HELP, autocompletion=complete_world)]
SeedOption = Annotated[int, typer.Option(min=0, help=SEED_HELP)]
FaultsOption = Annotated[
    str | None,
    typer.Option(
        help="Faults that emulated instruments have: file or shipped name.", autocompletion=complete_faults
    ),
]
RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="Run folder.", autocompletion=complete_run)]
ViewOption = Annotated[
    View, typer.Option(help="The whole picture on a terminal, or lines only, as where output goes to a file.")
]
