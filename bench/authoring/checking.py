"""Everything wrong with one file, with places, whatever kind of file it is."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from gyrobench.bench.authoring.file_kinds import (
    COMPENSATION,
    KINDS,
    PROCEDURE,
    STATION,
    FileKind,
    check_emulator_file,
    kind_of,
)
from gyrobench.bench.foundations.documents import Document, read_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.procedure.procedure_file import checked_procedure, resolve
from gyrobench.bench.procedure.timeline import hours_minutes
from gyrobench.bench.runs.compensation_file import read_compensation
from gyrobench.bench.station.station import Station

_PLACED = re.compile(r"(?P<file>.+?):(?P<line>\d+):(?P<column>\d+): (?P<message>.*)", re.DOTALL)


@dataclass(frozen=True)
class PlacedProblem:
    """Something wrong, and where; line and column, from 1, are None where it has no place in the file."""

    message: str
    line: int | None = None
    column: int | None = None


@dataclass(frozen=True)
class FileCheck:
    """What a file is, and what is wrong with it.

    Attributes
    ----------
    kind : str
        Name of its kind; empty where that is not known.
    text : str
        All problems as the other commands tell them, one a line; empty where nothing is wrong.
    found : str
        What it amounts to where nothing is wrong, in a few words.
    """

    path: Path
    kind: str
    text: str = ""
    found: str = ""

    @property
    def is_good(self) -> bool:
        """Whether nothing is wrong."""
        return not self.text

    def problems(self) -> list[PlacedProblem]:
        """The problems one by one."""
        return [_placed(line) for line in self.text.splitlines()]


def check_file(path: Path, kind: FileKind | None = None, station: Station | None = None) -> FileCheck:
    """Look at a file whole.

    Parameters
    ----------
    kind : FileKind, optional
        What it is meant to be; told by its keys without it.
    station : Station, optional
        Procedures are planned for it as well.
    """
    name = kind.name if kind else ""
    try:
        document = read_document(path)
        kind = kind or kind_of(document)
        name = kind.name
        return FileCheck(path, name, found=_look(document, kind, station))
    except DocumentError as error:
        return FileCheck(path, name, str(error))


def _look(document: Document, kind: FileKind, station: Station | None) -> str:
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


def kind_named(name: str) -> FileKind:
    """Find a kind by its name."""
    return KINDS[name]
