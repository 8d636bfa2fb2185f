"""Exit codes of all commands, and the way out with one."""

from __future__ import annotations

import sys
from typing import NoReturn

import typer

from bench.errors import GyrobenchError

#: The run did not finish, or what was looked at is not as it should be.
EXIT_NOT_FINISHED = 1
#: A file, table or option is wrong.
EXIT_WRONG_INPUT = 2
#: An instrument can't be reached.
EXIT_INSTRUMENT = 3


def fail(error: GyrobenchError, code: int) -> NoReturn:
    """Print the error and exit."""
    typer.echo(f"gyrobench: {error}", err=True)
    sys.exit(code)
