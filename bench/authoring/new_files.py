"""New procedure, station and world files for a person to go on with."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from gyrobench.bench.authoring.kinds import PROCEDURE, STATION, WORLD, FileKind
from gyrobench.bench.authoring.schemas import EDITOR_MARK, editor_line, schema_of
from gyrobench.bench.authoring.starting_file import StartingFile, comment, inline
from gyrobench.bench.foundations.documents import Schema, parse_document, read_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.shipped import TEMPLATES, find_document
from gyrobench.bench.procedure.document import checked_procedure
from gyrobench.bench.procedure.resolve import resolve
from gyrobench.bench.procedure.step import Step
from gyrobench.bench.procedure.steps import STEP_KINDS
from gyrobench.bench.station.document import StationFile

_EXAMPLE_STATION = "example_bench"
_NAME = re.compile(r"[A-Za-z0-9_-]{1,80}")
_WORLD_NAME = re.compile(r"^world:.*$", re.MULTILINE)
_HINT = "A line that begins with # and no space is optional and shows its default: take the # away to use it."


def new_procedure(name: str, like: str, path: Path) -> str:
    """Write the text of a procedure file.

    Parameters
    ----------
    name : str
        Of the procedure.
    like : str
        A key of :data:`gyrobench.bench.foundations.shipped.TEMPLATES`, a shipped procedure, or a file.
    path : Path
        Where it is to stand.

    Raises
    ------
    DocumentError
        There is no such template, or the name can't be one.
    """
    template = read_document(find_document("procedures", TEMPLATES.get(like, like)))
    values = {**template.data, "procedure": name, "description": f"Made from {like}.", "assumptions": []}
    schema = schema_of(PROCEDURE)
    steps = values.pop("steps")
    of_head = {key: each for key, each in schema["properties"].items() if key != "steps"}
    head = {**schema, "properties": of_head, "required": ["procedure"]}
    text = _text(
        PROCEDURE,
        path,
        StartingFile(head).lines(values),
        ["", "# What to do, in order. The kinds of step and their keys are at the end.", "steps:"],
        _steps(steps, "  "),
        ["", *_catalogue(schema)],
    )
    document = parse_document(text, path)
    resolve(document, checked_procedure(document))
    return text


def new_station(name: str, path: Path, table: str | None = None, chamber: str | None = None) -> str:
    """Write the text of a station file, after the shipped example.

    Parameters
    ----------
    name : str
        Of the bench.
    path : Path
        Where it is to stand.
    table, chamber : str, optional
        Dialects of the rate table and the chamber; the example's without them.

    Raises
    ------
    DocumentError
        There is no such dialect, or the name can't be one.
    """
    values = read_document(find_document("stations", _EXAMPLE_STATION)).data
    values |= {"station": name, "description": "Fill in ports, limits, mounting, and what the INS sends."}
    for section, dialect in (("rate_table", table), ("chamber", chamber)):
        if dialect is not None and dialect != values[section]["dialect"]:
            values[section] = _of_dialect(values[section], dialect, section)
    text = _text(STATION, path, StartingFile(schema_of(STATION)).lines(values))
    validate(parse_document(text, path), StationFile)
    return text


def new_world(name: str, like: str, path: Path) -> str:
    """Copy a world file under another name, unread: what it says is the emulators' matter.

    Parameters
    ----------
    name : str
        Of the world.
    like : str
        A shipped world, or a file.
    path : Path
        Where it is to stand.

    Raises
    ------
    DocumentError
        There is no such world, or the name can't be one.
    """
    if not _NAME.fullmatch(name):
        raise DocumentError(f"{name}: no name for a world; letters, digits, underscore and hyphen are")
    lines = find_document("worlds", like).read_text(encoding="utf-8").splitlines(keepends=True)
    kept = [line for line in lines if not line.startswith(EDITOR_MARK)]
    return editor_line(WORLD, path) + _WORLD_NAME.sub(f"world: {name}", "".join(kept), count=1)


def _of_dialect(section: Mapping[str, Any], dialect: str, name: str) -> dict[str, Any]:
    """The keys that every dialect has; those of the former one are left out."""
    kept = {key: value for key, value in section.items() if key in _common_keys(name)}
    return {**kept, "dialect": dialect}


def _common_keys(section: str) -> set[str]:
    annotation: Any = StationFile.model_fields[section].annotation
    return set(annotation.model_fields) - {"baudrate", "parity"}


def _text(kind: FileKind, path: Path, *parts: Iterable[str]) -> str:
    head = f"{editor_line(kind, path)}# {_HINT}\n\n"
    return head + "".join(f"{line}\n" for part in parts for line in part)


def _steps(entries: list[Any], indent: str) -> Iterator[str]:
    for entry in entries:
        if isinstance(entry, dict) and "repeat" in entry:
            loop = entry["repeat"]
            yield f"{indent}- repeat:"
            yield f"{indent}    over: {inline(loop['over'])}"
            yield f"{indent}    steps:"
            yield from _steps(loop["steps"], f"{indent}      ")
        elif isinstance(entry, dict):
            [(name, keys)] = entry.items()
            yield f"{indent}- {name}: {inline(keys)}"
        else:
            yield f"{indent}- {entry}"


def _catalogue(schema: Schema) -> Iterator[str]:
    """Every kind of step with its keys, as comments."""
    yield "# Kinds of step. Each can have these keys:"
    kinds = {name: schema["$defs"][name] for name in (*STEP_KINDS, "repeat")}
    common = Step.model_fields.keys()
    yield from _keys(schema, kinds["wait"], only=common)
    for name, kind in kinds.items():
        yield "#"
        yield from comment(f"{name}: {kind['description']}")
        yield from _keys(schema, kind, only=kind["properties"].keys() - common)


def _keys(schema: Schema, kind: Schema, only: Collection[str]) -> Iterator[str]:
    explained = StartingFile(schema).explained
    for key, each in kind["properties"].items():
        if key in only:
            said = [explained(each)]
            if each.get("default") is not None:
                said.append(f"{inline(each['default'])} if not given")
            if key in kind.get("required", ()):
                said.append("needed")
            yield from comment(f"{key}: {'; '.join(said)}", "#   ", "  ")
