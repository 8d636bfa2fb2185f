"""The directive ``yaml-keys``: tables of all keys of a file, made from the model that checks it."""

from __future__ import annotations

import importlib
import inspect
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, get_args

from docutils import nodes
from docutils.parsers.rst import directives
from pydantic import BaseModel, TypeAdapter
from pydantic.fields import FieldInfo
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

_MOST_VALUES_SHOWN = 60


@dataclass(frozen=True)
class Key:
    """One row: a key of a file, what it means and what it may be."""

    name: str
    meaning: str
    values: str
    default: str


@dataclass
class Section:
    """The keys of one model: where they stand, and what the model is for."""

    path: str
    meaning: str
    keys: list[Key] = field(default_factory=list)


def sections_of(
    model: type[BaseModel], path: str = "", above: tuple[type[BaseModel], ...] = ()
) -> Iterator[Section]:
    """The keys of a model and, after them, of every model below it.

    Parameters
    ----------
    model : type of BaseModel
        Top of the file, or of a part of it.
    path : str
        Keys that lead to it, joined by dots.
    above : tuple of type of BaseModel
        Models that it stands in; one of them inside itself is not opened again.
    """
    section = Section(path, first_sentence(model))
    below: list[tuple[str, type[BaseModel], str]] = []
    for name, info in model.model_fields.items():
        models = _models_in(info.annotation)
        here = f"{path}.{name}" if path else name
        section.keys.append(_key(name, info, models))
        for each in models:
            mark = _discriminating(each)
            below.append((here + ("[]" if _is_list(info.annotation) else ""), each, mark))
    yield section
    for here, each, mark in below:
        if each not in (*above, model):
            yield from sections_of(each, f"{here} {mark}".strip(), (*above, model))


def first_sentence(thing: Any) -> str:
    """First paragraph of what a class says of itself, on one line."""
    return " ".join((inspect.getdoc(thing) or "").partition("\n\n")[0].split())


def _key(name: str, info: FieldInfo, models: list[type[BaseModel]]) -> Key:
    meaning = info.description or "; ".join(first_sentence(each).rstrip(".") for each in models)
    return Key(name, meaning, _values(info, models), _default(info))


def _default(info: FieldInfo) -> str:
    if info.is_required():
        return "required"
    default = info.get_default(call_default_factory=True)
    if default in (None, "") or isinstance(default, BaseModel):
        return ""
    text = json.dumps(default, default=str)
    return text if len(text) <= _MOST_VALUES_SHOWN else ""


def _values(info: FieldInfo, models: list[type[BaseModel]]) -> str:
    if models:
        return "list of keys below" if _is_list(info.annotation) else "keys below"
    annotated: Any = Annotated[info.annotation, *info.metadata] if info.metadata else info.annotation
    try:
        return _in_words(TypeAdapter(annotated).json_schema())
    except Exception:  # what has no schema is told by its meaning alone  # noqa: BLE001
        return ""


def _in_words(schema: dict[str, Any]) -> str:
    if "enum" in schema:
        return ", ".join(map(str, schema["enum"]))
    if "const" in schema:
        return str(schema["const"])
    if "anyOf" in schema or "oneOf" in schema:
        parts = [part for part in schema.get("anyOf", schema.get("oneOf")) if part.get("type") != "null"]
        return " or ".join(dict.fromkeys(_in_words(part) for part in parts))
    kind = schema.get("type", "")
    if kind == "array":
        length = schema.get("minItems") if schema.get("minItems") == schema.get("maxItems") else None
        items = _in_words(schema.get("items", {})) or "values"
        return f"{length or 'list of'} x {items}" if length else f"list of {items}"
    if kind == "object":
        return "keys and values"
    words = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true, false"}
    return " ".join(part for part in (words.get(kind, kind), _bounds(schema)) if part)


def _bounds(schema: dict[str, Any]) -> str:
    low, high = schema.get("minimum"), schema.get("maximum")
    above, below = schema.get("exclusiveMinimum"), schema.get("exclusiveMaximum")
    parts = []
    if above is not None:
        parts.append(f"above {above:g}")
    if below is not None:
        parts.append(f"below {below:g}")
    if low is not None and high is not None:
        parts.append(f"{low:g} to {high:g}")
    elif low is not None:
        parts.append(f"from {low:g}")
    elif high is not None:
        parts.append(f"up to {high:g}")
    return ", ".join(parts)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_in(part)]


def _is_list(annotation: Any) -> bool:
    return str(annotation).startswith(("list", "typing.Annotated[list"))


def _discriminating(model: type[BaseModel]) -> str:
    """``(kind: bias_jump)`` where one of the keys tells the model from its alternatives."""
    for key in ("kind", "fault"):
        if key in model.model_fields:
            values = get_args(model.model_fields[key].annotation)
            return f"({key}: {', '.join(map(str, values))})"
    return ""


class YamlKeys(SphinxDirective):
    """Tables of keys of ``package.module:Model``, or of ``package.module:MAPPING`` of models by name."""

    required_arguments = 1
    option_spec: ClassVar = {"without": directives.unchanged}

    def run(self) -> list[nodes.Node]:
        """Make the tables."""
        module, _, name = self.arguments[0].partition(":")
        found = getattr(importlib.import_module(module), name)
        tops = {"": found} if inspect.isclass(found) else found
        sections = [part for each, model in tops.items() for part in sections_of(model, each)]
        left_out = self.options.get("without", "").split()
        for section in sections:
            section.keys = [key for key in section.keys if key.name not in left_out]
        return [node for section in sections for node in self._drawn(section)]

    def _drawn(self, section: Section) -> Iterator[nodes.Node]:
        if section.path:
            yield nodes.rubric("", "", nodes.literal("", section.path))
        if section.meaning:
            yield nodes.paragraph("", section.meaning)
        if section.keys:
            yield table(
                ("key", "meaning", "values", "default"),
                [(key.name, key.meaning, key.values, key.default) for key in section.keys],
                (3, 6, 3, 2),
                [nodes.literal, nodes.Text, nodes.Text, nodes.Text],
            )


def table(
    header: tuple[str, ...],
    rows: list[tuple[str, ...]],
    widths: tuple[int, ...],
    kinds: list[Callable[..., nodes.Node]],
) -> nodes.table:
    """A table of plain text; each column is of one kind of node."""
    group = nodes.tgroup(cols=len(header))
    group.extend(nodes.colspec(colwidth=width) for width in widths)
    head, body = nodes.thead(), nodes.tbody()
    head += _row([nodes.Text(text) for text in header])
    for row in rows:
        body += _row([_cell(kind, text) for kind, text in zip(kinds, row, strict=True)])
    group.extend([head, body])
    return nodes.table("", group, classes=["keys"])


def _cell(kind: Callable[..., nodes.Node], text: str) -> nodes.Node:
    return nodes.literal("", text) if kind is nodes.literal and text else nodes.Text(text)


def _row(cells: list[nodes.Node]) -> nodes.row:
    row = nodes.row()
    row.extend(nodes.entry("", nodes.paragraph("", "", *_with_literals(cell))) for cell in cells)
    return row


def _with_literals(cell: nodes.Node) -> list[nodes.Node]:
    """What stands between back quotes as a literal, as in the models' own words."""
    if not isinstance(cell, nodes.Text):
        return [cell]
    parts = cell.astext().split("`")
    return [nodes.literal("", part) if number % 2 else nodes.Text(part) for number, part in enumerate(parts)]


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("yaml-keys", YamlKeys)
    return {"parallel_read_safe": True}
