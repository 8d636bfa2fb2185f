"""A commented file to start from, written out of a JSON Schema: every key with meaning, bounds and default.

Keys with a value stand as they are. Optional ones without stand commented out, with their default:
a line that begins with ``#`` and no space, or an even number of them, before its key.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

import yaml

from gyrobench.bench.foundations.documents import Schema

_WIDTH = 100
_BOUNDS = (
    ("minimum", "at least"),
    ("exclusiveMinimum", "above"),
    ("maximum", "at most"),
    ("exclusiveMaximum", "below"),
)


class StartingFile:
    """Writes files of one schema.

    Parameters
    ----------
    schema : dict
        With ``$defs`` for what it refers to.
    """

    def __init__(self, schema: Schema) -> None:
        self._schema = schema
        self._definitions: Mapping[str, Schema] = schema.get("$defs", {})
        self._told: set[str] = set()

    def lines(self, values: Mapping[str, Any]) -> Iterator[str]:
        """Lines of a file with these values.

        Parameters
        ----------
        values : mapping
            What is to stand in the file; a required key that is missing gets a value that fits.
        """
        self._told.clear()
        return self._section(self._schema, values, "")

    def _section(self, schema: Schema, values: Mapping[str, Any], indent: str) -> Iterator[str]:
        required = schema.get("required", [])
        # What tells the section's kind, such as a dialect, comes first.
        for key, each in sorted(schema["properties"].items(), key=lambda item: "const" not in item[1]):
            if key in values or key in required:
                value = values[key] if key in values else _some_value(self._resolved(each, None))
                yield from self._given(key, each, value, indent)
            else:
                yield from self._left_out(key, each, indent)

    def _given(self, key: str, schema: Schema, value: Any, indent: str) -> Iterator[str]:
        below = self._resolved(schema, value)
        if isinstance(value, Mapping) and "properties" in below and not self._has_short_form(schema):
            if not indent:
                yield ""
            yield from self._commented(f"{indent}{key}:", _meaning(schema, below), indent)
            yield from self._section(below, value, f"{indent}  ")
        else:
            yield from self._commented(f"{indent}{key}: {inline(value)}", self._explained(schema), indent)

    def _left_out(self, key: str, schema: Schema, indent: str) -> Iterator[str]:
        below = self._resolved(schema, {})
        is_section = "properties" in below and not self._may_be_null(schema)
        if is_section and not below.get("required"):
            yield from self._commented(f"{indent}#{key}:", _meaning(schema, below), indent)
            for line in self._section(below, {}, ""):
                # Keys begin after an even number of spaces, explanations after one.
                yield f"{indent}{line}" if line.startswith("# ") else f"{indent}#  {line.removeprefix('#')}"
            return
        default = inline(schema.get("default")) if "default" in schema else _empty(below)
        yield from self._commented(f"{indent}#{key}: {default}", self.explained(schema), indent)

    def _commented(self, line: str, text: str, indent: str) -> Iterator[str]:
        """A line with its explanation behind it, or above it where that is too long; a long one once."""
        together = f"{line}  # {text}" if text else line
        if len(together) <= _WIDTH:
            yield together
            return
        if text not in self._told:
            yield from comment(text, f"{indent}# ")
        self._told.add(text)
        yield line

    def _resolved(self, schema: Schema, value: Any) -> Schema:
        """Follow references and alternatives to the schema that a value is of."""
        if "$ref" in schema:
            return self._resolved(self._definitions[schema["$ref"].rpartition("/")[2]], value)
        options = [self._resolved(each, value) for key in ("oneOf", "anyOf") for each in schema.get(key, ())]
        if "properties" in schema or not options:
            return schema
        if isinstance(value, Mapping):
            sections = [each for each in options if "properties" in each]
            fitting = [each for each in sections if _names_the_same(each, value)]
            return (fitting or sections or options)[0]
        return options[0]

    def _has_short_form(self, schema: Schema) -> bool:
        return any(each.get("type") == "string" for each in schema.get("anyOf", ()))

    def _may_be_null(self, schema: Schema) -> bool:
        return any(each.get("type") == "null" for each in schema.get("anyOf", ()))

    def explained(self, schema: Schema) -> str:
        """Say what a key means, what its value may be, and which keys that has."""
        below = self._resolved(schema, {})
        keys = f" (keys: {', '.join(below['properties'])})" if "properties" in below else ""
        return self._explained(schema) + keys

    def _explained(self, schema: Schema) -> str:
        options = schema.get("anyOf", [schema])
        allowed = (_allowed(self._resolved(each, None)) for each in options)
        return "; ".join(filter(None, (_meaning(schema, self._resolved(schema, None)), *allowed)))


def inline(value: Any) -> str:
    """A value on one line of YAML."""
    text: str = yaml.safe_dump(
        value, default_flow_style=True, width=float("inf"), sort_keys=False, allow_unicode=True
    )
    return text.removesuffix("\n...\n").removesuffix("\n")


def comment(text: str, lead: str = "# ", then: str = "") -> list[str]:
    """Lines of a comment, each with ``lead`` before it, all but the first with ``then`` too."""
    return textwrap.wrap(text, _WIDTH, initial_indent=lead, subsequent_indent=lead + then)


def _meaning(schema: Schema, below: Schema) -> str:
    text = str(schema.get("description", below.get("description", "")))
    return text if text.endswith("...") else text.removesuffix(".")


def _allowed(schema: Schema) -> str:
    if "enum" in schema:
        return f"one of {', '.join(map(str, schema['enum']))}"
    if "minimum" in schema and "maximum" in schema:
        return f"{schema['minimum']:g} to {schema['maximum']:g}"
    bounds = [f"{word} {schema[key]:g}" for key, word in _BOUNDS if key in schema]
    return ", ".join(bounds)


def _names_the_same(schema: Schema, value: Mapping[str, Any]) -> bool:
    """Whether a value has what makes out one alternative of several: its name, as of a dialect."""
    fixed = {key: each["const"] for key, each in schema["properties"].items() if "const" in each}
    return bool(fixed) and all(value.get(key) == const for key, const in fixed.items())


def _some_value(schema: Schema) -> Any:
    for key in ("const", "default", "minimum"):
        if key in schema:
            return schema[key]
    if "enum" in schema:
        return schema["enum"][0]
    return {"string": "fill_in", "boolean": False, "array": [], "object": {}}.get(schema.get("type", ""), 1)


def _empty(schema: Schema) -> str:
    return {"array": "[]", "object": "{}"}.get(schema.get("type", ""), "null")
