"""JSON Schema of procedures: steps, each with the schema of its own kind, loops and variables."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

from gyrobench.bench.foundations.documents import Schema, json_schema
from gyrobench.bench.procedure.document import VARIABLE_PATTERN, Procedure, Repeat
from gyrobench.bench.procedure.step import Step
from gyrobench.bench.procedure.steps import STEP_KINDS

_VARIABLE = {"$ref": "#/$defs/variable"}
_ENTRY = {"$ref": "#/$defs/entry"}
#: What a loop can go over.
_SCALARS = {"number", "integer", "string"}


def procedure_schema(title: str) -> Schema:
    """Write the schema of procedures, draft 2020-12."""
    schema = json_schema(Procedure, title)
    loop = _section(json_schema(Repeat, ""))
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
        of_kind = json_schema(kind, "")
        definitions |= {below: _with_variables(each) for below, each in of_kind.get("$defs", {}).items()}
        definitions[name] = _with_variables(_section(of_kind))
    for section in (schema, loop):
        section["properties"]["steps"]["items"] = _ENTRY
    return {**schema, "$defs": schema.get("$defs", {}) | definitions}


def _section(schema: Schema) -> Schema:
    """A schema as part of another."""
    return {key: value for key, value in schema.items() if key not in ("$schema", "title", "$defs")}


def _entries() -> list[Schema]:
    bare = [name for name, kind in STEP_KINDS.items() if _needs_no_key(kind)]
    return [
        {"type": "string", "description": "a step without keys", "enum": bare},
        *(_single(name, or_nothing=name in bare) for name in STEP_KINDS),
        _single("repeat", or_nothing=False),
    ]


def _single(name: str, or_nothing: bool) -> Schema:
    """``name: {...}``, and nothing beside it."""
    keys: Schema = {"$ref": f"#/$defs/{name}"}
    return {
        "type": "object",
        "properties": {name: {"anyOf": [keys, {"type": "null"}]} if or_nothing else keys},
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
    """Allow a variable wherever a number or text can stand."""
    properties = schema.get("properties", {})
    return {**schema, "properties": {key: _or_variable(each) for key, each in properties.items()}}


def _or_variable(schema: Schema) -> Schema:
    options = schema.get("anyOf", [schema])
    if not any(option.get("type") in _SCALARS for option in options):
        return schema
    said: Schema = {key: schema[key] for key in ("description", "default") if key in schema}
    bare: list[dict[str, Any]] = [
        {key: value for key, value in option.items() if key not in said} for option in options
    ]
    return {**said, "anyOf": [*bare, _VARIABLE]}
