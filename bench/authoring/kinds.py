"""The kinds of YAML file, and how one is told from another."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from gyrobench.bench.exchange.import_map import LogMap
from gyrobench.bench.foundations.documents import Document, StrictModel
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.procedure.document import Procedure
from gyrobench.bench.runs.compensation_file import CompensationFile
from gyrobench.bench.station.document import StationFile


@dataclass(frozen=True)
class FileKind:
    """One kind of file.

    Attributes
    ----------
    name : str
        What a person calls it.
    title : str
        What it is, in words.
    folder : str
        Where shipped ones are; empty where none are shipped.
    keys : frozenset of str
        Top-level keys that tell it.
    model : type or None
        What it is checked against; None for those that the emulators alone read.
    """

    name: str
    title: str
    folder: str
    keys: frozenset[str]
    model: type[StrictModel] | None = None

    @property
    def schema_name(self) -> str:
        """File name of its JSON Schema."""
        return f"{self.name}.schema.json"


def _kind(name: str, title: str, folder: str, model: type[StrictModel]) -> FileKind:
    return FileKind(name, title, folder, frozenset(model.model_fields), model)


PROCEDURE = _kind("procedure", "gyrobench procedure", "procedures", Procedure)
STATION = _kind("station", "gyrobench station", "stations", StationFile)
WORLD = FileKind(
    "world",
    "gyrobench world behind emulated instruments",
    "worlds",
    frozenset({"world", "thermal", "accelerometer", "undeclared_effects", "reference_temperature_c"}),
)
FAULTS = FileKind("faults", "gyrobench list of faults", "faults", frozenset({"faults", "log"}))
IMPORT_MAP = _kind("import", "gyrobench map of a log", "imports", LogMap)
COMPENSATION = _kind("compensation", "gyrobench compensation of an INS", "", CompensationFile)

KINDS = {
    kind.name: kind for kind in (PROCEDURE, STATION, WORLD, FAULTS, IMPORT_MAP, COMPENSATION)
}  # fmt: skip


def kind_of(document: Document) -> FileKind:
    """Tell by its top-level keys what a file is.

    Raises
    ------
    DocumentError
        They fit no kind, or several.
    """
    found = document.data if isinstance(document.data, dict) else {}
    # A file that says its name is of that kind; else the one that shares most keys.
    named = [kind for kind in KINDS.values() if kind.name in kind.keys and kind.name in found]
    likely = named if len(named) == 1 else _most_alike(found)
    if len(likely) == 1:
        return likely[0]
    raise DocumentError(
        f"{document.path}:1:1: its keys do not tell what kind of file it is. Say it with --as "
        f"{'|'.join(KINDS)}"
    )


def _most_alike(keys: Iterable[str]) -> list[FileKind]:
    shared = {name: len(kind.keys.intersection(keys)) for name, kind in KINDS.items()}
    most = max(shared.values())
    return [KINDS[name] for name, count in shared.items() if count == most > 0]
