"""Commented procedure, station, world and effect files to start from, written from the JSON Schemas.

Keys with a value are written as they are. Optional keys without a value are commented out with their default:
the key follows ``#`` with no space, or with an even number of spaces.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from gyrobench.bench.authoring.file_kinds import (
    EDITOR_MARK,
    EFFECT,
    IMPORT_MAP,
    PROCEDURE,
    STATION,
    WORLD,
    FileKind,
    editor_line,
    schema_of,
)
from gyrobench.bench.closure.effects.effect_file import EffectFile
from gyrobench.bench.foundations.documents import FILL_IN, parse_document, read_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.json_schema import Schema
from gyrobench.bench.foundations.shipped import TEMPLATES, find_document
from gyrobench.bench.procedure.procedure_file import STEP_KINDS, checked_procedure, resolve
from gyrobench.bench.procedure.steps import Step
from gyrobench.bench.station.instrument_sections import section_of
from gyrobench.bench.station.station_file import StationFile

#: A bound this large only keeps computations finite: templates and pages leave it out.
NO_BOUND = 1e9
_WIDTH = 100
_BOUNDS = (
    ("minimum", "at least"),
    ("exclusiveMinimum", "above"),
    ("maximum", "at most"),
    ("exclusiveMaximum", "below"),
)


class _TemplateWriter:
    """Writes templates for one schema, which contains all referenced schemas in ``$defs``."""

    def __init__(self, schema: Schema) -> None:
        self._schema = schema
        self._definitions: Mapping[str, Schema] = schema.get("$defs", {})
        self._written_comments: set[str] = set()

    def lines(self, values: Mapping[str, Any]) -> Iterator[str]:
        """Lines of a file with these values.

        A missing required key gets an allowed value.
        """
        self._written_comments.clear()
        return self._section(self._schema, values, "")

    def _section(self, schema: Schema, values: Mapping[str, Any], indent: str) -> Iterator[str]:
        required = schema.get("required", [])
        # The key that selects the section's kind, such as a dialect, comes first.
        for key, each in sorted(schema["properties"].items(), key=lambda item: "const" not in item[1]):
            if key in values or key in required:
                value = values[key] if key in values else _some_value(self._resolve(each, None))
                yield from self._lines_of_key(key, each, value, indent)
            else:
                yield from self._lines_of_optional_key(key, each, indent)

    def _lines_of_key(self, key: str, schema: Schema, value: Any, indent: str) -> Iterator[str]:
        resolved = self._resolve(schema, value)
        if isinstance(value, Mapping) and "properties" in resolved and not _allows(schema, "string"):
            if not indent:
                yield ""
            yield from self._with_comment(f"{indent}{key}:", _description_of(schema, resolved), indent)
            yield from self._section(resolved, value, f"{indent}  ")
        else:
            yield from self._with_comment(
                f"{indent}{key}: {_inline(value)}", self._value_comment(schema), indent
            )

    def _lines_of_optional_key(self, key: str, schema: Schema, indent: str) -> Iterator[str]:
        resolved = self._resolve(schema, {})
        is_section = "properties" in resolved and not _allows(schema, "null")
        if is_section and not resolved.get("required"):
            yield from self._with_comment(f"{indent}#{key}:", _description_of(schema, resolved), indent)
            for line in self._section(resolved, {}, ""):
                # Keys follow an even number of spaces, explanations a single space.
                yield f"{indent}{line}" if line.startswith("# ") else f"{indent}#  {line.removeprefix('#')}"
            return
        empty = {"array": "[]", "object": "{}"}.get(resolved.get("type", ""), "null")
        default = _inline(schema["default"]) if "default" in schema else empty
        yield from self._with_comment(f"{indent}#{key}: {default}", self.key_comment(schema), indent)

    def _with_comment(self, line: str, text: str, indent: str) -> Iterator[str]:
        """A line with its explanation after it, or above it if too long; a long one only the first time."""
        commented_line = f"{line}  # {text}" if text else line
        if len(commented_line) <= _WIDTH:
            yield commented_line
            return
        if text not in self._written_comments:
            yield from _comment(text, f"{indent}# ")
        self._written_comments.add(text)
        yield line

    def _resolve(self, schema: Schema, value: Any) -> Schema:
        """Resolve references and alternatives to the schema of a value."""
        if "$ref" in schema:
            return self._resolve(self._definitions[schema["$ref"].rpartition("/")[2]], value)
        options = [self._resolve(each, value) for key in ("oneOf", "anyOf") for each in schema.get(key, ())]
        if "properties" in schema or not options:
            return schema
        if isinstance(value, Mapping):
            sections = [each for each in options if "properties" in each]
            matching = [each for each in sections if _has_same_constants(each, value)]
            return (matching or sections or options)[0]
        return options[0]

    def key_comment(self, schema: Schema) -> str:
        """Meaning of a key, its allowed values, and its keys."""
        resolved = self._resolve(schema, {})
        keys = f" (keys: {', '.join(resolved['properties'])})" if resolved.get("properties") else ""
        return self._value_comment(schema) + keys

    def _value_comment(self, schema: Schema) -> str:
        options = schema.get("anyOf", [schema])
        allowed = (_allowed_values(self._resolve(each, None)) for each in options)
        return "; ".join(filter(None, (_description_of(schema, self._resolve(schema, None)), *allowed)))


def _inline(value: Any) -> str:
    """Format a value as one line of YAML."""
    text: str = yaml.safe_dump(
        value, default_flow_style=True, width=float("inf"), sort_keys=False, allow_unicode=True
    )
    return text.removesuffix("\n...\n").removesuffix("\n")


def _comment(text: str, lead: str = "# ", then: str = "") -> list[str]:
    """Lines of a comment, each after ``lead``; ``then`` indents all but the first."""
    return textwrap.wrap(text, _WIDTH, initial_indent=lead, subsequent_indent=lead + then)


def _allows(schema: Schema, kind: str) -> bool:
    """Whether a value may instead be of a simple type, such as "string" for a short form."""
    return any(each.get("type") == kind for each in schema.get("anyOf", ()))


def _description_of(schema: Schema, resolved: Schema) -> str:
    text = str(schema.get("description", resolved.get("description", "")))
    return text if text.endswith("...") else text.removesuffix(".")


def _allowed_values(schema: Schema) -> str:
    if "enum" in schema:
        return f"one of {', '.join(map(str, schema['enum']))}"
    limits = {key: schema[key] for key, _ in _BOUNDS if key in schema and abs(schema[key]) < NO_BOUND}
    if "minimum" in limits and "maximum" in limits:
        return f"{limits['minimum']:g} to {limits['maximum']:g}"
    bounds = [f"{word} {limits[key]:g}" for key, word in _BOUNDS if key in limits]
    return ", ".join(bounds)


def _has_same_constants(schema: Schema, value: Mapping[str, Any]) -> bool:
    """Whether a value has the constants of a schema, such as the name of a dialect."""
    constants = {key: each["const"] for key, each in schema["properties"].items() if "const" in each}
    return bool(constants) and all(value.get(key) == const for key, const in constants.items())


def _some_value(schema: Schema) -> Any:
    for key in ("const", "default", "minimum"):
        if key in schema:
            return schema[key]
    if "enum" in schema:
        return schema["enum"][0]
    return {"string": FILL_IN, "boolean": False, "array": [], "object": {}}.get(schema.get("type", ""), 1)


_EXAMPLE_STATION = "example_bench"
_NOT_FILLED_IN = f"{FILL_IN}: mounting and what the INS sends are those of an example"
#: Keys, by section, with values specific to a bench, in which the example's values would be misleading.
_BENCH_SPECIFIC_KEYS = {
    ("location",): ("latitude_deg", "height_m"),
    ("rate_table", "limits"): ("rate_dps", "acceleration_dps2", "jerk_dps3", "outer_deg", "inner_deg"),
    ("chamber", "limits"): ("low_c", "high_c", "ramp_c_per_min"),
    ("ins", "noise"): ("angle_random_walk_deg_per_sqrt_h", "velocity_random_walk_ug_per_sqrt_hz"),
}
_NAME = re.compile(r"[A-Za-z0-9_-]{1,80}")
_WORLD_NAME = re.compile(r"^world:.*$", re.MULTILINE)
_HINT = (
    "A key after # without a space is optional, as are those within it after # and two spaces; they show the "
    "defaults. To use them, remove the # before both."
)


def new_procedure(name: str, like: str, path: Path) -> str:
    """Write the text of a procedure file at ``path``.

    ``like``: a key of :data:`gyrobench.bench.foundations.shipped.TEMPLATES`, a shipped procedure, or a file.
    Raises DocumentError if there is no such template, or the name is invalid.
    """
    template = read_document(find_document("procedures", TEMPLATES.get(like, like)))
    values = {
        **template.data,
        "procedure": name,
        "description": f"Made from {template.data['procedure']}.",
        "assumptions": [],
    }
    schema = schema_of(PROCEDURE)
    steps = values.pop("steps")
    head_properties = {key: each for key, each in schema["properties"].items() if key != "steps"}
    head = {**schema, "properties": head_properties, "required": ["procedure"]}
    text = _text(
        PROCEDURE,
        path,
        _TemplateWriter(head).lines(values),
        ["", "# What to do, in order. The kinds of step and their keys are at the end.", "steps:"],
        _steps(steps, "  "),
        ["", *_step_reference(schema)],
    )
    document = parse_document(text, path)
    resolve(document, checked_procedure(document))
    return text


def new_station(name: str, path: Path, table: str | None = None, chamber: str | None = None) -> str:
    """Write the text of a station file from the shipped example, with placeholders for bench-specific values.

    ``table``, ``chamber``: dialects; by default those of the example. Raises DocumentError if there is no
    such dialect, or the name is invalid.
    """
    values = read_document(find_document("stations", _EXAMPLE_STATION)).data
    values |= {"station": name, "description": _NOT_FILLED_IN}
    for section, dialect in (("rate_table", table), ("chamber", chamber)):
        if dialect is not None and dialect != values[section]["dialect"]:
            values[section] = _for_dialect(values[section], dialect, section)
        values[section] = {**values[section], "port": FILL_IN}
    validate(parse_document(_inline(values), path), StationFile)
    for path_of_section, keys in _BENCH_SPECIFIC_KEYS.items():
        section = values
        for key in path_of_section:
            section = section[key]
        section.update(dict.fromkeys(keys, FILL_IN))
    return _text(STATION, path, _TemplateWriter(schema_of(STATION)).lines(values))


def new_world(name: str, like: str, path: Path) -> str:
    """Copy a world, shipped or a file, under another name without parsing it: only the emulators may do that.

    Raises DocumentError if there is no such world, or the name is invalid.
    """
    if not _NAME.fullmatch(name):
        raise DocumentError(f"{name}: not a name of a world; use letters, digits, underscore and hyphen")
    text = _text_to_copy(find_document("worlds", like))
    return editor_line(WORLD, path) + _WORLD_NAME.sub(f"world: {name}", text, count=1)


def new_import_map(like: str, path: Path) -> str:
    """Copy an import map, shipped or a file. Raises DocumentError if there is no such import map."""
    return editor_line(IMPORT_MAP, path) + _text_to_copy(find_document("imports", like))


def _text_to_copy(path: Path) -> str:
    """Text of a file without the line for editors."""
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    return "".join(line for line in lines if not line.startswith(EDITOR_MARK))


def new_effect(name: str, path: Path) -> str:
    """Write the text of an effect file to edit: an onset of the electronics temperature.

    Raises DocumentError if the name is invalid.
    """
    values = {
        "effect": name,
        "statement": "the bias follows the electronics temperature above an onset",
        "experiment": "soak with the electronics below and above the onset, at one optics temperature",
        "driver": "board_c",
        "shape": "onset",
        "bounds": {"onset": [20.0, 70.0], "width": [1.0, 10.0]},
    }
    text = _text(EFFECT, path, _TemplateWriter(schema_of(EFFECT)).lines(values))
    validate(parse_document(text, path), EffectFile)
    return text


def _for_dialect(section: Mapping[str, Any], dialect: str, name: str) -> dict[str, Any]:
    """A section for another dialect, with the keys that all dialects have."""
    common: Any = StationFile.model_fields[name].annotation
    section_of(common, dialect)  # raises DocumentError if it is not installed
    keys = common.model_fields.keys() - {"baudrate", "parity"}
    return {**{key: value for key, value in section.items() if key in keys}, "dialect": dialect}


def _text(kind: FileKind, path: Path, *parts: Iterable[str]) -> str:
    head = editor_line(kind, path) + "\n".join(_comment(_HINT)) + "\n\n"
    return head + "".join(f"{line}\n" for part in parts for line in part)


def _steps(entries: list[Any], indent: str) -> Iterator[str]:
    for entry in entries:
        if isinstance(entry, dict) and "repeat" in entry:
            loop = entry["repeat"]
            yield f"{indent}- repeat:"
            yield f"{indent}    over: {_inline(loop['over'])}"
            yield f"{indent}    steps:"
            yield from _steps(loop["steps"], f"{indent}      ")
        elif isinstance(entry, dict):
            [(name, keys)] = entry.items()
            yield f"{indent}- {name}: {_inline(keys)}"
        else:
            yield f"{indent}- {entry}"


def _step_reference(schema: Schema) -> Iterator[str]:
    """Describe each kind of step with its keys, as comments."""
    yield "# Kinds of step. Each can have these keys:"
    kinds = {name: schema["$defs"][name] for name in (*STEP_KINDS, "repeat")}
    common = Step.model_fields.keys()
    yield from _keys(schema, kinds["wait"], only=common)
    for name, kind in kinds.items():
        yield "#"
        yield from _comment(f"{name}: {kind['description']}")
        yield from _keys(schema, kind, only=kind["properties"].keys() - common)


def _keys(schema: Schema, kind: Schema, only: Collection[str]) -> Iterator[str]:
    key_comment = _TemplateWriter(schema).key_comment
    for key, each in kind["properties"].items():
        if key in only:
            notes = [key_comment(each)]
            if each.get("default") is not None:
                notes.append(f"{_inline(each['default'])} if not given")
            if key in kind.get("required", ()):
                notes.append("needed")
            yield from _comment(f"{key}: {'; '.join(notes)}", "#   ", "  ")
