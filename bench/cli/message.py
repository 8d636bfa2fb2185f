"""`gyrobench message`."""

from __future__ import annotations

from typing import Annotated

import typer

from gyrobench.bench.cli.options import StationArgument
from gyrobench.bench.cli.output import EXIT_INSTRUMENT


def message(
    station: StationArgument,
    text: Annotated[str, typer.Argument(help="What to tell.")] = "This is a test. Nothing is to be done.",
) -> None:
    """Send a test message to everybody that a station file names, and say what each answered.

    Exit codes: 0 all took it, 2 the station file names nobody, 3 somebody could not be reached.

    Example: gyrobench message my_bench.yaml "A test of the bench's messages."
    """
    from gyrobench.bench.messages.messenger import send_test

    answers = send_test(station, text)
    for answer in answers:
        typer.echo(f"{'sent' if answer.is_sent else 'NOT SENT':<9}{answer.receiver}: {answer.reply}")
    if not all(answer.is_sent for answer in answers):
        raise typer.Exit(EXIT_INSTRUMENT)
