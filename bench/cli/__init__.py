"""The command line: one module a command; each imports what it needs when it runs."""

from __future__ import annotations

import os

import typer

from bench.cli import bins, check, close, import_log, plan, resume, run, tell, verify
from bench.cli.exit_codes import (
    EXIT_INSTRUMENT,
    EXIT_NOT_FINISHED,
    EXIT_WRONG_INPUT,
    fail,
)
from bench.errors import DocumentError, GyrobenchError, InstrumentError

# The matrices of this project are small: threads of the linear algebra only get into each other's way.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

app = typer.Typer(
    help="Bench controller for calibrating the gyros of inertial navigation systems.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=True,
    rich_markup_mode=None,
)

app.command()(run.run)
app.command()(resume.resume)
app.command()(tell.tell)
app.command()(plan.plan)
app.command()(check.check)
app.command()(bins.bins)
app.command()(close.close)
app.command()(verify.verify)
app.command("import")(import_log.import_log)


def main() -> None:
    """Run the command line; known errors become a message and an exit code."""
    try:
        app()
    except DocumentError as error:
        fail(error, EXIT_WRONG_INPUT)
    except InstrumentError as error:
        fail(error, EXIT_INSTRUMENT)
    except GyrobenchError as error:
        fail(error, EXIT_NOT_FINISHED)
