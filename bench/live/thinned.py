"""Rows of a long time, thinned so that their number stays bounded."""

from __future__ import annotations

from typing import Generic, TypeVar

T = TypeVar("T")


class Thinned(Generic[T]):
    """Keeps every n-th row, evenly over all that came; n doubles whenever there are too many.

    Parameters
    ----------
    most : int
        So many rows are given at most, the newest always among them.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: list[T] = []
        self._newest: T | None = None
        self._count = 0
        self._every = 1

    def add(self, row: T) -> None:
        """Add the next row."""
        if self._count % self._every == 0:
            self._kept.append(row)
        self._count += 1
        self._newest = row
        if len(self._kept) >= self._most:
            self._kept = self._kept[::2]
            self._every *= 2

    def rows(self) -> list[T]:
        """Rows in order."""
        if self._newest is None or self._kept[-1] is self._newest:
            return list(self._kept)
        return [*self._kept, self._newest]
