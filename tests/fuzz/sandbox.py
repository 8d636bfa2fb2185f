"""Watches what the code under test does to the machine."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

_STARTS = (
    "subprocess.",
    "os.exec",
    "os.posix_spawn",
    "os.fork",
    "os.system",
    "os.spawn",
    "pty.",
    "ctypes.dlopen",
)
_NETWORK = ("socket.connect", "socket.bind", "socket.getaddrinfo", "urllib.")
_CHANGES = (
    "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.symlink", "os.truncate", "os.chmod",
    "os.chown", "os.utime",
)  # fmt: skip
_WRITE_FLAGS = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


class HangError(BaseException):
    """An input took too long; no ``except Exception`` holds it up."""


class Sandbox:
    """Notes what is written outside a folder, and processes and connections that are started.

    One of its kind can be made in a process, which never gets rid of it.

    Attributes
    ----------
    broken : list of str
        What was done that should not have been, since the last :meth:`inside`.
    """

    def __init__(self) -> None:
        self.broken: list[str] = []
        self._folder = ""
        self._watching = False
        sys.dont_write_bytecode = True  # of drivers that are imported when a station names them
        sys.addaudithook(self._noticed)

    @contextmanager
    def inside(self, folder: Path, work_s: float, wait_s: float) -> Iterator[None]:
        """Let nothing be written outside a folder, nor anything last too long.

        Parameters
        ----------
        work_s, wait_s : float
            Limits of the processor's time, and of the time that passes.

        Raises
        ------
        HangError
            It did.
        """
        self.broken = []
        self._folder = os.path.realpath(folder) + os.sep
        for number in (signal.SIGPROF, signal.SIGALRM):
            signal.signal(number, self._rang)
        signal.setitimer(signal.ITIMER_PROF, work_s)
        signal.setitimer(signal.ITIMER_REAL, wait_s)
        self._watching = True
        try:
            yield
        finally:
            self._watching = False
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _rang(self, number: int, frame: FrameType | None) -> None:
        raise HangError

    def _noticed(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self._watching:
            return
        if event == "open":
            path, mode, flags = arguments
            writes = flags & _WRITE_FLAGS if isinstance(flags, int) else set(mode or "r") & set("wax+")
            if writes and not isinstance(path, int):
                self._check(event, path)
        elif event.startswith(_CHANGES):
            for path in arguments[:2]:
                if isinstance(path, str | bytes | os.PathLike):
                    self._check(event, path)
        elif event.startswith((*_STARTS, *_NETWORK)):
            self.broken.append(f"{event} {arguments!r:.200}")

    def _check(self, event: str, path: str | bytes | os.PathLike[str]) -> None:
        name = os.fsdecode(path)
        # Resolving opens nothing, so this can't come back here.
        real = str(Path(name).parent.resolve() / Path(name).name)
        if not (real + os.sep).startswith(self._folder) and real != os.devnull:
            self.broken.append(f"{event} {name}")
