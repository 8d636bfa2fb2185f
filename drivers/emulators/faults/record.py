"""What was injected, and when: in memory, and as JSON lines in a file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

from gyrobench.bench.foundations.errors import DocumentError


class Injected(NamedTuple):
    """One injection: time on the bench's clock, and kind of fault."""

    time_s: float
    kind: str


class InjectionRecord:
    """Keeps the injections, and adds each to a log file at once.

    Parameters
    ----------
    injected : list of Injected
        Where they are kept.
    log : Path, optional
        A file to add lines to, made when missing.

    Raises
    ------
    DocumentError
        The file can't be written.
    """

    def __init__(self, injected: list[Injected], log: Path | None) -> None:
        self._injected = injected
        self._log = log
        self._write("")

    def add(self, time_s: float, kind: str) -> None:
        """Note one injection."""
        self._injected.append(Injected(time_s, kind))
        self._write(json.dumps({"time_s": round(time_s, 3), "fault": kind}) + "\n")

    def _write(self, line: str) -> None:
        if self._log is None:
            return
        try:
            with self._log.open("a", encoding="utf-8") as file:
                file.write(line)
        except OSError as error:
            raise DocumentError(
                f"{self._log}: the log of faults can't be written: {error.strerror}"
            ) from error
