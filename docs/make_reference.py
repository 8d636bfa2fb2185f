"""Write the generated parts of docs/reference/: ``python docs/make_reference.py``.

A page holds a comment ``<!-- keys package.module:Model -->`` (or ``...:MAPPING`` of models by name, with
``without=`` the keys to leave out) or ``<!-- commands -->``. It is followed by a table of all keys, made from
the models that check the files, or by the help of every command. ``--check`` writes nothing and exits with 1
where a page differs.
"""

from __future__ import annotations

import importlib
import inspect
import json
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin

import typer.main
from pydantic import BaseModel, TypeAdapter
from pydantic.fields import FieldInfo

from gyrobench.bench.authoring.new_files import NO_BOUND
from gyrobench.bench.cli import app

PAGES = Path(__file__).parent / "reference"
_MAX_DEFAULT_LENGTH = 60
#: Keys that distinguish a model from its alternatives; its heading has their value.
_MARKS = ("kind", "fault")
_PART = re.compile(
    r"(?P<head><!-- (?P<kind>keys|commands)(?P<words>[^>]*) -->\n).*?(?=<!-- end -->)", re.DOTALL
)


def page_text(page: Path) -> str:
    """Text of a page with its generated parts made again."""
    return _PART.sub(lambda part: f"{part['head']}\n{_generated(part)}\n", page.read_text(encoding="utf-8"))


def _generated(part: re.Match[str]) -> str:
    if part["kind"] == "commands":
        first: dict[str, str] = {}
        return "\n".join(_command_section(name, command, first) for name, command in _commands())
    place, *options = part["words"].split()
    left_out = {key for option in options for key in option.removeprefix("without=").split(",")}
    module, _, name = place.partition(":")
    found = getattr(importlib.import_module(module), name)
    tops = {"": found} if inspect.isclass(found) else found
    alike: dict[tuple[str, tuple[Key, ...]], list[Section]] = {}
    for section in (each for path, model in tops.items() for each in sections_of(model, path)):
        alike.setdefault((section.meaning, tuple(section.keys)), []).append(section)
    return "\n".join(_keys_section(sections, left_out) for sections in alike.values())


def _table(header: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [header, tuple("---" for _ in header), *rows]
    return (
        "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)
        + "\n"
    )


def _keys_section(sections: list[Section], left_out: set[str]) -> str:
    """Table of the keys that stand at one place or, alike, at several."""
    section, *others = sections
    rows = [
        (f"`{key.name}`", key.meaning, key.values, _shown(key.default))
        for key in section.keys
        if key.name not in left_out and (key.meaning or key.name not in _MARKS)
    ]
    parts = [
        f"**`{section.path}`**{'; also ' * bool(others)}{', '.join(f'`{each.path}`' for each in others)}\n"
        if section.path
        else "",
        f"{section.meaning}\n" if section.meaning else "",
    ]
    parts.append(_table(("key", "meaning", "values", "default"), rows) if rows else "")
    return "\n".join(part for part in parts if part)


def _shown(default: str) -> str:
    return default if default in ("", "required") else f"`{default}`"


def _commands() -> Iterator[tuple[str, Any]]:
    """Every command by the words that call it, groups opened."""
    yield from _below("gyrobench", typer.main.get_command(app))


def _below(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    if getattr(command, "hidden", False):
        return
    if hasattr(command, "commands"):
        for word, below in command.commands.items():
            yield from _below(f"{name} {word}", below)
    else:
        yield name, command


def _command_section(name: str, command: Any, first: dict[str, str]) -> str:
    """Section of one command; ``first``: the command that had each table of options first."""
    parts = [f"## {name}\n"]
    for text in inspect.cleandoc(command.help or "").split("\n\n"):
        head, example, rest = " ".join(text.split()).partition("Example: ")
        parts += [f"{head.strip()}\n"] if head else []
        parts += [f"```text\n{rest}\n```\n"] if example else []
    rows = [_parameter(each) for each in command.params if not getattr(each, "hidden", False)]
    if rows:
        table = _table(("argument or option", "meaning", "default"), rows)
        like = first.setdefault(table, name)
        parts.append(table if like == name else f"Arguments and options as of `{like}`.\n")
    return "\n".join(parts)


def _parameter(parameter: Any) -> tuple[str, str, str]:
    is_argument = parameter.param_type_name == "argument"
    name = (parameter.metavar or parameter.name.upper()) if is_argument else ", ".join(parameter.opts)
    name += "..." * (is_argument and parameter.nargs == -1)
    default = parameter.default
    is_shown = not callable(default) and default not in (None, "", (), [], False)
    shown = f"`{default}`" if is_shown else ""
    values = ", ".join(_choices(parameter.type_descriptor.annotation))
    are_in_help = all(value in (parameter.help or "") for value in values.split(", "))
    meaning = f"{parameter.help or ''}{f' Values: {values}.' * (not are_in_help)}"
    return f"`{name}`", meaning, "required" if parameter.required else shown


def _choices(annotation: Any) -> list[str]:
    """Values of an option that is a choice, or a list of choices; none of another."""
    if inspect.isclass(annotation) and issubclass(annotation, Enum):
        return [str(each.value) for each in annotation]
    if get_origin(annotation) is list:
        return _choices(get_args(annotation)[0])
    return list(get_args(annotation)) if get_origin(annotation) is Literal else []


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
    """First paragraph of a docstring, on one line."""
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
    return text if len(text) <= _MAX_DEFAULT_LENGTH else ""


def _values(info: FieldInfo, models: list[type[BaseModel]]) -> str:
    if models:
        return "list of keys below" if _is_list(info.annotation) else "keys below"
    annotated: Any = Annotated[info.annotation, *info.metadata] if info.metadata else info.annotation
    try:
        return _in_words(TypeAdapter(annotated).json_schema())
    except Exception:  # noqa: BLE001  a type without a schema has its meaning alone
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
    low, high = (None if bound is None or abs(bound) >= NO_BOUND else bound for bound in (low, high))
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
    """``(kind: bias_jump)`` where one key distinguishes the model from its alternatives."""
    for key in _MARKS:
        if key in model.model_fields:
            annotation = model.model_fields[key].annotation
            if get_origin(annotation) is Literal:
                values = get_args(annotation)
                return f"({key}: {', '.join(map(str, values))})"
    return ""


def main() -> int:
    """Write or check the pages; returns the exit code."""
    stale = [
        page for page in sorted(PAGES.glob("*.md")) if page_text(page) != page.read_text(encoding="utf-8")
    ]
    for page in stale:
        if "--check" in sys.argv:
            sys.stderr.write(f"{page}: differs from the models; run python docs/make_reference.py\n")
        else:
            page.write_text(page_text(page), encoding="utf-8")
    return int(bool(stale) and "--check" in sys.argv)


if __name__ == "__main__":
    sys.exit(main())
