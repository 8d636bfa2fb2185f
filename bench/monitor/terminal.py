"""The terminal of a run of days: keys without waiting, output that never holds the run up."""

from __future__ import annotations

import contextlib
import io
import os
import queue
import re
import select
import sys
import termios
import threading
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TextIO

from rich.console import Console

from gyrobench.bench.foundations.clock import Deadline, WallClock


def is_c_locale(environment: Mapping[str, str]) -> bool:
    """Whether the terminal is said to know ASCII alone; Python writes UTF-8 all the same then."""
    # In its UTF-8 mode Python has set LC_CTYPE itself.
    names = ("LC_ALL", "LANG") if sys.flags.utf8_mode else ("LC_ALL", "LC_CTYPE", "LANG")
    return next((environment[name] for name in names if environment.get(name)), "") in ("C", "POSIX")


class PatientConsole(Console):
    """A console that falls silent when nobody reads it any more: that must not end a run.

    What its terminal can't show, as ± in ASCII, is a question mark there. Parameters are those of
    :class:`rich.console.Console`.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        if isinstance(self.file, io.TextIOWrapper):
            self.file.reconfigure(errors="replace")

    def on_broken_pipe(self) -> None:
        """Print nothing from here on; standard output goes nowhere, so that closing it succeeds."""
        self.quiet = True
        with Path(os.devnull).open("w") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())

    def _write_buffer(self) -> None:
        """Fall silent as well where the terminal has gone."""
        try:
            super()._write_buffer()
        except BrokenPipeError:
            raise
        except OSError:
            self.on_broken_pipe()


#: What waits beyond this many texts is dropped; a run of weeks does not print as much.
_MOST_WAITING = 10_000
_LOOK_EVERY_S = 0.02


class PatientStream(io.TextIOBase):
    """Writes in a thread of its own.

    A terminal that was halted with Ctrl-S, or an ssh connection whose other end sleeps, takes no more
    text; a run that waited for it would be taken for dead by its guard.

    Parameters
    ----------
    stream : TextIO
        Where the text goes.
    on_gone : callable
        Called when nobody reads the stream any more.
    """

    def __init__(self, stream: TextIO, on_gone: Callable[[], None]) -> None:
        self._stream = stream
        self._on_gone = on_gone
        self._texts: queue.Queue[str] = queue.Queue(_MOST_WAITING)
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def write(self, text: str) -> int:
        """Have a text written; returns at once."""
        with contextlib.suppress(queue.Full):
            self._texts.put_nowait(text)
        return len(text)

    @property
    def is_behind(self) -> bool:
        """Whether something waits to be written."""
        return self._texts.unfinished_tasks > 0

    def drain(self, longest_s: float) -> None:
        """Wait until all is written, but no longer than that."""
        clock = WallClock()
        deadline = Deadline(clock, longest_s)
        while self.is_behind and not deadline.expired():
            clock.sleep(_LOOK_EVERY_S)

    def isatty(self) -> bool:
        """Whether it goes to a terminal."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Descriptor of the stream."""
        return self._stream.fileno()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """That of the stream."""
        return self._stream.encoding or "utf-8"

    def _work(self) -> None:
        while True:
            text = self._texts.get()
            try:
                self._stream.write(text)
                self._stream.flush()
            except OSError:
                self._on_gone()
            finally:
                self._texts.task_done()


_MOST_BYTES, _LONGEST_LINE = 1024, 100
#: What arrow keys and the like send.
_SEQUENCE = re.compile(rb"\x1b(\[[0-9;?]*[ -/]*[@-~]|O?.)?")
_BACKSPACE, _CLEAR = "\x7f\b", "\x15\x17"


class Keyboard:
    """Lines that have been typed.

    As a context manager it takes the keys of a terminal one by one and unseen, so that a view which is drawn
    again and again can show them where it wants; the terminal is as before afterwards. Ctrl-C and
    Ctrl-Z go on to be signals.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lines: deque[str] = deque()
        self._begun = ""
        self._before: list[Any] | None = None

    def __enter__(self) -> Keyboard:
        if is_in_foreground():
            descriptor = sys.stdin.fileno()
            self._before = termios.tcgetattr(descriptor)
            unseen = termios.tcgetattr(descriptor)
            unseen[3] &= ~(termios.ECHO | termios.ICANON)
            termios.tcsetattr(descriptor, termios.TCSANOW, unseen)
        return self

    def __exit__(self, *_: object) -> None:
        if self._before is not None:
            before, self._before = self._before, None
            try:
                termios.tcsetattr(sys.stdin.fileno(), termios.TCSANOW, before)
            except (OSError, termios.error):  # the terminal has gone
                return

    @property
    def begun(self) -> str:
        """What has been typed of a line that is not finished."""
        with self._lock:
            self._take_keys()
            return self._begun

    def line(self) -> str:
        """The oldest line that has been typed; empty if there is none."""
        with self._lock:
            if self._before is None:
                return _whole_line()
            self._take_keys()
            return self._lines.popleft() if self._lines else ""

    def _take_keys(self) -> None:
        if self._before is None:
            return
        for key in _typed().decode(errors="ignore"):
            if key in "\r\n":
                self._lines.append(self._begun.strip())
                self._begun = ""
            elif key in _BACKSPACE:
                self._begun = self._begun[:-1]
            elif key in _CLEAR:
                self._begun = ""
            elif key.isprintable():
                self._begun = (self._begun + key)[:_LONGEST_LINE]


def is_in_foreground() -> bool:
    """Whether standard input is a terminal that listens to this process."""
    try:
        return sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError, AttributeError):  # closed, or none at all
        return False


def _typed() -> bytes:
    """Keys that wait to be taken."""
    try:
        if select.select([sys.stdin], [], [], 0.0)[0]:
            return _SEQUENCE.sub(b"", os.read(sys.stdin.fileno(), _MOST_BYTES))
    except (OSError, ValueError):  # the terminal has gone
        pass
    return b""


def _whole_line() -> str:
    """A line that waits at standard input; empty if there is none."""
    try:
        if sys.stdin is None or sys.stdin.closed or not select.select([sys.stdin], [], [], 0.0)[0]:
            return ""
        return sys.stdin.readline().strip()
    except (OSError, ValueError):  # the terminal has gone
        return ""
