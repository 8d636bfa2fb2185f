"""Small pieces of sentences that every part of the bench writes alike."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence


def listed(texts: Sequence[str]) -> str:
    """Write some things as one: "a, b and c"."""
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def plain_name(name: str) -> str:
    """A key of a file in words: "thermal lag" for "thermal_lag"."""
    return name.replace("_", " ")


def counted(number: int, noun: str) -> str:
    """Write how many: "1 dwell", "2 dwells"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"


def bin_label(low_c: float, high_c: float, between: str = " to ") -> str:
    """Write the range of a bin, without its unit."""
    return f"{low_c:g}{between}{high_c:g}"


def did_you_mean(name: str, allowed: Iterable[str]) -> str:
    """Write " (did you mean 'x'?)" if one of the allowed names is near, else nothing."""
    close = difflib.get_close_matches(name, list(allowed), n=1)
    return f" (did you mean '{close[0]}'?)" if close else ""
