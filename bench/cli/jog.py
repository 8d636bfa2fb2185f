"""`gyrobench jog`."""

from __future__ import annotations

from typing import Annotated

import typer

from gyrobench.bench.cli.options import EMULATED, FaultsOption, SeedOption, StationArgument, WorldOption
from gyrobench.bench.cli.output import EXIT_NOT_FINISHED


def jog(
    station: StationArgument = EMULATED,
    commands: Annotated[
        list[str] | None,
        typer.Argument(metavar="COMMAND", help="Commands to execute; default: typed interactively."),
    ] = None,
    leave: Annotated[
        bool, typer.Option(help="At the end keep the state of chamber, unit and servos; the table stops.")
    ] = False,
    world: WorldOption = None,
    seed: SeedOption = 0,
    faults: FaultsOption = None,
) -> None:
    """Manual control of table, chamber and INS, within the limits of the station.

    Commands are typed one per line, come from a pipe, or are given as arguments, each in quotes; `help`
    lists them. The interlocks of the station are active: a trip brings the bench to its safe state and
    reports the reason. Ctrl-C stops the table. At the end the bench is left in its safe state.

    Exit codes: 0 success, 1 a command failed or an interlock tripped, 3 no instrument can be reached
    or a run uses the bench. An instrument that does not answer is left out.

    Example: gyrobench jog my_bench.yaml "table outer 30" "chamber 40 at 1.5" "watch 60"
    """
    from gyrobench.bench.jog.jog_session import jog_bench
    from gyrobench.bench.station.instruments import Emulation

    succeeded = jog_bench(station, commands or [], Emulation.of(station, world, seed, faults), leave)
    if not succeeded:
        raise typer.Exit(EXIT_NOT_FINISHED)
