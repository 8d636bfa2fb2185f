"""`gyrobench replay`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.output import EXIT_NOT_FINISHED


def replay(
    recording: Annotated[Path, typer.Argument(help="Recording of `gyrobench record`.", show_default=False)],
) -> None:
    """Replay a recording through its driver, and compare the results with the recorded ones.

    Exit codes: 0 same results, 1 different results.

    Example: gyrobench replay chamber.rec
    """
    from gyrobench.bench.recording.replay import replay as replay_recording

    recorded, calls = replay_recording(recording)
    changed = 0
    for recorded_call, call in zip(recorded.header.calls, calls, strict=True):
        is_same = recorded_call == call
        changed += not is_same
        typer.echo(f"{'same   ' if is_same else 'CHANGED'}  {call.ask}: {call.outcome()}")
        if not is_same:
            typer.echo(f"         recorded: {recorded_call.outcome()}")
    if not calls:
        typer.echo("The header of the recording lists no calls of the driver (`calls`).")
    if changed or not calls:
        raise typer.Exit(EXIT_NOT_FINISHED)
