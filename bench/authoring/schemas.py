"""JSON Schemas of all kinds of file."""

from __future__ import annotations

import json
from pathlib import Path

from gyrobench.bench.authoring.emulator_files import emulator_schema
from gyrobench.bench.authoring.kinds import PROCEDURE, FileKind
from gyrobench.bench.authoring.procedure_schema import procedure_schema
from gyrobench.bench.foundations.documents import Schema, json_schema
from gyrobench.bench.foundations.shipped import shipped_folders

_FOLDER = "schemas"
#: What a YAML file begins with for the language server of its editor.
EDITOR_MARK = "# yaml-language-server: $schema="


def schema_of(kind: FileKind) -> Schema:
    """Write the schema of a kind of file from its model, draft 2020-12."""
    if kind is PROCEDURE:
        return procedure_schema(kind.title)
    if kind.model is None:
        return emulator_schema(kind.name)
    return json_schema(kind.model, kind.title)


def schema_text(schema: Schema) -> str:
    """A schema as the files hold it."""
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


def editor_line(kind: FileKind, path: Path) -> str:
    """First line of a file at ``path``, which tells its editor the shipped schema."""
    folder = shipped_folders(_FOLDER)[0].resolve()
    shared = path.resolve().parent.parent
    # Beside the shipped folders the line holds wherever the project is copied to.
    place = f"../{_FOLDER}" if folder == shared / _FOLDER else str(folder)
    return f"{EDITOR_MARK}{place}/{kind.schema_name}\n"
