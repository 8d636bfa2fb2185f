"""Reads YAML documents and validates them against models, with the place of every mistake.

A procedure, station or world file is read safely (no code, a limited number of values) and validated
against a :class:`StrictModel`. All problems are reported together, each as
``file:line:column: what was found; what is allowed``.
"""

from __future__ import annotations

import logging
import re
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import decode_text, read_limited
from gyrobench.bench.foundations.shipped import USES
from gyrobench.bench.foundations.text import WRITE_POINT, did_you_mean, excerpt, has_decimal_comma, quoted
from gyrobench.bench.foundations.yaml_nodes import InvalidYamlError, KeyPath, read_yaml

MAX_DOCUMENT_BYTES = 1_000_000
#: Start of a text that is a placeholder for what a person has to write.
FILL_IN = "fill_in"
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_OTHER_MINUS_SIGNS = re.compile("^[\u2010-\u2015\u2212]")
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
        (r"should match pattern '\^\[\^/.*\[dD\].*'", "must be NAME.dbc, without a folder"),
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
        content = read_yaml(text)
    except InvalidYamlError as error:
        line, column = error.place
        raise DocumentError(f"{path}:{line}:{column}: {error}") from error
    document = Document(path, text, content.data, content.places)
    if content.problems:
        raise document.error(DocumentProblem(*problem) for problem in content.problems)
    return document


def validate(document: Document, model: type[_ModelT], further: Sequence[DocumentProblem] = ()) -> _ModelT:
    """Validate a document against a model and return the model.

    If validation fails, ``further`` problems, found outside the model, are reported with those of the model.
    Raises DocumentError, which lists all problems, each with its place.
    """
    if not isinstance(document.data, dict):
        raise document.error(
            [DocumentProblem((), f"expected keys and values; found {excerpt(document.data)}")]
        )
    expected_key = next((key for key in USES if key in model.model_fields), None)
    other_key = next((key for key in USES if key in document.data and key not in model.model_fields), None)
    if expected_key and other_key and expected_key not in document.data:
        use = USES[other_key].format(shlex.quote(str(document.path)))
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
                    log_once(f"{document.place(location)}: '{old}' is an old name. Write '{new}'.")


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
            if location and isinstance(location[-1], str) and message.startswith("the value must be a list"):
                message = quoted(location[-1]) + message.removeprefix("the value")
            if keys := _DOTTED_KEYS.match(message):
                location = (*location, *keys[1].split("."))
            if not (isinstance(value, dict) and excerpt(value).endswith("...")):  # a whole section
                message += f"; found {excerpt(value)}{_advice(detail['type'], value, location)}"
        problems.append(DocumentProblem(location, message))
    return problems


def _advice(error_type: str, value: Any, location: KeyPath) -> str:
    """Advice how to write the value correctly, as a sentence; empty if unknown."""
    if isinstance(value, str) and value.startswith(FILL_IN):
        return ""
    if error_type == "list_type" and isinstance(value, int | float | str):
        item = value if isinstance(value, str) and value.isprintable() else excerpt(value)
        return f". Put it in brackets: [{item}, ...]"
    if error_type == "list_type" and value is None:
        return ". The items of a list are in brackets: [a, b]"
    if error_type == "list_type" and isinstance(value, dict) and any(key.startswith("-") for key in value):
        return ". Write '- ', with a blank, before an item"
    if not isinstance(value, str):
        return ""
    if has_decimal_comma(value):
        return f". {WRITE_POINT}"
    if error_type.startswith(("float", "int")):
        if _NUMBER.fullmatch(value):
            return ". Write the number without quotes"
        if _NUMBER.fullmatch(hyphened := _OTHER_MINUS_SIGNS.sub("-", value)):
            return f". Write the minus sign as a hyphen: {hyphened}"
        if _NUMBER_WITH_UNIT.fullmatch(value):
            return ". Write the number alone, in the unit of the key"
    if location and value == location[-1]:
        return f". A variable of a loop is written ${value}"
    return ""


def plain_message(message: str) -> str:
    """Rewrite a message of pydantic in the words of the bench."""
    for pattern, plain in _PLAIN_WORDS:
        message = pattern.sub(plain, message)
    return message


#: Old names found while a document is validated: the key as written, the old name, and the new name.
_renaming_notes: ContextVar[set[tuple[str, str, str]] | None] = ContextVar("renaming_notes", default=None)


@cache
def log_once(note: str) -> None:
    """Log a note once; without a logging configuration it goes to standard error."""
    logging.getLogger("gyrobench").warning(note)


def _update_names(model: type[StrictModel], data: dict[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Replace old names in data; returns the new data, and the old key of each renamed key by the new one."""
    notes, renamed, old_keys = _renaming_notes.get(), {}, {}
    if notes is None:
        notes = set()
    for key, value in data.items():
        new_key = model.renamed_keys.get(key, key)
        if new_key != key and new_key in data:  # both are given: the old one is reported as unknown
            new_key = key
        if new_key != key:
            old_keys[new_key] = key
            notes.add((key, key, new_key))
        values, new_values = value if isinstance(value, list) else [value], []
        for old in values:
            new = model.renamed_values.get(new_key, {}).get(old, old) if isinstance(old, str) else old
            if new is not old:
                notes.add((key, f"{key}: {old}", f"{new_key}: {new}"))
            new_values.append(new)
        renamed[new_key] = new_values if isinstance(value, list) else new_values[0]
    return renamed, old_keys


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
            message = re.sub(r"^(?:Input|String|List|Dictionary)(?= should)", lambda _: quoted(key), message)
            field = model.model_fields.get(key)
            if kind in _TYPES_WITH_DESCRIPTION and field and field.description:
                message += f" ({field.description})"
    return InitErrorDetails(type=PydanticCustomError(kind, message), loc=location, input=detail.get("input"))


def _wrong_kind(detail: Any, location: KeyPath) -> tuple[str, str, KeyPath]:
    """Type, message and location of an error in the key that gives the kind of an entry."""
    key = detail["ctx"]["discriminator"].strip("'")
    if detail["type"] == "union_tag_not_found":
        return "missing_kind", f"the key {quoted(key)} is missing", location
    value, allowed = detail["ctx"]["tag"], re.findall(r"'(\w+)'", detail["ctx"]["expected_tags"])
    message = f"unknown {key} {quoted(value)}{did_you_mean(value, allowed)}; allowed here: "
    return "unknown_kind", message + ", ".join(allowed), (*location, key)


def _unknown_key(key: str, allowed: list[str]) -> str:
    if key.isdecimal():  # such as 48,1 in braces
        return f"unknown key {quoted(key)}. {WRITE_POINT}"
    if ":" in key:  # such as duration_s:300 in braces
        return f"unknown key {quoted(key)}. Put a blank after the colon"
    return f"unknown key {quoted(key)}{did_you_mean(key, allowed)}; allowed here: {', '.join(allowed)}"


def _missing_key(key: str, model: type[BaseModel]) -> str:
    field = model.model_fields.get(key)
    meaning = f": {field.description}" if field and field.description else ""
    return f"the key {quoted(key)} is missing{meaning}"


def _line_and_column(line: str) -> tuple[int, int, str]:
    match = re.match(r".*?:(\d+):(\d+): ", line)
    return (int(match[1]), int(match[2]), line) if match else (0, 0, line)
