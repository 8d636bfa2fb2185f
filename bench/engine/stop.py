"""Requests to stop a run: Ctrl-C, SIGTERM, SIGHUP."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType

from bench.errors import RunStoppedError

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopRequest:
    """Remembers that the run is to stop; the run looks at every tick.

    As a context manager it catches the signals that ask a program to end, so that none of them
    can end it in the middle of an exchange with an instrument.
    """

    def __init__(self) -> None:
        self.reason = ""

    def __enter__(self) -> StopRequest:
        self._previous = {}
        if threading.current_thread() is threading.main_thread():
            # A signal that is ignored, as SIGHUP under nohup, stays ignored.
            heeded = [number for number in _SIGNALS if signal.getsignal(number) is not signal.SIG_IGN]
            self._previous = {number: signal.signal(number, self._caught) for number in heeded}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _caught(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002
        self.request(f"stopped by {signal.Signals(number).name}")

    def request(self, reason: str) -> None:
        """Ask the run to stop; the first reason stays."""
        self.reason = self.reason or reason

    def check(self) -> None:
        """Raise if the run is to stop.

        Raises
        ------
        RunStoppedError
            With the reason.
        """
        if self.reason:
            raise RunStoppedError(self.reason)
