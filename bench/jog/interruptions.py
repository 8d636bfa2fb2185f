"""Ctrl-C and the end of the terminal, noticed between exchanges and never in the middle of one."""

from __future__ import annotations

import signal
from types import FrameType, TracebackType
from typing import Any, Self

from gyrobench.bench.jog.refused import LeaveError, StoppedByHandError

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
        StoppedByHandError
            Ctrl-C was pressed.
        LeaveError
            The program is to end.
        """
        if self._leave:
            raise LeaveError("told to end")
        if self._stop:
            self._stop = False
            raise StoppedByHandError("stopped by Ctrl-C")

    def _received(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002 - a handler's signature
        if number == signal.SIGINT:
            self._stop = True
        else:
            self._leave = True
