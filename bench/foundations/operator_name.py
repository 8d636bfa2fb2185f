"""The operator's name for the audit trail, and the source of a command as text."""

from __future__ import annotations

import getpass
import os
import shlex
import signal
import sys
from pathlib import Path

#: Environment variable with the operator's name.
OPERATOR_VARIABLE = "GYROBENCH_OPERATOR"
_MAX_CHARACTERS = 100
#: Source of a command typed in the terminal of its run.
TERMINAL = "the terminal"
_SOURCES = {
    TERMINAL: "the operator (terminal)",
    "SIGINT": "the operator (Ctrl-C)",
    "SIGTSTP": "the operator (Ctrl-Z)",
    "SIGHUP": "the end of the terminal session (SIGHUP)",
}


def operator_name() -> str:
    """Name of the operator, from the option --operator or GYROBENCH_OPERATOR; else the login name."""
    return os.environ.get(OPERATOR_VARIABLE, "").strip()[:_MAX_CHARACTERS] or login_name()


def login_name() -> str:
    """Login name of the user; "unknown" if there is none, as in some containers."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "unknown"


def command_line() -> str:
    """Command line of this process, with its program's name alone."""
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


def describe_source(by: str) -> str:
    """Describe the source of a command: "the operator (Ctrl-C)" for SIGINT.

    A signal sent by a named operator, such as "anna (SIGTERM)", is a command of ``gyrobench control``.
    """
    signals = signal.Signals.__members__
    name, _, signal_name = by.removesuffix(")").partition(" (")
    if signal_name in signals:
        return f"{name} (gyrobench control)"
    return _SOURCES.get(by, f"another program ({by})" if by in signals else by)
