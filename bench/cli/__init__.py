"""The command line: one module a command; each imports what it needs when it runs."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from gyrobench.bench import __version__
from gyrobench.bench.cli import (
    bins,
    check,
    close,
    control,
    emulate,
    export,
    fleet,
    import_log,
    jog,
    message,
    monitor,
    new,
    plan,
    raw_rate,
    record,
    replay,
    report,
    resume,
    run,
    runs,
    schema,
    validate,
    verify,
)
from gyrobench.bench.cli.command_groups import CommandGroups
from gyrobench.bench.cli.output import (
    EXIT_CODES_HELP,
    EXIT_INSTRUMENT,
    EXIT_NOT_FINISHED,
    EXIT_WRONG_INPUT,
    fail,
)
from gyrobench.bench.foundations.errors import BenchInUseError, DocumentError, GyrobenchError, InstrumentError

# The matrices of this project are small: threads of the linear algebra slow each other down.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

app = typer.Typer(
    epilog=EXIT_CODES_HELP,
    cls=CommandGroups,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=True,
    rich_markup_mode=None,
)


def _print_version(is_wanted: bool) -> None:
    if is_wanted:
        typer.echo(f"gyrobench {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Bench controller for calibrating the gyros of inertial navigation systems."""


# In the order of the groups in which the help lists them.
app.command()(run.run)
app.command()(resume.resume)
app.command()(control.control)
app.command(hidden=True)(control.tell)
app.command()(verify.verify)
app.command()(plan.plan)
app.command()(check.check)
app.command()(jog.jog)
app.command()(message.message)
app.command()(monitor.monitor)
app.command()(report.report)
app.command()(export.export)
app.command()(bins.bins)
app.command()(close.close)
app.command("import")(import_log.import_log)
app.command("raw-rate")(raw_rate.raw_rate)
app.command()(runs.runs)
app.add_typer(fleet.fleet, name="fleet")
app.add_typer(new.new, name="new")
app.command()(validate.validate)
app.command()(schema.schema)
app.command()(emulate.emulate)
app.command()(record.record)
app.command()(replay.replay)


def main() -> None:
    """Run the command line; known errors become a message and an exit code."""
    try:
        app()
    except DocumentError as error:
        fail(error, EXIT_WRONG_INPUT)
    except (InstrumentError, BenchInUseError) as error:
        fail(error, EXIT_INSTRUMENT)
    except GyrobenchError as error:
        fail(error, EXIT_NOT_FINISHED)
