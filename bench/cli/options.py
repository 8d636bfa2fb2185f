"""Options that several commands share, and their shell completion."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer

from gyrobench.bench.foundations.operator_name import OPERATOR_VARIABLE
from gyrobench.bench.foundations.shipped import DEFAULT_WORLD

_MAX_RUNS = 200

_Completion = Callable[[str], list[str]]


def _complete_shipped(*kinds: str) -> _Completion:
    def complete(incomplete: str) -> list[str]:
        from gyrobench.bench.foundations.shipped import shipped_names

        return _matching(incomplete, [name for kind in kinds for name in shipped_names(kind)])

    return complete


complete_procedure = _complete_shipped("procedures")
complete_station = _complete_shipped("stations")
complete_world = _complete_shipped("worlds")
complete_faults = _complete_shipped("faults")
complete_import_map = _complete_shipped("imports")
complete_plan = _complete_shipped("procedures", "rotations")


def complete_template(incomplete: str) -> list[str]:
    """Names of templates of a new procedure."""
    from gyrobench.bench.foundations.shipped import TEMPLATES, shipped_names

    return _matching(incomplete, [*TEMPLATES, *shipped_names("procedures")])


def complete_table(incomplete: str) -> list[str]:
    """Installed dialects of rate tables."""
    from gyrobench.bench.foundations.packages import RATE_TABLES, installed

    return _matching(incomplete, installed(RATE_TABLES))


def complete_chamber(incomplete: str) -> list[str]:
    """Installed dialects of chambers."""
    from gyrobench.bench.foundations.packages import CHAMBERS, installed

    return _matching(incomplete, installed(CHAMBERS))


def complete_quantity(incomplete: str) -> list[str]:
    """Coefficients in which effects can be searched."""
    from gyrobench.bench.closure.quantity import QUANTITIES

    return _matching(incomplete, (each.name for each in QUANTITIES))


def complete_list(names: Iterable[str]) -> Callable[[str], list[str]]:
    """Completion of the last name of a list with commas."""

    def complete(incomplete: str) -> list[str]:
        earlier, comma, last = incomplete.rpartition(",")
        return [earlier + comma + name for name in _matching(last, names)]

    return complete


def complete_run(incomplete: str) -> list[str]:
    """Run folders under ``runs``, or under the typed folder, newest first."""
    from gyrobench.bench.runs.folder import RUNS, RunFolder

    typed = Path(incomplete)
    folder = typed if incomplete.endswith("/") else typed.parent
    if not incomplete:
        folder = RUNS
    try:
        run_folders = [path.parent for path in folder.glob(str(RunFolder(Path("*")).journal))]
    except OSError:
        return []
    newest_first = sorted(run_folders, key=lambda path: path.stat().st_mtime, reverse=True)
    return _matching(incomplete, map(str, newest_first[:_MAX_RUNS]))


def _matching(incomplete: str, names: Iterable[str]) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]


#: Default station.
EMULATED = "emulated"

STATION_HELP = "Station file, or the name of a shipped one."
WORLD_DEFAULT = f"the one with the name of the station, else {DEFAULT_WORLD}"
_WORLD_HELP = f"World behind emulated instruments: file or shipped name; default: {WORLD_DEFAULT}."
_SEED_HELP = "Seed of everything random in the emulated world."


#: View of a run in the terminal.
View = Literal["live", "lines"]


def _set_operator(context: typer.Context, name: str) -> str:
    """Set the name in the environment until the command ends, also for its child processes."""
    if name:
        previous = os.environ.get(OPERATOR_VARIABLE)
        os.environ[OPERATOR_VARIABLE] = name
        context.call_on_close(lambda: _restore_operator(previous))
    return name


def _restore_operator(previous: str | None) -> None:
    if previous is None:
        os.environ.pop(OPERATOR_VARIABLE, None)
    else:
        os.environ[OPERATOR_VARIABLE] = previous


PROCEDURE_HELP = "Procedure file, or the name of a shipped one."

ProcedureArgument = Annotated[str, typer.Argument(help=PROCEDURE_HELP, autocompletion=complete_procedure)]
StationArgument = Annotated[str, typer.Argument(help=STATION_HELP, autocompletion=complete_station)]
StationOption = Annotated[
    str, typer.Option(metavar="FILE|NAME", help=STATION_HELP, autocompletion=complete_station)
]
WorldOption = Annotated[
    str | None, typer.Option(metavar="FILE|NAME", help=_WORLD_HELP, autocompletion=complete_world)
]
SeedOption = Annotated[int, typer.Option(min=0, help=_SEED_HELP)]
FaultsOption = Annotated[
    str | None,
    typer.Option(
        metavar="FILE|NAME",
        help="Faults of the emulated instruments: file or shipped name.",
        autocompletion=complete_faults,
    ),
]
_RUN = typer.Argument(metavar="RUN", help="Run folder.", autocompletion=complete_run)
RunArgument = Annotated[Path, _RUN]
OptionalRunArgument = Annotated[Path | None, _RUN]


class TracedInstrument(StrEnum):
    """Instruments of the section ``traceability`` of a station file."""

    RATE_TABLE = "rate_table"
    CHAMBER_SENSORS = "chamber_sensors"
    REFERENCE_CLOCK = "reference_clock"


AcknowledgeOption = Annotated[
    list[TracedInstrument] | None,
    typer.Option(
        help="Use this instrument although its calibration is past due, in the operator's name; may be "
        "repeated."
    ),
]
FailOnOption = Annotated[
    Literal["rejected", "flagged"] | None,
    typer.Option(
        help="Exit with 1 if a unit is rejected or dropped; with flagged also if a dwell has flags or was "
        "skipped."
    ),
]
OperatorOption = Annotated[
    str,
    typer.Option(
        "--operator",
        metavar="NAME",
        callback=_set_operator,
        help="Name of the operator, for the audit trail; default: GYROBENCH_OPERATOR, else the login name.",
    ),
]
ViewOption = Annotated[View, typer.Option(help="Live view of the run on a terminal, or lines as in a file.")]
