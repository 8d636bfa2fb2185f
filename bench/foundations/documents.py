"""Reads YAML documents and validates them against models, with the place of every mistake.

A procedure, station or world file is read safely (no code, a limited number of values) and validated
against a :class:`StrictModel`. All problems are reported together, each as
``file:line:column: what was found; what is allowed``.
"""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import decode_text, read_limited
from gyrobench.bench.foundations.shipped import USES
from gyrobench.bench.foundations.text import WRITE_POINT, did_you_mean, has_decimal_comma

#: Path of keys and indices from the top of a document to one of its values.
KeyPath = tuple[str | int, ...]

MAX_DOCUMENT_BYTES = 1_000_000
_MAX_VALUES, _MAX_DEPTH = 50_000, 50
_TOO_LARGE = f"more than {_MAX_VALUES} values or deeper than {_MAX_DEPTH} levels"
_MAX_QUOTED_CHARACTERS = 60
_NUMBER_WITH_UNIT = re.compile(r"[-+]?\d+(\.\d+)?\s*[^\d\s.,_].*")
#: Matches a message that begins with the keys of a place, such as "safe_state.chamber_c is ...".
_DOTTED_KEYS = re.compile(r"([a-z_0-9]+(?:\.[a-z_0-9]+)+)\b")
#: Types of errors whose messages do not need the value that was found.
_COMPLETE_TYPES = ("unknown_key", "unknown_kind", "missing_kind")
#: Types of errors whose messages need the description of the key.
_TYPES_WITH_DESCRIPTION = ("string_pattern_mismatch", "list_type")
#: Patterns in pydantic's messages, and their replacements in the words of the bench.
_PLAIN_WORDS = tuple(
    (re.compile(pattern), plain)
    for pattern, plain in (
        (r"^(Value error, |Input should)", lambda match: "the value should" if "Input" in match[0] else ""),
        (r"should have at least 1 item after validation, not 0", "needs at least 1 item"),
        (r"should have at (least|most) (\d+) items? after validation, not \d+", r"must have at \1 \2 items"),
        (r"should have at least 1 character", "must not be empty"),
        (r"should have at (least|most) (\d+) characters?", r"must have at \1 \2 characters"),
        (r"should match pattern '\^\[A-Za-z0-9_-\]\{1,80\}\$'", "may have letters, digits, _ and - only"),
        (r"should match pattern '\^\[a-z0-9_\]\{1,\d+\}\$'", "may have a to z, digits and _ only"),
        (r"should match pattern", "must match the pattern"),
        (r"should be greater than or equal to", "must be at least"),
        (r"should be less than or equal to", "must be at most"),
        (r"should be greater than", "must be above"),
        (r"should be less than", "must be below"),
        (r"should be a valid integer.*", "must be a whole number"),
        (r"should be a valid number", "must be a number"),
        (r"should be a valid string", "must be text"),
        (r"should be a valid boolean", "must be true or false"),
        (r"should be a valid list", "must be a list"),
        (r"should be a valid dictionary.*", "must have keys and values"),
        (r"should be", "must be"),
        (r"^(List|String|Dictionary) ", "the value "),
    )
)

_ModelT = TypeVar("_ModelT", bound="StrictModel")


class StrictModel(BaseModel):
    """Base class of all file models: unknown keys, numbers given as text, and NaN are mistakes.

    Old names of keys and values are accepted; a note then gives the new name.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)
    #: New name of each renamed key, by the old name.
    renamed_keys: ClassVar[Mapping[str, str]] = {}
    #: New values by old value, for each key by its new name.
    renamed_values: ClassVar[Mapping[str, Mapping[str, Any]]] = {}

    @model_validator(mode="wrap")
    @classmethod
    def _accept_old_names_and_list_allowed_keys(cls, data: Any, handler: Callable[[Any], Any]) -> Any:
        old_keys: dict[str, str] = {}
        if isinstance(data, dict):
            data, old_keys = _update_names(cls, data)
        try:
            return handler(data)
        except ValidationError as error:
            raise ValidationError.from_exception_data(
                cls.__name__, [_rewrite_error(detail, cls, old_keys) for detail in error.errors()]
            ) from error


@dataclass(frozen=True)
class DocumentProblem:
    """A mistake at one location of a document."""

    location: KeyPath
    message: str

    @property
    def text(self) -> str:
        """Keys of the place, and the message."""
        return f"{'.'.join(map(str, self.location))}: {self.message}"


@dataclass(frozen=True)
class Document:
    """A YAML file that was read: its data, and the place of each value in the file."""

    path: Path
    text: str
    data: Any
    #: (line, column), both from 1, of every key and item.
    places: dict[KeyPath, tuple[int, int]] = field(repr=False)

    def place(self, location: Sequence[str | int]) -> str:
        """``file:line:column`` of the deepest part of ``location`` that the file contains."""
        deepest: KeyPath = ()
        for part in location:
            if (*deepest, part) in self.places:
                deepest = (*deepest, part)
        line, column = self.places.get(deepest, (1, 1))
        return f"{self.path}:{line}:{column}"

    def error(self, problems: Iterable[DocumentProblem]) -> DocumentError:
        """Combine problems into one error, in the order of the file."""
        lines = {f"{self.place(problem.location)}: {problem.message}" for problem in problems}
        return DocumentError("\n".join(sorted(lines, key=_line_and_column)))


def read_document(path: Path) -> Document:
    """Read one YAML file.

    Raises DocumentError if the file can't be read, is too large, or is not valid YAML.
    """
    return parse_document(decode_text(path, read_limited(path, MAX_DOCUMENT_BYTES, DocumentError)), path)


def parse_document(text: str, path: Path) -> Document:
    """Parse YAML text read from ``path``; raises as :func:`read_document`."""
    try:
        node = _compose(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        if str(error.problem).startswith(_NO_COLON):
            mark = error.context_mark
        place = f"{mark.line + 1}:{mark.column + 1}" if mark else "1:1"
        raise DocumentError(f"{path}:{place}: not valid YAML: {_describe_yaml_error(error, text)}") from error
    # For invalid version numbers and \U escapes PyYAML raises the errors of int() and chr().
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError) as error:
        raise DocumentError(f"{path}:1:1: not valid YAML: {str(error).splitlines()[0]}") from error
    if node is None:
        raise DocumentError(f"{path}:1:1: the file is empty")
    reader = _NodeReader()
    try:
        data = reader.read(node, ())
    except _TooManyValuesError:
        raise DocumentError(f"{path}:1:1: {_TOO_LARGE}") from None
    document = Document(path, text, data, reader.places)
    if reader.problems:
        raise document.error(reader.problems)
    return document


def validate(document: Document, model: type[_ModelT], further: Sequence[DocumentProblem] = ()) -> _ModelT:
    """Validate a document against a model and return the model.

    If validation fails, ``further`` problems, found outside the model, are reported with those of the model.
    Raises DocumentError, which lists all problems, each with its place.
    """
    if not isinstance(document.data, dict):
        raise document.error(
            [DocumentProblem((), f"expected keys and values; found {_excerpt(document.data)}")]
        )
    expected_key = next((key for key in USES if key in model.model_fields), None)
    other_key = next((key for key in USES if key in document.data and key not in model.model_fields), None)
    if expected_key and other_key and expected_key not in document.data:
        use = USES[other_key].format(document.path)
        kinds = f"a {other_key} file, not a {expected_key} file".replace("_", " ")
        raise document.error([DocumentProblem((other_key,), f"this is {kinds}. {use}")])
    notes: set[tuple[str, str, str]] = set()
    token = _renaming_notes.set(notes)
    try:
        return model.model_validate(document.data)
    except ValidationError as error:
        raise document.error([*problems_of(error), *further]) from error
    finally:
        _renaming_notes.reset(token)
        for key, old, new in sorted(notes):
            for location in document.places:
                if location and location[-1] == key:
                    _log_once(f"{document.place(location)}: '{old}' is an old name. Write '{new}'.")


def problems_of(error: ValidationError, parent: KeyPath = ()) -> list[DocumentProblem]:
    """Convert a validation error of the value at ``parent`` to problems."""
    problems = []
    for detail in error.errors():
        location = (*parent, *detail["loc"])
        message = detail["msg"]
        if detail["type"] == "missing":
            location = location[:-1]
        elif detail["type"] not in _COMPLETE_TYPES:
            value, message = detail["input"], plain_message(message)
            if location and isinstance(location[-1], str):
                message = re.sub(r"^the value (?=must be a list)", f"{_quote(location[-1])} ", message)
            if keys := _DOTTED_KEYS.match(message):
                location = (*location, *keys[1].split("."))
            if not (isinstance(value, dict) and _excerpt(value).endswith("...")):  # a whole section
                message += f"; found {_excerpt(value)}{_advice(detail['type'], value, location)}"
        problems.append(DocumentProblem(location, message))
    return problems


def _advice(error_type: str, value: Any, location: KeyPath) -> str:
    """Advice how to write the value correctly, as a sentence; empty if unknown."""
    if error_type == "list_type" and isinstance(value, int | float):
        return f". Put it in brackets: [{_excerpt(value)}, ...]"
    if not isinstance(value, str):
        return ""
    if has_decimal_comma(value):
        return f". {WRITE_POINT}"
    if error_type.startswith(("float", "int")) and _NUMBER_WITH_UNIT.fullmatch(value):
        return ". Write the number alone, in the unit of the key"
    if location and value == location[-1]:
        return f". A variable of a loop is written ${value}"
    return ""


def plain_message(message: str) -> str:
    """Rewrite a message of pydantic in the words of the bench."""
    for pattern, plain in _PLAIN_WORDS:
        message = pattern.sub(plain, message)
    return message


class _Composer(yaml.composer.Composer, yaml.resolver.BaseResolver):
    """Composes nodes with the plain scalars of YAML 1.2: ``1e-5`` is a number, ``on`` is text.

    Stops parsing at too many values, as parsing the whole text would take minutes.
    """

    _values = _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        self._values += 1
        self._depth += 1
        # Twice the limits, since keys count here but not in _NodeReader.
        if self._values > 2 * _MAX_VALUES or self._depth > 2 * _MAX_DEPTH:
            mark = self.peek_event().start_mark  # type: ignore[attr-defined]  # of the parser
            raise _TooLargeError(None, None, _TOO_LARGE, mark)
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


class _TooLargeError(yaml.composer.ComposerError):
    """A text has too many values."""


class _Loader(_Composer, yaml.SafeLoader):
    """Safe loader in Python; the bench shows its messages."""


_FastestLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _FastLoader(_Composer, _FastestLoader):  # type: ignore[misc]
    """Safe loader with the parser in C if PyYAML has it, which is four times as fast."""

    def __init__(self, text: str) -> None:
        yaml.composer.Composer.__init__(self)
        _FastestLoader.__init__(self, text)


_SCALARS = {
    "bool": re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"),
    "null": re.compile(r"^(?:~|null|Null|NULL|)$"),
    "int": re.compile(r"^[-+]?[0-9]+$"),
    "float": re.compile(
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
    ),
}
for _tag, _first in (
    ("bool", "tTfF"),
    ("null", ["~", "n", "N", ""]),
    ("int", "-+0123456789"),
    ("float", "-+.0123456789"),
):
    _Composer.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", _SCALARS[_tag], list(_first))


_NO_COLON = "could not find expected ':'"
#: Tokens that begin an item or a key; if the parser does not expect them, the indentation is wrong.
_START_TOKENS = ("'<block sequence start>'", "'<block mapping start>'", "'-'", "'?'")


def _describe_yaml_error(error: yaml.MarkedYAMLError, text: str) -> str:
    """Describe a YAML error by its probable cause, with the line where the list, key or bracket begins."""
    problem, begin, mark = str(error.problem or error.context), error.context_mark, error.problem_mark
    lines = text.splitlines()
    at_mark = "" if mark is None else "".join(lines[mark.line : mark.line + 1])[mark.column :]
    if "cannot start any token" in problem and at_mark.startswith("\t"):
        return "found a tab. Indent with spaces"
    if begin is None:
        return problem
    if problem.startswith(_NO_COLON):
        return f"no colon after the key {_quote(lines[begin.line].strip())}, or an item without '-'"
    if problem.startswith("expected <block end>") and problem.endswith(_START_TOKENS):
        return f"the indentation differs from that of line {begin.line + 1}, where the list or the keys begin"
    if problem.startswith(("expected ',' or '}'", "expected ',' or ']'")):
        return f"{problem}. Is the bracket of line {begin.line + 1}, column {begin.column + 1} closed?"
    if problem == "expected the node content, but found '<stream end>'":
        return "the file ends where a value is expected. Is each bracket closed?"
    return problem


def _compose(text: str) -> yaml.Node | None:
    try:
        return yaml.compose(text, Loader=_FastLoader)
    except _TooLargeError:
        raise
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError):
        return yaml.compose(text, Loader=_Loader)


_COLLECTION_TAGS = ("tag:yaml.org,2002:map", "tag:yaml.org,2002:seq")


class _TooManyValuesError(Exception):
    """A document has too many values, which aliases can produce from few bytes."""


class _NodeReader:
    """Converts YAML nodes to plain data and records their places."""

    def __init__(self) -> None:
        self.places: dict[KeyPath, tuple[int, int]] = {}
        self.problems: list[DocumentProblem] = []

    def read(self, node: yaml.Node, location: KeyPath) -> Any:
        self.places.setdefault(location, (node.start_mark.line + 1, node.start_mark.column + 1))
        if len(self.places) > _MAX_VALUES or len(location) > _MAX_DEPTH:
            raise _TooManyValuesError
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node, location)
        if node.tag not in _COLLECTION_TAGS:
            self.problems.append(DocumentProblem(location, f"a value can't have the tag {_quote(node.tag)}"))
            return None
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, location)
        return [self.read(item, (*location, index)) for index, item in enumerate(node.value)]

    def _mapping(self, node: yaml.MappingNode, location: KeyPath) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self.problems.append(
                    DocumentProblem(location, "a key has to be plain text; found a list or keys")
                )
                continue
            key = str(key_node.value)
            key_path = (*location, key)
            self.places[key_path] = (key_node.start_mark.line + 1, key_node.start_mark.column + 1)
            if key in result:
                self.problems.append(DocumentProblem(key_path, f"the key {_quote(key)} is given twice"))
                continue
            result[key] = self.read(value_node, key_path)
        return result

    def _scalar(self, node: yaml.Node, location: KeyPath) -> Any:
        kind = node.tag.removeprefix("tag:yaml.org,2002:")
        text = str(node.value)
        if kind == "str":
            return text
        # Any text may have a tag such as !!int, so the text is checked here as well.
        if kind in _SCALARS and _SCALARS[kind].fullmatch(text):
            match kind:
                case "null":
                    return None
                case "bool":
                    return text.lower() == "true"
                case "int" if len(text) <= _MAX_QUOTED_CHARACTERS:
                    return int(text)
                case "float" if re.fullmatch(r"[-+.0-9Ee]+", text):
                    return float(text)
                case "float":  # .inf or .nan
                    self.problems.append(
                        DocumentProblem(
                            location, f"the value must be a finite number; found {_excerpt(text)}"
                        )
                    )
                    return None
        self.problems.append(
            DocumentProblem(location, f"expected text, a number or true/false; found {_excerpt(text)}")
        )
        return None


#: Old names found while a document is validated: the key as written, the old name, and the new name.
_renaming_notes: ContextVar[set[tuple[str, str, str]] | None] = ContextVar("renaming_notes", default=None)


@cache
def _log_once(note: str) -> None:
    """Log a note once; without a logging configuration it goes to standard error."""
    logging.getLogger("gyrobench").warning(note)


def _update_names(model: type[StrictModel], data: dict[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Replace old names in data; returns the new data, and the old key of each renamed key by the new one."""
    notes, renamed, old_keys = _renaming_notes.get(), {}, {}
    for key, value in data.items():
        new_key = model.renamed_keys.get(key, key)
        if new_key != key:
            if new_key in data:  # both are given: the old one is reported as unknown
                new_key = key
            else:
                old_keys[new_key] = key
                if notes is not None:
                    notes.add((key, key, new_key))
        new_values = model.renamed_values.get(new_key, {})
        renamed[new_key] = (
            [_new_value(each, new_values) for each in value]
            if isinstance(value, list)
            else (_new_value(value, new_values))
        )
        for old in value if isinstance(value, list) else [value]:
            if notes is not None and _new_value(old, new_values) != old:
                notes.add((key, f"{key}: {old}", f"{new_key}: {_new_value(old, new_values)}"))
    return renamed, old_keys


def _new_value(value: Any, new_values: Mapping[str, Any]) -> Any:
    return new_values.get(value, value) if isinstance(value, str) else value


def _rewrite_error(detail: Any, model: type[BaseModel], old_keys: Mapping[str, str]) -> InitErrorDetails:
    kind, message, location = detail["type"], detail["msg"], detail["loc"]
    if location and location[0] in old_keys:
        location = (old_keys[location[0]], *location[1:])
    has_key = str(detail.get("ctx", {}).get("discriminator", "")).startswith("'")  # not a function
    if has_key and kind in ("union_tag_invalid", "union_tag_not_found"):
        kind, message, location = _wrong_kind(detail, location)
    elif len(detail["loc"]) == 1:  # otherwise a nested model has rewritten it
        key = str(detail["loc"][0])
        if kind == "extra_forbidden":
            kind, message = "unknown_key", _unknown_key(key, list(model.model_fields))
        elif kind == "missing":
            message = _missing_key(key, model)
        else:
            message = re.sub(r"^(Input|String|List|Dictionary) should", f"{_quote(key)} should", message)
            field = model.model_fields.get(key)
            if kind in _TYPES_WITH_DESCRIPTION and field and field.description:
                message += f" ({field.description})"
    return InitErrorDetails(type=PydanticCustomError(kind, message), loc=location, input=detail.get("input"))


def _wrong_kind(detail: Any, location: KeyPath) -> tuple[str, str, KeyPath]:
    """Type, message and location of an error in the key that gives the kind of an entry."""
    key = detail["ctx"]["discriminator"].strip("'")
    if detail["type"] == "union_tag_not_found":
        return "missing_kind", f"the key {_quote(key)} is missing", location
    value, allowed = detail["ctx"]["tag"], re.findall(r"'(\w+)'", detail["ctx"]["expected_tags"])
    message = f"unknown {key} {_quote(value)}{did_you_mean(value, allowed)}; allowed here: "
    return "unknown_kind", message + ", ".join(allowed), (*location, key)


def _unknown_key(key: str, allowed: list[str]) -> str:
    if key.isdecimal():  # such as 48,1 in braces
        return f"unknown key {_quote(key)}. {WRITE_POINT}"
    return f"unknown key {_quote(key)}{did_you_mean(key, allowed)}; allowed here: {', '.join(allowed)}"


def _missing_key(key: str, model: type[BaseModel]) -> str:
    field = model.model_fields.get(key)
    meaning = f": {field.description}" if field and field.description else ""
    return f"the key {_quote(key)} is missing{meaning}"


def _quote(key: str) -> str:
    return f"'{key}'" if key.isprintable() else json.dumps(key)


def _excerpt(value: Any) -> str:
    text = json.dumps(value, default=str, ensure_ascii=False)
    text = text if text.isprintable() else json.dumps(value, default=str)
    return text if len(text) <= _MAX_QUOTED_CHARACTERS else f"{text[:_MAX_QUOTED_CHARACTERS]}..."


def _line_and_column(line: str) -> tuple[int, int, str]:
    match = re.match(r".*?:(\d+):(\d+): ", line)
    return (int(match[1]), int(match[2]), line) if match else (0, 0, line)
