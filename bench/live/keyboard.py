"""What is typed at standard input, taken without waiting for it."""

from __future__ import annotations

import os
import re
import select
import sys
import termios
import threading
from collections import deque
from typing import Any

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
