"""Checks a YAML file of any kind and lists all its problems with their places."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from gyrobench.bench.authoring.file_kinds import (
    COMPENSATION,
    PROCEDURE,
    STATION,
    FileKind,
    check_emulator_file,
    kind_of,
)
from gyrobench.bench.foundations.documents import Document, read_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.text import hours_minutes
from gyrobench.bench.procedure.procedure_file import checked_procedure, resolve
from gyrobench.bench.runs.compensation_file import read_compensation
from gyrobench.bench.station.station import Station

_PLACED = re.compile(r"(?P<file>.+?):(?P<line>\d+):(?P<column>\d+): (?P<message>.*)", re.DOTALL)


@dataclass(frozen=True)
class PlacedProblem:
    """A mistake and its line and column, from 1; None where it has no place in the file."""

    message: str
    line: int | None = None
    column: int | None = None


@dataclass(frozen=True)
class FileCheck:
    """Kind and problems of a file."""

    path: Path
    kind: str  #: Empty where not known.
    text: str = ""  #: All problems, one a line; empty for a correct file.
    found: str = ""  #: Summary of a correct file.

    @property
    def is_good(self) -> bool:
        """Whether the file is correct."""
        return not self.text

    def problems(self) -> list[PlacedProblem]:
        """The problems one by one."""
        return [_placed(line) for line in self.text.splitlines()]


def check_file(path: Path, kind: FileKind | None = None, station: Station | None = None) -> FileCheck:
    """Check a file of the given kind, by default recognised by its keys; procedures also on a station."""
    name = kind.name if kind else ""
    try:
        document = read_document(path)
        kind = kind or kind_of(document)
        name = kind.name
        return FileCheck(path, name, found=_summary(document, kind, station))
    except DocumentError as error:
        return FileCheck(path, name, str(error))


def _summary(document: Document, kind: FileKind, station: Station | None) -> str:
    if kind is PROCEDURE:
        return _procedure(document, station)
    if kind is STATION:
        Station(document.path).check_dbc()
    elif kind is COMPENSATION:
        read_compensation(document.path)
    elif kind.model is not None:
        validate(document, kind.model)
    else:
        check_emulator_file(kind.name, document.path)
    return ""


def _procedure(document: Document, station: Station | None) -> str:
    procedure = checked_procedure(document)
    if station is None:
        return f"{len(resolve(document, procedure))} steps"
    plan = station.plan(document, procedure)
    return (
        f"{len(plan.steps)} steps, {plan.dwell_count} dwells, {hours_minutes(plan.duration_s)} h on "
        f"{station.file.station}"
    )


def _placed(line: str) -> PlacedProblem:
    match = _PLACED.match(line)
    if match is None:
        return PlacedProblem(line)
    return PlacedProblem(match["message"], int(match["line"]), int(match["column"]))
