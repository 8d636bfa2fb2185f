"""Commands as they are typed or come from a pipe, while the bench goes on."""

from __future__ import annotations

import os
import select
from collections.abc import Callable

from gyrobench.bench.jog.refused import CommandError

_LOOK_S = 0.1
_CHUNK = 4096
#: No command is longer.
_LONGEST_LINE_BYTES = 1000


class TypedLines:
    """Lines of standard input.

    Parameters
    ----------
    descriptor : int
        To read from.
    meanwhile : callable
        Called before every look for input, and returns soon.
    """

    def __init__(self, descriptor: int, meanwhile: Callable[[], None]) -> None:
        self._descriptor = descriptor
        self._meanwhile = meanwhile
        self._text = b""
        self._ended = False
        self._skips = False

    def next(self) -> str | None:
        """Wait for a line; None once there are no more.

        Raises
        ------
        CommandError
            A line is longer than any command; what is left of it is passed over.
        """
        while b"\n" not in self._text and len(self._text) <= _LONGEST_LINE_BYTES and not self._ended:
            self._meanwhile()
            ready, _, _ = select.select([self._descriptor], [], [], _LOOK_S)
            if ready:
                self._read()
        line, newline, self._text = self._text.partition(b"\n")
        if len(line) > _LONGEST_LINE_BYTES:
            self._skips = not newline
            raise CommandError(f"a command is at most {_LONGEST_LINE_BYTES} bytes long. Nothing was done.")
        if not line and not newline:
            return None
        return line.decode(errors="replace").strip()

    def _read(self) -> None:
        try:
            data = os.read(self._descriptor, _CHUNK)
        except OSError:  # the terminal has gone
            data = b""
        self._ended = not data
        if self._skips:
            _, newline, data = data.partition(b"\n")
            self._skips = not newline
        self._text += data
