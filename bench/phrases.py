"""Small pieces of sentences that every part of the bench writes alike."""

from __future__ import annotations

from collections.abc import Sequence


def listed(texts: Sequence[str]) -> str:
    """Write some things as one: "a, b and c"."""
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def spoken(name: str) -> str:
    """Name of a file's key as people write it: "thermal lag" for "thermal_lag"."""
    return name.replace("_", " ")
