"""`gyrobench tell`."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from gyrobench.bench.cli.options import RunArgument
from gyrobench.bench.engine.operator import RunCommand
from gyrobench.bench.foundations.errors import RunFolderError


def tell(
    run_folder: RunArgument,
    order: Annotated[RunCommand, typer.Argument(help="What it is to do.")],
) -> None:
    """Tell a run under way to pause, continue, hold at this temperature, skip the dwell, or abort.

    The same words can be typed where the run was started.

    Example: gyrobench tell runs/six_position_fig7-001 hold
    """
    import socket

    from gyrobench.bench.engine.operator import COMMAND_MEANINGS, COMMAND_SIGNALS
    from gyrobench.bench.station.locks import holder_of

    holder = holder_of(run_folder)
    if holder is None:
        raise RunFolderError(f"{run_folder}: no run is under way there on this machine")
    if holder.host != socket.gethostname():
        raise RunFolderError(f"{run_folder}: the run is on {holder.host}, not on this machine. Tell it there")
    number = next(number for number, each in COMMAND_SIGNALS.items() if each is order)
    try:
        os.kill(holder.pid, number)
    except OSError as error:
        raise RunFolderError(f"{run_folder}: process {holder.pid} can't be told: {error.strerror}") from error
    typer.echo(f"Told process {holder.pid} to {order}: {COMMAND_MEANINGS[order]}.")
