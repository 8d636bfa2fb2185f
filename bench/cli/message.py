"""`gyrobench message`."""

from __future__ import annotations

from typing import Annotated

import typer

from gyrobench.bench.cli.options import StationArgument
from gyrobench.bench.cli.output import EXIT_INSTRUMENT


def message(
    station: StationArgument,
    text: Annotated[str, typer.Argument(help="Text of the message.")] = "This is a test. No action required.",
) -> None:
    """Send a test message to all receivers of a station file, and report each reply.

    Exit codes: 0 all accepted it, 2 the station file names no receiver, 3 a receiver was not reached.

    Example: gyrobench message my_bench.yaml "A test of the bench's messages."
    """
    from gyrobench.bench.messages.messenger import send_test

    answers = send_test(station, text)
    for answer in answers:
        typer.echo(f"{'sent' if answer.is_sent else 'NOT SENT':<9}{answer.receiver}: {answer.reply}")
    if not all(answer.is_sent for answer in answers):
        raise typer.Exit(EXIT_INSTRUMENT)
