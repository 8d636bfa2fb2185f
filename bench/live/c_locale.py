"""Terminals that know ASCII alone."""

from __future__ import annotations

import sys
from collections.abc import Mapping


def is_c_locale(environment: Mapping[str, str]) -> bool:
    """Whether the terminal is said to know ASCII alone; Python writes UTF-8 all the same then."""
    # In its UTF-8 mode Python has set LC_CTYPE itself.
    names = ("LC_ALL", "LANG") if sys.flags.utf8_mode else ("LC_ALL", "LC_CTYPE", "LANG")
    return next((environment[name] for name in names if environment.get(name)), "") in ("C", "POSIX")
