"""The guard's own log."""

from __future__ import annotations

import os
from pathlib import Path

from gyrobench.bench.foundations.clock import Clock


class GuardLog:
    """Lines with their time; what can't be written is lost, since the bench matters more.

    Parameters
    ----------
    path : Path
        The file; it is appended to.
    clock : Clock
        Tells the time.
    """

    def __init__(self, path: Path, clock: Clock) -> None:
        self._path = path
        self._clock = clock

    def add(self, text: str) -> None:
        """Add one line; it is on the disk when this returns, if it can be."""
        line = f"{self._clock.utc().isoformat(timespec='milliseconds')} guard {os.getpid()}: {text}\n"
        try:
            with self._path.open("a", encoding="utf-8") as stream:
                stream.write(line)
                stream.flush()
                os.fsync(stream.fileno())
        except OSError:
            return
