"""The journal: what a run did, on the disk before the next thing is done."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

from bench.clock import Clock
from bench.errors import RunFolderError


class Journal:
    """Append-only JSON lines; each is flushed and synced when :meth:`record` returns.

    Every entry has ``time_s`` (the run's clock), ``utc`` and ``event``.

    Raises
    ------
    RunFolderError
        The file can't be written.
    """

    def __init__(self, path: Path, clock: Clock) -> None:
        self._path = path
        self._clock = clock
        try:
            self._stream = path.open("a", encoding="utf-8")
        except OSError as error:
            raise self._failed(error) from error

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stream.close()

    def record(self, event: str, **details: Any) -> None:
        """Add one entry.

        Raises
        ------
        RunFolderError
            It can't be written.
        """
        entry = {"time_s": round(self._clock.now(), 6), "utc": self._clock.utc().isoformat(), "event": event}
        try:
            self._stream.write(json.dumps(entry | details, allow_nan=False) + "\n")
            self._stream.flush()
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise self._failed(error) from error

    def _failed(self, error: OSError) -> RunFolderError:
        return RunFolderError(f"{self._path}: can't be written: {error.strerror}. Is the disk full?")


def read_journal(path: Path) -> Iterator[dict[str, Any]]:
    """Entries of a journal in order; a last line that was cut off is left out.

    Raises
    ------
    RunFolderError
        The file can't be read, or a line before the last one is damaged.
    """
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise RunFolderError(f"{path}: can't be read: {error.strerror}") from error
    for number, line in enumerate(lines, start=1):
        try:
            entry = json.loads(line)
        except json.JSONDecodeError:
            entry = None
        if isinstance(entry, dict):
            yield entry
        elif number < len(lines):
            raise RunFolderError(f"{path}:{number}: damaged entry: {line[:60]!r}")
