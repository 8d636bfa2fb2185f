"""Output that never holds a run up: a terminal that takes nothing gets it later, or not at all."""

from __future__ import annotations

import contextlib
import io
import queue
import threading
from collections.abc import Callable
from typing import TextIO

from gyrobench.bench.foundations.clock import Deadline, WallClock

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
