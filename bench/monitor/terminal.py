"""The terminal of a run of days: keys are read without waiting, and output never blocks the run."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import queue
import re
import select
import sys
import threading
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TextIO

from rich.console import Console

from gyrobench.bench.foundations.clock import Deadline, WallClock


def is_c_locale(environment: Mapping[str, str]) -> bool:
    """Whether the locale is plain ASCII; Python writes UTF-8 even then."""
    # In its UTF-8 mode Python has set LC_CTYPE itself.
    names = ("LC_ALL", "LANG") if sys.flags.utf8_mode else ("LC_ALL", "LC_CTYPE", "LANG")
    return next((environment[name] for name in names if environment.get(name)), "") in ("C", "POSIX")


class RunConsole(Console):
    """A rich console that becomes quiet when its terminal is closed, so that the run continues.

    Characters that the terminal can't show, such as ± in ASCII, are printed as question marks. With
    ``raises_full_disk`` output to a full disk raises OSError.
    """

    def __init__(self, raises_full_disk: bool = False, **options: Any) -> None:
        super().__init__(**options)
        self._raises_full_disk = raises_full_disk
        if isinstance(self.file, io.TextIOWrapper):
            self.file.reconfigure(errors="replace")

    def on_broken_pipe(self) -> None:
        """Become quiet; standard output is redirected to the null device, so that closing it succeeds."""
        self.quiet = True
        with Path(os.devnull).open("w") as null_device:
            os.dup2(null_device.fileno(), sys.stdout.fileno())

    def _write_buffer(self) -> None:
        """Become quiet also on other errors of a closed terminal."""
        try:
            super()._write_buffer()
        except BrokenPipeError:
            raise
        except OSError as error:
            self.on_broken_pipe()
            if self._raises_full_disk and error.errno == errno.ENOSPC:
                raise


#: Further texts are dropped; a run of weeks prints fewer.
_MAX_QUEUED_TEXTS = 10_000
_POLL_S = 0.02


class BackgroundStream(io.TextIOBase):
    """Writes to a stream in a separate thread.

    A terminal that is halted with Ctrl-S, or an ssh connection whose client sleeps, blocks every write; the
    guard would treat a run that waits for it as dead. ``on_closed`` is called when the stream is closed.
    """

    def __init__(self, stream: TextIO, on_closed: Callable[[], None]) -> None:
        self._stream = stream
        self._on_closed = on_closed
        self._texts: queue.Queue[str] = queue.Queue(_MAX_QUEUED_TEXTS)
        self._thread = threading.Thread(target=self._write_queued, daemon=True)
        self._thread.start()

    def write(self, text: str) -> int:
        """Queue a text; returns at once."""
        with contextlib.suppress(queue.Full):
            self._texts.put_nowait(text)
        return len(text)

    @property
    def is_behind(self) -> bool:
        """Whether texts are waiting to be written."""
        return self._texts.unfinished_tasks > 0

    def drain(self, max_s: float) -> None:
        """Wait until all is written, at most for ``max_s``."""
        clock = WallClock()
        deadline = Deadline(clock, max_s)
        while self.is_behind and not deadline.expired():
            clock.sleep(_POLL_S)

    def isatty(self) -> bool:
        """Whether the stream is a terminal."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Descriptor of the stream."""
        return self._stream.fileno()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        """Encoding of the stream."""
        return self._stream.encoding or "utf-8"

    def _write_queued(self) -> None:
        while True:
            text = self._texts.get()
            try:
                self._stream.write(text)
                self._stream.flush()
            except OSError:
                self._on_closed()
            finally:
                self._texts.task_done()


_MAX_BYTES, _MAX_LINE = 1024, 100
#: Sequences that arrow keys and similar keys send.
_ESCAPE_SEQUENCE = re.compile(rb"\x1b(\[[0-9;?]*[ -/]*[@-~]|O?.)?")
_BACKSPACE, _CLEAR = "\x7f\b", "\x15\x17"


class Keyboard:
    """Reads lines typed at standard input.

    As a context manager it switches off line editing and echo of a POSIX terminal, so that a view can show
    the typed keys itself; Ctrl-C and Ctrl-Z still send signals.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._lines: deque[str] = deque()
        self._unfinished = ""
        self._saved_attributes: list[Any] | None = None

    def __enter__(self) -> Keyboard:
        if is_in_foreground():
            import termios

            descriptor = sys.stdin.fileno()
            self._saved_attributes = termios.tcgetattr(descriptor)
            attributes = termios.tcgetattr(descriptor)
            attributes[3] &= ~(termios.ECHO | termios.ICANON)
            termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
        return self

    def __exit__(self, *_: object) -> None:
        if self._saved_attributes is not None:
            import termios

            saved, self._saved_attributes = self._saved_attributes, None
            with contextlib.suppress(OSError, termios.error):  # the terminal is closed
                termios.tcsetattr(sys.stdin.fileno(), termios.TCSANOW, saved)

    @property
    def unfinished(self) -> str:
        """Keys typed since the last complete line."""
        with self._lock:
            self._process_keys()
            return self._unfinished

    def line(self) -> str:
        """Oldest line typed; empty if there is none."""
        with self._lock:
            if self._saved_attributes is None:
                return _read_line()
            self._process_keys()
            return self._lines.popleft() if self._lines else ""

    def _process_keys(self) -> None:
        """Append the waiting keys to the typed lines."""
        if self._saved_attributes is None:
            return
        for key in _read_keys().decode(errors="ignore"):
            if key in "\r\n":
                self._lines.append(self._unfinished.strip())
                self._unfinished = ""
            elif key in _BACKSPACE:
                self._unfinished = self._unfinished[:-1]
            elif key in _CLEAR:
                self._unfinished = ""
            elif key.isprintable():
                self._unfinished = (self._unfinished + key)[:_MAX_LINE]


def is_in_foreground() -> bool:
    """Whether standard input is a POSIX terminal with this process in the foreground."""
    try:
        return sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError, AttributeError):  # closed, or none at all
        return False


def _read_keys() -> bytes:
    """Keys waiting at standard input."""
    try:
        if select.select([sys.stdin], [], [], 0.0)[0]:
            return _ESCAPE_SEQUENCE.sub(b"", os.read(sys.stdin.fileno(), _MAX_BYTES))
    except (OSError, ValueError):  # the terminal is closed
        pass
    return b""


def _read_line() -> str:
    """A line waiting at standard input; empty if there is none."""
    try:
        if sys.stdin is None or sys.stdin.closed or not select.select([sys.stdin], [], [], 0.0)[0]:
            return ""
        return sys.stdin.readline().strip()
    except (OSError, ValueError):  # the terminal is closed
        return ""
