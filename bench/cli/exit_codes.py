"""Exit codes of all commands, and the way out with one."""

from __future__ import annotations

import sys
from typing import NoReturn

import typer

from gyrobench.bench.foundations.errors import GyrobenchError

#: The run did not finish, or what was looked at is not as it should be.
EXIT_NOT_FINISHED = 1
#: A file, table or option is wrong.
EXIT_WRONG_INPUT = 2
#: An instrument can't be reached.
EXIT_INSTRUMENT = 3

#: For the help; the lines stay as they are.
EXIT_CODES_HELP = """\b
Exit codes of all commands:
  0  it is done; of run and resume: the run finished
  1  it did not finish, or what was looked at is not as it should be
  2  a file, table or option is wrong; the message says where
  3  an instrument can't be reached, or another run holds the bench

A command's own help says what it adds: gyrobench COMMAND --help
"""


def fail(error: GyrobenchError, code: int) -> NoReturn:
    """Print the error and exit."""
    typer.echo(f"gyrobench: {error}", err=True)
    sys.exit(code)
