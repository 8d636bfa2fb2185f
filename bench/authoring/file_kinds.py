"""The kinds of YAML file: how to recognise one, its JSON Schema, and the check of a file.

World files and lists of faults are read only by the emulators: a separate process gives their schema and
checks them, so that the bench has no access to the simulated truth.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from gyrobench.bench.calibration.rotation_list import RotationList
from gyrobench.bench.closure.effects.effect_file import EffectFile
from gyrobench.bench.exchange.import_map import LogMap
from gyrobench.bench.foundations.documents import Document, StrictModel, read_document, validate
from gyrobench.bench.foundations.errors import DocumentError, GyrobenchError
from gyrobench.bench.foundations.json_schema import Schema, json_schema
from gyrobench.bench.foundations.shipped import shipped_folder
from gyrobench.bench.foundations.text import counted, hours_minutes, listed
from gyrobench.bench.investigation.external_bench import BlockPlan
from gyrobench.bench.procedure.checks import check_plan
from gyrobench.bench.procedure.plan import expand
from gyrobench.bench.procedure.procedure_file import (
    STEP_KINDS,
    VARIABLE_PATTERN,
    Procedure,
    Repeat,
    checked_procedure,
)
from gyrobench.bench.procedure.steps import Step
from gyrobench.bench.runs.compensation_file import CompensationFile, read_compensation
from gyrobench.bench.station.station import Station
from gyrobench.bench.station.station_file import StationFile


@dataclass(frozen=True)
class FileKind:
    """One kind of file."""

    name: str  #: Name in commands.
    title: str  #: Title of its schema.
    folder: str  #: Folder of shipped files; empty if there are none.
    keys: frozenset[str]  #: Top-level keys, by which a file is recognised.
    model: type[StrictModel] | None = None  #: None for files that only the emulators read.

    @property
    def schema_name(self) -> str:
        """File name of its JSON Schema."""
        return f"{self.name}.schema.json"


def _kind_of_model(name: str, title: str, folder: str, model: type[StrictModel]) -> FileKind:
    return FileKind(name, title, folder, frozenset(model.model_fields), model)


PROCEDURE = _kind_of_model("procedure", "gyrobench procedure", "procedures", Procedure)
STATION = _kind_of_model("station", "gyrobench station", "stations", StationFile)
WORLD = FileKind(
    "world",
    "gyrobench world behind emulated instruments",
    "worlds",
    frozenset({"world", "thermal", "accelerometer", "undeclared_effects", "reference_temperature_c"}),
)
FAULTS = FileKind("faults", "gyrobench list of faults", "faults", frozenset({"faults", "log"}))
IMPORT_MAP = _kind_of_model("import", "gyrobench map of a log", "imports", LogMap)
EFFECT = _kind_of_model("effect", "gyrobench effect on the bias", "", EffectFile)
ROTATION_LIST = _kind_of_model("rotation_list", "gyrobench list of rotations", "rotations", RotationList)
COMPENSATION = _kind_of_model("compensation", "gyrobench compensation of an INS", "", CompensationFile)
PLAN = _kind_of_model("plan", "gyrobench plan of a block of measurements", "", BlockPlan)

_ALL = (PROCEDURE, STATION, WORLD, FAULTS, IMPORT_MAP, EFFECT, COMPENSATION, PLAN, ROTATION_LIST)
KINDS = {kind.name: kind for kind in _ALL}


def kind_of(document: Document) -> FileKind:
    """Recognise a file by its top-level keys; raises DocumentError if they fit no kind or several."""
    keys = set(document.data) if isinstance(document.data, dict) else set()
    # The kind whose name is a key of the file, otherwise the one that shares most keys.
    candidates = [kind for kind in KINDS.values() if kind.name in kind.keys & keys]
    if len(candidates) != 1:
        most = max(len(kind.keys & keys) for kind in KINDS.values())
        candidates = [kind for kind in KINDS.values() if len(kind.keys & keys) == most > 0]
    if len(candidates) == 1:
        return candidates[0]
    raise DocumentError(
        f"{document.path}:1:1: its keys fit no kind of file, or several. Give the kind with --as "
        f"{'|'.join(KINDS)}"
    )


_PROGRAM = "gyrobench.drivers.emulators.check_file"
_TIMEOUT_S = 120.0
_WRONG_FILE = 2


def _emulator_documents(*arguments: str) -> str:
    """Output of the emulators' program; raises DocumentError with all problems of a file that it checks."""
    # -P: imports nothing from the present folder
    command = [sys.executable, "-P", "-m", _PROGRAM, *arguments]
    try:
        answer = subprocess.run(  # noqa: S603 - our own program
            command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise GyrobenchError(f"{_PROGRAM} does not run: {error}") from error
    if answer.returncode == _WRONG_FILE:
        raise DocumentError(answer.stderr.strip())
    if answer.returncode:
        raise GyrobenchError(f"{_PROGRAM} failed: {answer.stderr.strip()[-500:]}")
    return answer.stdout


_VARIABLE = {"$ref": "#/$defs/variable"}
_ENTRY = {"$ref": "#/$defs/entry"}
#: Types of the values that a loop variable can have.
_SCALARS = {"number", "integer", "string"}


def _procedure_schema(title: str) -> Schema:
    """Write the schema of procedures, draft 2020-12."""
    schema = json_schema(Procedure, title)
    loop = _subschema(json_schema(Repeat, ""))
    definitions = {
        "entry": {"description": "one step, or steps that are repeated", "oneOf": list(_entries())},
        "variable": {
            "description": "value of the loop variable of that name",
            "type": "string",
            "pattern": f"^{VARIABLE_PATTERN}$",
        },
        "repeat": loop,
    }
    for name, kind in STEP_KINDS.items():
        kind_schema = json_schema(kind, "")
        definitions |= {
            definition: _with_variables(each) for definition, each in kind_schema.get("$defs", {}).items()
        }
        definitions[name] = _with_variables(_subschema(kind_schema))
    for section in (schema, loop):
        section["properties"]["steps"]["items"] = _ENTRY
    return {**schema, "$defs": schema.get("$defs", {}) | definitions}


def _subschema(schema: Schema) -> Schema:
    """Schema without the keys that only a root schema has."""
    return {key: value for key, value in schema.items() if key not in ("$schema", "title", "$defs")}


def _entries() -> list[Schema]:
    names_without_keys = [name for name, kind in STEP_KINDS.items() if _needs_no_key(kind)]
    return [
        {"type": "string", "description": "a step without keys", "enum": names_without_keys},
        *(_single_key_schema(name, may_be_null=name in names_without_keys) for name in STEP_KINDS),
        _single_key_schema("repeat", may_be_null=False),
    ]


def _single_key_schema(name: str, may_be_null: bool) -> Schema:
    """Schema of an object with the single key ``name``."""
    keys: Schema = {"$ref": f"#/$defs/{name}"}
    return {
        "type": "object",
        "properties": {name: {"anyOf": [keys, {"type": "null"}]} if may_be_null else keys},
        "required": [name],
        "additionalProperties": False,
    }


def _needs_no_key(kind: type[Step]) -> bool:
    try:
        kind()
    except ValidationError:
        return False
    return True


def _with_variables(schema: Schema) -> Schema:
    """Allow a variable in place of each number or text."""
    properties = schema.get("properties", {})
    return {**schema, "properties": {key: _with_variable(each) for key, each in properties.items()}}


def _with_variable(schema: Schema) -> Schema:
    options = schema.get("anyOf", [schema])
    if not any(option.get("type") in _SCALARS for option in options):
        return schema
    common: Schema = {key: schema[key] for key in ("description", "default") if key in schema}
    alternatives: list[dict[str, Any]] = [
        {key: value for key, value in option.items() if key not in common} for option in options
    ]
    return {**common, "anyOf": [*alternatives, _VARIABLE]}


_FOLDER = "schemas"
#: Start of a YAML file's first line, which names its schema for the editor's language server.
EDITOR_MARK = "# yaml-language-server: $schema="


def schema_of(kind: FileKind) -> Schema:
    """Write the schema of a kind of file from its model, draft 2020-12."""
    schema: Schema = json.loads(_schema_document(kind))
    return schema


@cache
def _schema_document(kind: FileKind) -> str:
    """Schema as JSON; that of ``world`` or ``faults`` files comes from the emulators' program."""
    if kind.model is None:
        return _emulator_documents("schema", kind.name)
    return json.dumps(
        _procedure_schema(kind.title) if kind is PROCEDURE else json_schema(kind.model, kind.title)
    )


def write_schemas(folder: Path) -> None:
    """Write the schemas of all kinds of file into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for kind in KINDS.values():
        (folder / kind.schema_name).write_text(schema_text(schema_of(kind)), encoding="utf-8")


def schema_text(schema: Schema) -> str:
    """Format a schema as in its file."""
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


def editor_line(kind: FileKind, path: Path) -> str:
    """First line of a file at ``path``, which gives the editor the path of the shipped schema.

    Installed packages contain the schemas; in a checkout they are written when first needed. Empty if
    they can't be written.
    """
    folder = shipped_folder(_FOLDER)
    if not folder.is_dir():
        return ""
    if not (folder / kind.schema_name).is_file():
        try:
            write_schemas(folder)
        except OSError:
            return ""
    # For a file next to the shipped folders, a relative path stays valid if the project is copied.
    schema_folder = f"../{_FOLDER}" if folder == path.resolve().parent.parent / _FOLDER else str(folder)
    return f"{EDITOR_MARK}{schema_folder}/{kind.schema_name}\n"


_PROBLEM_LINE = re.compile(r"(?P<file>.+?):(?P<line>\d+):(?P<column>\d+): (?P<message>.*)", re.DOTALL)


@dataclass(frozen=True)
class PlacedProblem:
    """A mistake with its line and column, from 1; None if it has no place in the file."""

    message: str
    line: int | None = None
    column: int | None = None


@dataclass(frozen=True)
class FileCheck:
    """Kind and problems of a file."""

    path: Path
    kind: str  #: Name of the kind; empty if unknown.
    text: str = ""  #: All problems, one a line; empty for a correct file.
    found: str = ""  #: Summary of a correct file.

    @property
    def is_good(self) -> bool:
        """Whether the file is correct."""
        return not self.text

    def problems(self) -> list[PlacedProblem]:
        """Return the problems one by one."""
        return [_parse_problem(line) for line in self.text.splitlines()]


def check_file(path: Path, kind: FileKind | None = None, station: Station | None = None) -> FileCheck:
    """Check a file of a kind, by default recognised by its keys; a procedure also on a station."""
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
        return _procedure_summary(document, station)
    if kind is STATION:
        station = Station(document.path)
        station.check_dbc()
        missing = listed(station.not_filled_in)
        return f"not filled in yet: {missing}" if missing else ""
    if kind is COMPENSATION:
        read_compensation(document.path)
    elif kind.model is not None:
        validate(document, kind.model)
    else:
        _emulator_documents("check", kind.name, str(document.path))
    return ""


def _procedure_summary(document: Document, station: Station | None) -> str:
    procedure = checked_procedure(document)
    if station is None:
        plan = expand(document, procedure)
        check_plan(document, plan)
        steps = counted(len(plan.steps), "step")
        return f"{steps}. Limits of a station are not checked: add --station STATION"
    plan = station.plan(document, procedure)
    return (
        f"{counted(len(plan.steps), 'step')}, {counted(plan.dwell_count, 'dwell')}, "
        f"{hours_minutes(plan.duration_s)} h on {station.file.station}"
    )


def _parse_problem(line: str) -> PlacedProblem:
    match = _PROBLEM_LINE.match(line)
    if match is None:
        return PlacedProblem(line)
    return PlacedProblem(match["message"], int(match["line"]), int(match["column"]))
