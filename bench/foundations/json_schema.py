"""JSON Schemas of file models, for editors that complete, explain and check."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema

Schema = dict[str, Any]

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


class _SchemaGenerator(GenerateJsonSchema):
    """Without titles made of key names: an editor shows the key itself beside the description."""

    def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ARG002 - pydantic's signature
        return False


def json_schema(model: type[BaseModel], title: str) -> Schema:
    """Write the JSON Schema (draft 2020-12) of a file model.

    ``model``: descriptions, defaults and bounds are those of its fields; models below it are in ``$defs``.
    ``title``: what such a file is.
    """
    made = model.model_json_schema(schema_generator=_SchemaGenerator)
    return {"$schema": _DIALECT, "title": title} | {
        key: value for key, value in _tidied(made).items() if key != "title"
    }


def _tidied(schema: Any) -> Any:
    """Remove from a schema, at every depth, what does not help to write a file."""
    if isinstance(schema, list):
        return [_tidied(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    kept = {key: value for key, value in schema.items() if not _is_noise(key, value)}
    return {key: _BELOW.get(key, _tidied)(value) for key, value in kept.items()}


def _is_noise(key: str, value: Any) -> bool:
    """Whether it is the name of a class, a whole section as a default, or a keyword of OpenAPI alone."""
    return (
        (key == "title" and isinstance(value, str))
        or (key == "default" and isinstance(value, Mapping))
        or (key == "discriminator" and isinstance(value, Mapping) and "propertyName" in value)
    )


def _by_name(schemas: dict[str, Any]) -> dict[str, Any]:
    """Schemas by names that are no keywords: keys of a file, or models."""
    return {name: _tidied(each) for name, each in schemas.items()}


def _plain(text: str) -> str:
    """A docstring as an editor shows it."""
    return re.sub(r":\w+:(?=`)", "", " ".join(text.split()).replace("``", "`"))


_BELOW: dict[str, Callable[[Any], Any]] = {
    "properties": _by_name,
    "$defs": _by_name,
    "patternProperties": _by_name,
    "description": _plain,
    "default": lambda value: value,
    "enum": lambda value: value,
    "const": lambda value: value,
}
