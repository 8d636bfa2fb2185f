"""Damaged files of an interrupted run: found before it resumes, and given up if the operator chooses so.

Telemetry, parts of the CAN log, lines of the journal and provenance.json can be given up: a dwell whose data
they held is measured again. The damaged files stay in the run folder under other names.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gyrobench.bench.dwells.run_dwells import marks_in, read_frames
from gyrobench.bench.foundations.clock import Clock
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.foundations.files import read_limited, sync_folder, write_error, write_whole
from gyrobench.bench.foundations.operator_name import operator_name
from gyrobench.bench.foundations.text import counted, listed
from gyrobench.bench.runs.can_log import log_path
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import BROKEN_LINKS, MAX_JOURNAL_BYTES, Journal, broken_links, intact_lines
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.bench.runs.provenance import read_provenance, start_from_journal, write_provenance
from gyrobench.bench.runs.telemetry import damaged_telemetry

_SUFFIX = ".damaged"


@dataclass(frozen=True)
class Damage:
    """Damage of a run folder."""

    #: Damaged files, with a description of the lost data.
    files: Mapping[Path, str] = field(default_factory=dict)
    lines: int = 0  #: damaged lines of the journal
    is_provenance_lost: bool = False  #: whether provenance.json is damaged or missing
    dwells: tuple[int, ...] = ()  #: finished dwells whose data are lost

    @classmethod
    def of_all(cls, damages: Sequence[Damage]) -> Damage:
        """Join the damages of a run and of its units."""
        return cls(
            {path: description for each in damages for path, description in each.files.items()},
            sum(each.lines for each in damages),
            any(each.is_provenance_lost for each in damages),
            tuple(sorted({dwell for each in damages for dwell in each.dwells})),
        )

    def __bool__(self) -> bool:
        return bool(self.files or self.dwells)

    def describe(self) -> list[str]:
        """Describe each damaged file in a line, and how to resume without them; empty without damage."""
        if not self:
            return []
        again = f"; dwell {listed(list(map(str, self.dwells)))} is measured again" if self.dwells else ""
        return [
            *(f"Damaged: {path}: {lost}." for path, lost in self.files.items()),
            f"Restore the files from a copy, or resume with --give-up-damaged{again}.",
        ]

    def give_up(self, folder: RunFolder, clock: Callable[[], Clock]) -> None:
        """Rename the damaged files and record the loss; a lost provenance is written again.

        The journal keeps its intact lines, and lists those whose link to the line before is broken. Damage
        is found again until it is recorded. ``clock`` creates the run's clock, which is read from the intact
        files. Raises RunFolderError if a file can't be written.
        """
        lines, _ = intact_lines(_content(folder))
        for path in self.files:
            backup = _free_name(path)
            try:
                if path == folder.journal:
                    write_whole(backup, path.read_bytes())
                elif path.exists():
                    path.replace(backup)
            except OSError as error:
                raise write_error(path, error) from error
        if self.is_provenance_lost:
            entries = [json.loads(line) for line in lines]
            started, options = start_from_journal(folder, entries)
            write_provenance(folder, started, {}, options)
        if folder.journal not in self.files:
            self._record(folder.journal, clock())
            return
        repaired = folder.journal.with_name(folder.journal.name + ".whole")
        intact = [line + b"\n" for line in lines if _is_complete(line)]
        write_whole(repaired, b"".join(intact))
        self._record(repaired, clock(), broken_links(intact))
        try:
            repaired.replace(folder.journal)
            sync_folder(folder.path)
        except OSError as error:
            raise write_error(folder.journal, error) from error

    def _record(self, path: Path, clock: Clock, broken: Sequence[int] = ()) -> None:
        names = [each.name for each in self.files]
        again = f"; measured again: dwell {listed(list(map(str, self.dwells)))}" if self.dwells else ""
        with Journal(path, clock) as journal:
            journal.record(
                "data_given_up",
                files=names,
                lines=self.lines,
                dwells=list(self.dwells),
                operator=operator_name(),
                **({BROKEN_LINKS: list(broken)} if broken else {}),
            )
            journal.record("note", text=f"damaged files were given up: {listed(names)}{again}")


def find_damage(folder: RunFolder, is_log_read: bool = True) -> tuple[Damage, list[dict[str, Any]]]:
    """Check all files that resuming a run needs; returns the damage, and the journal's intact entries.

    ``is_log_read``: whether to check the frames of all finished dwells too. Raises RunFolderError if a
    folder or the journal can't be read.
    """
    files: dict[Path, str] = {}
    lines, damaged_lines = intact_lines(_content(folder))
    intact = [line for line in lines if _is_complete(line)]
    damaged_lines += len(lines) - len(intact)
    entries = [json.loads(line) for line in intact]
    if damaged_lines:
        files[folder.journal] = f"{counted(damaged_lines, 'line')} can't be read"
    is_provenance_lost = False
    try:
        is_provenance_lost = "options" not in read_provenance(folder)
    except RunFolderError:
        is_provenance_lost = True
    if is_provenance_lost:
        files[folder.provenance] = "start and options come from the journal, identities are lost"
    lost = []
    if is_log_read:
        files |= dict.fromkeys(damaged_telemetry(folder.telemetry), "readings that no dwell needs")
        for marks in marks_in(entries, folder):
            try:
                read_frames(folder, marks)  # raises if frames are missing
            except RunFolderError:
                lost.append(marks.dwell)
                path = log_path(folder.can, marks.log_part)
                files[path] = f"frames of dwell {marks.dwell}"
    return Damage(files, damaged_lines, is_provenance_lost, tuple(lost)), entries


def _content(folder: RunFolder) -> bytes:
    return read_limited(folder.journal, MAX_JOURNAL_BYTES, RunFolderError)


def _free_name(path: Path) -> Path:
    """Unused name for a copy of a damaged file."""
    backup, number = path.with_name(path.name + _SUFFIX), 1
    while backup.exists():
        number += 1
        backup = path.with_name(f"{path.name}{_SUFFIX}-{number}")
    return backup


def _is_complete(line: bytes) -> bool:
    """Whether a line of the journal has the fields that its event requires to resume the run."""
    entry = json.loads(line)
    if entry.get("event") == "data_given_up":
        return isinstance(entry.get("dwells"), list) and isinstance(entry.get("lines"), int)
    if entry.get("event") != "dwell_finished":
        return True
    try:
        DwellMarks.from_json(entry.get("marks", {}))
    except RunFolderError:
        return False
    return True
