"""The terminal of manual control: what is typed, what is printed, Ctrl-C."""

from __future__ import annotations

import contextlib
import os
import select
import signal
from collections.abc import Callable
from types import FrameType, TracebackType
from typing import Any, Self, TextIO

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import GyrobenchError

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


_LEAVES = (signal.SIGTERM, signal.SIGHUP)


class Interruptions:
    """Remembers signals until somebody asks; a context manager."""

    def __init__(self) -> None:
        self._stop = self._leave = False
        self._former: dict[int, Any] = {}

    def __enter__(self) -> Self:
        for number in (signal.SIGINT, *_LEAVES):
            self._former[number] = signal.signal(number, self._received)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._former.items():
            signal.signal(number, handler)

    def check(self) -> None:
        """Raise what has come since the last call.

        Raises
        ------
        StoppedByOperatorError
            Ctrl-C was pressed.
        EndSessionError
            The program is to end.
        """
        if self._leave:
            raise EndSessionError("told to end")
        if self._stop:
            self._stop = False
            raise StoppedByOperatorError("stopped by Ctrl-C")

    def _received(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002 - a handler's signature
        if number == signal.SIGINT:
            self._stop = True
        else:
            self._leave = True


class CommandError(GyrobenchError):
    """A command that can't be understood, or that a limit forbids; nothing was moved."""


class StoppedByOperatorError(GyrobenchError):
    """Somebody pressed Ctrl-C."""


class EndSessionError(GyrobenchError):
    """The program is told to end: its terminal closed, or a signal came."""
