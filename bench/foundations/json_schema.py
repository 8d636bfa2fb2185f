"""JSON Schemas of file models, for editors that complete, explain and check while one types."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

from pydantic import BaseModel
from pydantic.json_schema import GenerateJsonSchema

Schema = dict[str, Any]

DIALECT = "https://json-schema.org/draft/2020-12/schema"


class _Generator(GenerateJsonSchema):
    """Without titles made of key names: an editor shows the key itself beside the description."""

    def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ARG002 - pydantic's signature
        return False


def json_schema(model: type[BaseModel], title: str) -> Schema:
    """Write the schema of a file model, draft 2020-12.

    Parameters
    ----------
    model : type
        The model; descriptions, defaults and bounds are those of its fields.
    title : str
        What such a file is.

    Returns
    -------
    dict
        The schema; models below are in its ``$defs``.
    """
    made = model.model_json_schema(schema_generator=_Generator)
    return {"$schema": DIALECT, "title": title} | {
        key: value for key, value in tidied(made).items() if key != "title"
    }


def tidied(schema: Any) -> Any:
    """Leave out of a schema, at every depth, what says nothing to who writes a file."""
    if isinstance(schema, list):
        return [tidied(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    kept = {key: value for key, value in schema.items() if not _is_noise(key, value)}
    return {key: _BELOW.get(key, tidied)(value) for key, value in kept.items()}


def _is_noise(key: str, value: Any) -> bool:
    """The name of a class, a whole section as a default, and a keyword of OpenAPI alone."""
    return (
        (key == "title" and isinstance(value, str))
        or (key == "default" and isinstance(value, Mapping))
        or (key == "discriminator" and isinstance(value, Mapping) and "propertyName" in value)
    )


def _by_name(schemas: dict[str, Any]) -> dict[str, Any]:
    """Schemas by names that are no keywords: keys of a file, or models."""
    return {name: tidied(each) for name, each in schemas.items()}


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
