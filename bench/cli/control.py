"""`gyrobench control`."""

from __future__ import annotations

from typing import Annotated

import typer

from gyrobench.bench.cli.options import OperatorOption, RunArgument
from gyrobench.bench.engine.operator import RunCommand
from gyrobench.bench.foundations.errors import MissingRunError, RunFolderError

_CommandArgument = Annotated[RunCommand, typer.Argument(help="Command to the run.")]


def control(
    run_folder: RunArgument,
    command: _CommandArgument,
    operator: OperatorOption = "",  # noqa: ARG001 - read from the environment
) -> None:
    """Control a run in progress: pause, continue, hold, skip the dwell, finish the plateau, or abort.

    pause discards the dwell in progress and waits; hold finishes it and waits at its temperature. finish ends
    the run after the last dwell of the plateau in progress: the bench goes to its safe state, and results and
    report are written, as with abort. continue ends a wait, gives the first answer to a question of the
    procedure, and cancels hold and finish. A run that was ended so can be resumed.

    The same commands can be typed in the terminal of the run. The journal records who gave each
    command.

    Exit codes: 0 the run accepted the command; 1 it did not, as a hold accepts only continue and abort, or
    no run is in progress there.

    Example: gyrobench control runs/six_position_fig7-001 hold
    """
    import shlex
    import socket

    from gyrobench.bench.engine.operator import COMMAND_MEANINGS, send_command
    from gyrobench.bench.foundations.clock import WallClock
    from gyrobench.bench.foundations.operator_name import operator_name
    from gyrobench.bench.runs.folder import RunFolder
    from gyrobench.bench.runs.locks import holder_of, is_held_by
    from gyrobench.bench.runs.provenance import run_options

    if not run_folder.is_dir():
        raise MissingRunError(f"{run_folder}: no such folder. Give the folder of the run in progress")
    if RunFolder(run_folder).first_dwells.exists():
        raise RunFolderError(f"{run_folder}: is an investigation. Give the folder of its run in progress")
    holder = holder_of(run_folder)
    if holder is None:
        hint = f". `gyrobench resume {shlex.quote(str(run_folder))} --look` shows what is left of it"
        is_run = RunFolder(run_folder).journal.exists()
        raise RunFolderError(
            f"{run_folder}: no run is in progress there on this machine{hint if is_run else ''}"
        )
    if holder.host != socket.gethostname():
        raise RunFolderError(f"{run_folder}: the run is on {holder.host}. Run gyrobench control there")
    if not is_held_by(run_folder, holder.pid):
        raise RunFolderError(
            f"{run_folder}: its lock names process {holder.pid}, which does not hold it. No signal was sent; "
            "type the command in the run's terminal"
        )
    try:
        reply = send_command(run_folder, command, holder.pid, operator_name())
    except RunFolderError:
        raise
    except OSError as error:
        raise RunFolderError(
            f"{run_folder}: process {holder.pid} can't be signalled: {error.strerror}"
        ) from error
    typer.echo(f"Sent to process {holder.pid}: {command} ({COMMAND_MEANINGS[command]}).")
    if refusal := reply.refusal(WallClock(), lambda: holder_of(run_folder) is not None):
        raise RunFolderError(f"{run_folder}: {command} was not accepted: {refusal}")
    is_virtual = run_options(RunFolder(run_folder)).get("clock") == "virtual"
    if is_virtual and command in (RunCommand.PAUSE, RunCommand.HOLD):
        typer.echo("The run is on virtual time, where it waits for no operator: it continues at once.")


def tell(run_folder: RunArgument, command: _CommandArgument) -> None:
    """Old name of `gyrobench control`."""
    typer.echo("'gyrobench tell' is an old name. Use 'gyrobench control'.", err=True)
    control(run_folder, command)
