"""`gyrobench replay`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.output import EXIT_NOT_FINISHED


def replay(
    recording: Annotated[Path, typer.Argument(help="Recording of `gyrobench record`.", show_default=False)],
) -> None:
    """Ask a driver again what it was asked in a recording, and compare what it makes of the replies.

    Exit codes: 0 the same as then, 1 something else.

    Example: gyrobench replay chamber.rec
    """
    from gyrobench.bench.recording.replay import replay as replay_recording

    recorded, calls = replay_recording(recording)
    changed = 0
    for then, now in zip(recorded.header.calls, calls, strict=True):
        same = then == now
        changed += not same
        typer.echo(f"{'same   ' if same else 'CHANGED'}  {now.ask}: {now.outcome()}")
        if not same:
            typer.echo(f"         recorded: {then.outcome()}")
    if not calls:
        typer.echo("No call of the driver is in the header (`calls`), so nothing was asked.")
    if changed or not calls:
        raise typer.Exit(EXIT_NOT_FINISHED)
