"""Why a command by hand is not carried out, or ends early."""

from __future__ import annotations

from gyrobench.bench.foundations.errors import GyrobenchError


class CommandError(GyrobenchError):
    """A command that can't be understood, or that a limit forbids; nothing was moved."""


class StoppedByHandError(GyrobenchError):
    """Somebody pressed Ctrl-C."""


class LeaveError(GyrobenchError):
    """The program is told to end: its terminal closed, or a signal came."""
