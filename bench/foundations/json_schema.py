"""JSON Schemas of file models, for editors that complete, explain and check files."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema

Schema = dict[str, Any]

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


class _SchemaGenerator(GenerateJsonSchema):
    """Generates no titles from key names: an editor shows the key itself beside the description."""

    def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ARG002 - pydantic's signature
        return False


def json_schema(model: type[BaseModel], title: str) -> Schema:
    """Write the JSON Schema (draft 2020-12) of a file model.

    ``model``: descriptions, defaults and bounds are those of its fields; models below it are in ``$defs``.
    ``title``: description of the kind of file.
    """
    schema = model.model_json_schema(schema_generator=_SchemaGenerator)
    return {"$schema": _DIALECT, "title": title} | {
        key: value for key, value in _simplify(schema).items() if key != "title"
    }


def _simplify(schema: Any) -> Any:
    """Remove the parts of a schema, at every depth, that do not help to write a file."""
    if isinstance(schema, list):
        return [_simplify(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    kept = {key: value for key, value in schema.items() if not _is_noise(key, value)}
    return {key: _CONVERTERS.get(key, _simplify)(value) for key, value in kept.items()}


def _is_noise(key: str, value: Any) -> bool:
    """Whether an entry is a class name, a default that is a whole section, or a keyword only of OpenAPI."""
    return (
        (key == "title" and isinstance(value, str))
        or (key == "default" and isinstance(value, Mapping))
        or (key == "discriminator" and isinstance(value, Mapping) and "propertyName" in value)
    )


def _simplify_named(schemas: dict[str, Any]) -> dict[str, Any]:
    """Simplify schemas by names that are not keywords: keys of a file, or models."""
    return {name: _simplify(each) for name, each in schemas.items()}


def _plain_text(text: str) -> str:
    """Convert a docstring to the text that an editor shows."""
    return re.sub(r":\w+:(?=`)", "", " ".join(text.split()).replace("``", "`"))


_CONVERTERS: dict[str, Callable[[Any], Any]] = {
    "properties": _simplify_named,
    "$defs": _simplify_named,
    "patternProperties": _simplify_named,
    "description": _plain_text,
    "default": lambda value: value,
    "enum": lambda value: value,
    "const": lambda value: value,
}
