"""The emulators as a child process, which ends with this one.

A child, because the emulators know nothing of station files and the bench knows nothing of the
emulators: this side says where and what to serve, and is told the addresses in one line of JSON.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Sequence
from types import FrameType, TracebackType
from typing import NoReturn, Self

_PROGRAM = ("-m", "gyrobench.drivers.emulators.serve", "--until-stdin-closes")
_END_TIME_S = 10.0


class EmulatorProcess:
    """The emulators of one bench, served as long as this context manager is open.

    Parameters
    ----------
    options : sequence of str
        Options of :mod:`gyrobench.drivers.emulators.serve`.

    Attributes
    ----------
    urls : dict of str to str
        Where ``table``, ``chamber`` and ``ins`` are; empty where the emulators did not start. What was
        wrong they have said on the error output then.
    """

    def __init__(self, options: Sequence[str]) -> None:
        self._process = subprocess.Popen(  # noqa: S603 - this project's own program
            [sys.executable, *_PROGRAM, *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None  # noqa: S101 - for the type checker
        line = self._process.stdout.readline()
        self.urls: dict[str, str] = json.loads(line) if line else {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.terminate()
        self.wait()
        for stream in (self._process.stdin, self._process.stdout):
            assert stream is not None  # noqa: S101 - for the type checker
            stream.close()

    def wait(self) -> int:
        """Wait for their end, or end them at Ctrl-C; returns their exit code."""
        try:
            return self._process.wait()
        except KeyboardInterrupt:
            self._process.terminate()
            return self._process.wait(_END_TIME_S)


def end_at_sigterm() -> None:
    """Let SIGTERM end this process as Ctrl-C does."""
    signal.signal(signal.SIGTERM, _interrupt)


def _interrupt(number: int, frame: FrameType | None) -> NoReturn:  # noqa: ARG001 - handles a signal
    raise KeyboardInterrupt
