"""The command line: one module a command. Each is loaded, and imports what it needs, when it is used."""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from gyrobench.bench.cli.command_groups import CommandGroups
from gyrobench.bench.cli.output import (
    EXIT_CODES_HELP,
    EXIT_INSTRUMENT,
    EXIT_NOT_FINISHED,
    EXIT_WRONG_INPUT,
    fail,
)
from gyrobench.bench.foundations.errors import (
    BenchInUseError,
    DocumentError,
    GyrobenchError,
    InstrumentError,
    MissingRunError,
)

# The matrices of this project are small: threads of the linear algebra slow each other down.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Its tables are small too: a pool takes 4 MB in advance.
os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")
# To look for plugins of pydantic, it reads the metadata of all packages.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
# Where they are installed, numba would import coverage, for a tenth of its time, and pyarrow.parquet the
# clients of remote file systems, 3.5 MB.
for _unused in ("coverage", "pyarrow._azurefs", "pyarrow._gcsfs", "pyarrow._hdfs", "pyarrow._s3fs"):
    sys.modules.setdefault(_unused, None)  # type: ignore[arg-type]

#: Modules leave half a million objects that stay: to search them for cycles as often as Python does takes a
#: fifth of the time to start.
_GC_THRESHOLD = (50_000, 10, 10)

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
        from gyrobench.bench import __version__

        typer.echo(f"gyrobench {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Bench controller for calibrating the gyros of inertial navigation systems."""


def main() -> None:
    """Run the command line; known errors become a message and an exit code."""
    gc.set_threshold(*_GC_THRESHOLD)
    # Processes that a command starts import nothing from the current folder, which another user may write.
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        Path.cwd()
    except FileNotFoundError:
        fail(GyrobenchError("the current folder was deleted. Change to another one"), EXIT_WRONG_INPUT)
    try:
        app()
    except (DocumentError, MissingRunError) as error:
        fail(error, EXIT_WRONG_INPUT)
    except (InstrumentError, BenchInUseError) as error:
        fail(error, EXIT_INSTRUMENT)
    except GyrobenchError as error:
        fail(error, EXIT_NOT_FINISHED)
