"""The journal, which records each event of a run on the disk before the next action, and its summary."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from filelock import lock_descriptor

from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import (
    parse_json,
    read_lines,
    sync_folder,
    with_nan_as_none,
    write_error,
)

#: A few hundred times the size of the journal of a 1000 h run.
MAX_JOURNAL_BYTES = 500_000_000
_MAX_EXCERPT_CHARACTERS = 60
#: Key of the link of an entry to the previous line: SHA-256 of that line, empty for the first.
_LINK_KEY = "previous_sha256"
#: Key in an entry: numbers of the lines whose link is broken because damaged lines before were discarded.
BROKEN_LINKS = "broken_links"


class Journal:
    """Append-only JSON lines; each is on the disk when :meth:`record` returns.

    Every entry has ``time_s`` (the run's clock), ``utc``, ``event`` and the SHA-256 of the previous line,
    so that the change of a single line is detected. An existing journal is continued. If its last line was
    cut off, that line is removed and an entry ``journal_repaired`` added. Raises RunFolderError if the file
    can't be written, another process writes it, or it is damaged before its last line.
    """

    def __init__(self, path: Path, clock: Clock) -> None:
        self._path = path
        self._clock = clock
        self.followers: list[Journal] = []  #: Journals that also receive each entry.
        self._write_lock = threading.Lock()  # messages are sent by separate threads
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        except OSError as error:
            raise write_error(path, error) from error
        try:
            self._lock()
            self._intact_bytes, self._last_line, cut_off = self._find_end()
        except BaseException:
            self.close()
            raise
        if cut_off:
            self.record("journal_repaired", cut_off=_excerpt(cut_off))

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; all entries are already on the disk."""
        with contextlib.suppress(OSError):
            os.close(self._descriptor)

    def record(self, event: str, **details: Any) -> None:
        """Add one entry; numbers that are not finite become null.

        Raises RunFolderError if it can't be written; the journal is then unchanged.
        """
        with self._write_lock:
            self._write({"event": event} | details)
        for follower in tuple(self.followers):
            follower.record(event, **details)

    def _write(self, content: dict[str, Any]) -> None:
        entry = {"time_s": round(self._clock.now(), 6), "utc": self._clock.utc().isoformat()}
        link = {_LINK_KEY: _sha256(self._last_line) if self._last_line else ""}
        text = json.dumps(with_nan_as_none(entry | content | link), allow_nan=False).encode()
        line = text + b"\n"
        try:
            self._remove_partial_line()
            written = os.write(self._descriptor, line)
            while written < len(line):
                written += os.write(self._descriptor, line[written:])
            os.fsync(self._descriptor)
        except OSError as error:
            with contextlib.suppress(OSError):  # the next entry tries again
                self._remove_partial_line()
            raise write_error(self._path, error) from error
        self._intact_bytes += len(line)
        self._last_line = text

    def _lock(self) -> None:
        """Lock the file; raises RunFolderError if another process holds it."""
        try:
            is_free = lock_descriptor(self._descriptor, blocking=False)
        except OSError:  # a file system or a platform without locks
            is_free = True
        if not is_free:
            raise RunFolderError(
                f"{self._path}: another process is writing this run. Wait for its end, or stop it."
            )

    def _find_end(self) -> tuple[int, bytes, bytes]:
        """Number of intact bytes, the last intact line, and what follows it."""
        try:
            sync_folder(self._path.parent)
            intact_bytes, last_line = 0, b""
            with self._path.open("rb") as lines:
                for _, line in _parse(self._path, lines):
                    intact_bytes, last_line = intact_bytes + len(line), line
                lines.seek(intact_bytes)
                return intact_bytes, last_line.removesuffix(b"\n"), lines.read(_MAX_EXCERPT_CHARACTERS)
        except RunFolderError:
            raise
        except OSError as error:
            raise write_error(self._path, error) from error

    def _remove_partial_line(self) -> None:
        if os.fstat(self._descriptor).st_size != self._intact_bytes:
            os.ftruncate(self._descriptor, self._intact_bytes)


def read_journal(path: Path) -> Iterator[dict[str, Any]]:
    """Entries of a journal in order, without a last line that was cut off.

    Raises RunFolderError if the file can't be read, or a line before the last one is damaged.
    """
    yield from parse_journal(journal_lines(path), path)


def parse_journal(lines: Iterable[bytes], name: str | Path) -> Iterator[dict[str, Any]]:
    """Entries in the lines of a journal, as :func:`read_journal`; ``name``: of the file, for messages."""
    yield from (entry for entry, _ in _parse(name, lines))


def journal_lines(path: Path) -> Iterator[bytes]:
    """Lines of a journal, including their line ends. Raises RunFolderError if the file can't be read."""
    return read_lines(path, MAX_JOURNAL_BYTES, RunFolderError)


def intact_lines(content: bytes) -> tuple[list[bytes], int]:
    """Lines of a journal that hold an entry, and the number of damaged lines, without a cut-off last line."""
    lines = content.split(b"\n")[:-1]
    intact = [line for line in lines if _parse_entry(line) is not None]
    return intact, len(lines) - len(intact)


def is_linked(path: Path) -> bool:
    """Whether the first line of a journal has a link; older versions wrote none."""
    try:
        with path.open("rb") as stream:
            return _LINK_KEY in (_parse_entry(stream.readline()) or {})
    except OSError:
        return False


def broken_links(lines: Iterable[bytes]) -> list[int]:
    """Numbers, from 1, of the lines whose link does not match the previous line; empty for an intact journal.

    A journal without links counts as intact. Links that an entry ``data_given_up`` lists are skipped.
    ``lines`` include their line ends; a line that was cut off is skipped.
    """
    broken, explained, is_linked = [], set(), False
    previous = b""
    for number, line in enumerate(_complete_lines(lines), start=1):
        entry = _parse_entry(line) or {}
        link = entry.get(_LINK_KEY)
        if link is None:
            broken += [number] if is_linked else []
        elif link != (_sha256(previous) if previous else ""):
            broken.append(number)
        is_linked = is_linked or link is not None
        given_up = entry.get(BROKEN_LINKS)
        explained.update(given_up if isinstance(given_up, list) else [])
        previous = line.removesuffix(b"\n")
    return [number for number in broken if number not in explained]


def _sha256(line: bytes) -> str:
    return hashlib.sha256(line).hexdigest()


def _parse_entry(line: bytes) -> dict[str, Any] | None:
    """Entry in a line; None if the line is damaged."""
    try:
        entry = parse_json(line)
    except ValueError:
        return None
    return entry if isinstance(entry, dict) else None


def _complete_lines(lines: Iterable[bytes]) -> Iterator[bytes]:
    """Lines that are not cut off; an entry without a line end was never completed, and no action followed."""
    return (line for line in lines if line.endswith(b"\n"))


def _parse(path: str | Path, lines: Iterable[bytes]) -> Iterator[tuple[dict[str, Any], bytes]]:
    """Entries, each with its line. Raises RunFolderError if a line before the last one is damaged."""
    damaged = ""
    for number, line in enumerate(_complete_lines(lines), start=1):
        if damaged:
            raise RunFolderError(damaged)
        entry = _parse_entry(line)
        if entry is None:
            damaged = f"{path}:{number}: damaged entry: {_excerpt(line[:-1])!r}"
            continue
        entry.pop(_LINK_KEY, None)
        # Keys are interned, so that each is in memory once and not once for each line.
        yield {sys.intern(key): value for key, value in entry.items()}, line


def _excerpt(line: bytes) -> str:
    return line[:_MAX_EXCERPT_CHARACTERS].decode(errors="replace")


#: No run lasts longer; an entry with a later time is damaged.
MAX_RUN_S = 1e9


@dataclass
class RunFacts:
    """Summary of a journal; unknown texts are empty."""

    #: procedure, station, unit: Procedure, or "investigation"; station; serial number of the INS.
    procedure: str = ""
    station: str = ""
    unit: str = ""
    #: Options of the commands that started and resumed it.
    options: dict[str, Any] = field(default_factory=dict)
    started_utc: str = ""  #: Start, ISO 8601.
    last_s: float = 0.0  #: Latest time of an entry, on the run's clock.
    resumes: int = 0  #: Number of resumptions.
    dwells: int = 0  #: Number of completed dwells.
    #: Whether a dwell tested signs and axes of the signal map; None if no completed dwell states it.
    are_signs_tested: bool | None = None
    #: Number of dwells by the identification of the INS, the present one last.
    dwells_by_identity: dict[str, int] = field(default_factory=dict)
    #: ended, reason: "finished", "stopped" or "failed", and the reason. Empty for a run that was cut off or
    #: is in progress.
    ended: str = ""
    reason: str = ""
    safe_state: tuple[Mapping[str, Any], ...] = ()  #: Actions at the end that made the bench safe.

    def add(self, entry: Mapping[str, Any]) -> None:
        """Take one entry into account."""
        self.last_s = max(self.last_s, _time_s(entry))
        match entry.get("event"):
            case "run_started":
                self.started_utc = _text(entry, "utc")
                self._begin(entry)
            case "run_resumed":
                self.resumes += 1
                self._begin(entry)
            case "ins_identified":
                self.unit = _text(entry, "unit") or self.unit
                if identity := _text(entry, "identity"):
                    self.dwells_by_identity[identity] = self.dwells_by_identity.pop(identity, 0)
            case "investigation_started" | "investigation_resumed" as event:
                self.unit = _text(entry, "unit") or self.unit
                # A resumed investigation replays its blocks, and records them again.
                self.dwells = _dwell_count(entry)
                if event == "investigation_started":
                    self.started_utc = _text(entry, "utc")
                else:
                    self.resumes += 1
                self._begin(entry)
            case "measured":
                self.dwells += _dwell_count(entry)
            case "investigation_ended":
                endings = {"bench_failed": "failed", "declined": "stopped"}
                self.ended = endings.get(_text(entry, "ended"), "finished")
                self.reason = _text(entry, "reason")
            case "dwell_finished":
                if isinstance(tested := entry.get("signs_tested"), bool):
                    self.are_signs_tested = bool(self.are_signs_tested) or tested
                if self.dwells_by_identity:
                    self.dwells_by_identity[next(reversed(self.dwells_by_identity))] += 1
                self.dwells += not entry.get("replaces_earlier")
            case "run_ended":
                self.ended, self.reason = _text(entry, "ended"), _text(entry, "reason")
                recorded = entry.get("safe_state")
                actions = recorded if isinstance(recorded, list) else []
                self.safe_state = tuple(each for each in actions if isinstance(each, Mapping))

    def _begin(self, entry: Mapping[str, Any]) -> None:
        """Take the start or the resumption of a run into account."""
        self.procedure = _text(entry, "procedure") or self.procedure
        self.station = _text(entry, "station") or self.station
        if isinstance(options := entry.get("options"), Mapping):
            self.options |= options
        self.ended, self.reason, self.safe_state = "", "", ()


def facts_of(entries: Iterable[Mapping[str, Any]]) -> RunFacts:
    """Summarise a journal; malformed entries are ignored."""
    facts = RunFacts()
    for entry in entries:
        facts.add(entry)
    return facts


def _text(entry: Mapping[str, Any], key: str) -> str:
    value = entry.get(key)
    return "" if value is None else str(value)


def _dwell_count(entry: Mapping[str, Any]) -> int:
    """Number of dwells that an entry states; 0 if it states none."""
    value = entry.get("dwells")
    return value if isinstance(value, int) else 0


def _time_s(entry: Mapping[str, Any]) -> float:
    value = entry.get("time_s")
    return float(value) if isinstance(value, int | float) and 0.0 <= value <= MAX_RUN_S else 0.0
