"""Commands as they are typed or come from a pipe, while the bench goes on."""

from __future__ import annotations

import os
import select
from collections.abc import Callable

_LOOK_S = 0.1
_CHUNK = 4096


class TypedLines:
    """Lines of standard input.

    Parameters
    ----------
    descriptor : int
        To read from.
    meanwhile : callable
        Called again and again while nothing is typed, and returns soon.
    """

    def __init__(self, descriptor: int, meanwhile: Callable[[], None]) -> None:
        self._descriptor = descriptor
        self._meanwhile = meanwhile
        self._text = b""
        self._ended = False

    def next(self) -> str | None:
        """Wait for a line; None once there are no more."""
        while b"\n" not in self._text and not self._ended:
            ready, _, _ = select.select([self._descriptor], [], [], _LOOK_S)
            if ready:
                self._read()
            else:
                self._meanwhile()
        line, newline, self._text = self._text.partition(b"\n")
        if not line and not newline:
            return None
        return line.decode(errors="replace").strip()

    def _read(self) -> None:
        try:
            data = os.read(self._descriptor, _CHUNK)
        except OSError:  # the terminal has gone
            data = b""
        self._text += data
        self._ended = not data
