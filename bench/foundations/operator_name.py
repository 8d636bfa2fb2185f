"""Who acts: the operator's name, for the audit trail."""

from __future__ import annotations

import getpass
import os

#: Environment variable with the operator's name.
OPERATOR_VARIABLE = "GYROBENCH_OPERATOR"
_MAX_CHARACTERS = 100


def operator_name() -> str:
    """Name of the operator: of the option --operator or GYROBENCH_OPERATOR, else the login name."""
    return os.environ.get(OPERATOR_VARIABLE, "").strip()[:_MAX_CHARACTERS] or login_name()


def login_name() -> str:
    """Login name of the user; unknown in some containers."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "unknown"
