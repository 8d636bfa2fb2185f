"""The terminal of manual control: typed lines, printed lines, Ctrl-C, and errors of commands."""

from __future__ import annotations

import contextlib
import os
import select
import signal
from collections.abc import Callable
from types import FrameType
from typing import Any, Self, TextIO

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import GyrobenchError

#: Period of progress lines if a line can't be overwritten.
_PROGRESS_PERIOD_S = 5.0
_ERASE = "\r\x1b[K"
_INPUT_WAIT_S = 0.1
_CHUNK = 4096
_MAX_COMMAND_BYTES = 1000
#: Limit of the input read at the end of a session: a program may write without end.
_MAX_ARRIVED_BYTES = 1_000_000


class CommandError(GyrobenchError):
    """A command is invalid or a limit forbids it; nothing was moved."""


class StoppedByOperatorError(GyrobenchError):
    """The operator pressed Ctrl-C."""


class EndSessionError(GyrobenchError):
    """The terminal closed, or a signal ends the program."""


class Display:
    """Prints to a terminal, a file or a pipe; ignores a stream that has closed."""

    def __init__(self, stream: TextIO, clock: Clock) -> None:
        self._stream = stream
        self._clock = clock
        self._can_erase = stream.isatty() and not clock.is_virtual
        self._open_line = False
        self._next_progress_s = 0.0

    def print(self, text: str) -> None:
        """Print lines."""
        self._end_line()
        self._write(f"{text}\n")

    def progress(self, text: str) -> None:
        """Print a progress line; on a terminal it overwrites the previous one."""
        if self._can_erase:
            self._open_line = True
            self._write(f"{_ERASE}{text}")
        elif self._clock.now() >= self._next_progress_s:
            self._next_progress_s = self._clock.now() + _PROGRESS_PERIOD_S
            self._write(f"{text}\n")

    def prompt(self, text: str) -> None:
        """Print the prompt."""
        self._end_line()
        self._write(text)

    def _end_line(self) -> None:
        if self._open_line:
            self._open_line = False
            self._write("\n")

    def _write(self, text: str) -> None:
        # A closed terminal must not prevent the bench from reaching its safe state.
        with contextlib.suppress(OSError, ValueError):
            self._stream.write(text)
            self._stream.flush()


class TypedLines:
    """Lines of standard input, read while the bench is polled.

    ``meanwhile``: called before every wait for input; must return soon.
    """

    def __init__(self, descriptor: int, meanwhile: Callable[[], None]) -> None:
        self._descriptor = descriptor
        self._meanwhile = meanwhile
        self._text = b""
        self._ended = False
        self._skips_rest = False

    def next(self) -> str | None:
        """Wait for a line; None at the end of the input.

        Raises CommandError if a line is too long; its rest is skipped.
        """
        while b"\n" not in self._text and len(self._text) <= _MAX_COMMAND_BYTES and not self._ended:
            self._meanwhile()
            ready, _, _ = select.select([self._descriptor], [], [], _INPUT_WAIT_S)
            if ready:
                self._read()
        line, newline, self._text = self._text.partition(b"\n")
        if len(line) > _MAX_COMMAND_BYTES:
            self._skips_rest = not newline
            raise CommandError(f"a command is at most {_MAX_COMMAND_BYTES} bytes long. Nothing was done.")
        if not line and not newline:
            return None
        return line.decode(errors="replace").strip()

    def read_arrived(self) -> list[str]:
        """Lines that have arrived and were not read; does not wait."""
        while not self._ended and len(self._text) < _MAX_ARRIVED_BYTES:
            ready, _, _ = select.select([self._descriptor], [], [], 0.0)
            if not ready:
                break
            self._read()
        return [line.decode(errors="replace").strip() for line in self._text.split(b"\n")]

    def _read(self) -> None:
        try:
            data = os.read(self._descriptor, _CHUNK)
        except OSError:  # the terminal closed
            data = b""
        self._ended = not data
        if self._skips_rest:
            _, newline, data = data.partition(b"\n")
            self._skips_rest = not newline
        self._text += data


class Interruptions:
    """Stores Ctrl-C and end signals until they are checked, so that no exchange is interrupted."""

    def __init__(self) -> None:
        self._stop = self._end = False
        self._previous_handlers: dict[int, Any] = {}

    def __enter__(self) -> Self:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            self._previous_handlers[number] = signal.signal(number, self._handle_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous_handlers.items():
            signal.signal(number, handler)

    def check(self) -> None:
        """Raise an exception for a signal that has arrived since the last call.

        Raises StoppedByOperatorError if Ctrl-C was pressed. Raises EndSessionError if SIGTERM or SIGHUP
        arrived; raised by every later call too.
        """
        if self._end:
            raise EndSessionError("the session ends: its terminal closed or it was terminated.")
        if self._stop:
            self._stop = False
            raise StoppedByOperatorError("stopped by Ctrl-C")

    def _handle_signal(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002 - a handler's signature
        if number == signal.SIGINT:
            self._stop = True
        else:
            self._end = True
