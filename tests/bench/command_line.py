"""The command line as it is typed: in a process of its own, or without the seconds that it takes to start."""

import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

from gyrobench.bench.cli import main
from gyrobench.bench.cli.output import EXIT_WRONG_INPUT

WIDTH = {"COLUMNS": "80"}
# As the installed script, which does not import from the current folder.
PROCESS = (sys.executable, "-P", "-c", "from gyrobench.bench.cli import main; main()")


def gyrobench_process(*arguments, cwd):
    """Run a command in a process of its own."""
    command = [*PROCESS, *map(str, arguments)]
    return subprocess.run(
        command, cwd=cwd, capture_output=True, text=True, timeout=200, env=os.environ | WIDTH
    )


def gyrobench(*arguments, cwd, typed=os.devnull):
    """Run a command in this process; exit code and output are those of a process of its own.

    ``typed``: file that it reads as standard input.
    """
    printed, complained = StringIO(), StringIO()
    with (
        pytest.MonkeyPatch.context() as patch,
        Path(typed).open() as standard_input,
        redirect_stdout(printed),
        redirect_stderr(complained),
    ):
        patch.chdir(cwd)
        patch.setattr(sys, "argv", ["gyrobench", *map(str, arguments)])
        patch.setattr(sys, "stdin", standard_input)
        for name, value in WIDTH.items():
            patch.setenv(name, value)
        code = _code_of(main)
    return subprocess.CompletedProcess(arguments, code, printed.getvalue(), complained.getvalue())


def _code_of(program):
    try:
        program()
    except SystemExit as end:
        return end.code or 0
    return 0


def output_of(*arguments, cwd, code=0):
    """What a command prints that ends with the exit code ``code``."""
    done = gyrobench(*arguments, cwd=cwd)
    assert done.returncode == code, done.stderr
    return done.stdout


def refusal_of(*arguments, cwd, code=EXIT_WRONG_INPUT):
    """What a command answers that refuses its input, or ends with another exit code ``code``."""
    done = gyrobench(*arguments, cwd=cwd)
    assert done.returncode == code, done.stdout
    return done.stderr
