"""What a person sees: lines, and one line that follows a motion."""

from __future__ import annotations

import contextlib
from typing import TextIO

from gyrobench.bench.foundations.clock import Clock

#: Where lines can't be written over, one comes this often.
_EVERY_S = 5.0
_ERASE = "\r\x1b[K"


class Display:
    """Writes to a terminal, a file or a pipe; one that has gone away is not written to any more.

    Parameters
    ----------
    stream : TextIO
        Where to.
    clock : Clock
        The bench's.
    """

    def __init__(self, stream: TextIO, clock: Clock) -> None:
        self._stream = stream
        self._clock = clock
        self._can_erase = stream.isatty() and not clock.is_virtual
        self._open_line = False
        self._next_course_s = 0.0

    def tell(self, text: str) -> None:
        """Write lines."""
        self._end_line()
        self._write(f"{text}\n")

    def course(self, text: str) -> None:
        """Show how far something is; on a terminal in place of the last time."""
        if self._can_erase:
            self._open_line = True
            self._write(f"{_ERASE}{text}")
        elif self._clock.now() >= self._next_course_s:
            self._next_course_s = self._clock.now() + _EVERY_S
            self._write(f"{text}\n")

    def prompt(self, text: str) -> None:
        """Write what stands before a command that is typed."""
        self._end_line()
        self._write(text)

    def _end_line(self) -> None:
        if self._open_line:
            self._open_line = False
            self._write("\n")

    def _write(self, text: str) -> None:
        with contextlib.suppress(
            OSError, ValueError
        ):  # the terminal has gone; the bench is still to be made safe
            self._stream.write(text)
            self._stream.flush()
