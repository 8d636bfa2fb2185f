"""YAML documents checked against models, with the place of every mistake.

A procedure, station or world file is read safely (no code, a limited number of values), validated
against a :class:`StrictModel`, and all that is wrong with it is reported at once as
``file:line:column: what was found; what is allowed``.
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.reading import read_limited
from gyrobench.bench.foundations.shipped import shipped_folders, shipped_names

#: Keys and indices that lead from the top of a document to one of its values.
Location = tuple[str | int, ...]

MAX_DOCUMENT_BYTES = 1_000_000
_MAX_VALUES = 50_000
_MAX_DEPTH = 50
_TOO_MUCH = f"more than {_MAX_VALUES} values or deeper than {_MAX_DEPTH} levels"
_SHOWN_CHARACTERS = 60
#: How pydantic calls a value.
_INPUT = "Input"

ModelT = TypeVar("ModelT", bound="StrictModel")


class StrictModel(BaseModel):
    """Base of all file models: unknown keys, numbers given as text and NaN are mistakes."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    @model_validator(mode="wrap")
    @classmethod
    def _name_the_allowed_keys(cls, data: Any, handler: Callable[[Any], Any]) -> Any:
        try:
            return handler(data)
        except ValidationError as error:
            raise ValidationError.from_exception_data(
                cls.__name__, [_rewritten(detail, cls) for detail in error.errors()]
            ) from error


@dataclass(frozen=True)
class Problem:
    """Something wrong at one place of a document."""

    location: Location
    message: str


@dataclass(frozen=True)
class Document:
    """A YAML file as read: plain data, and where in the file each value stands."""

    path: Path
    text: str
    data: Any
    #: (line, column), both from 1, of every key and item.
    places: dict[Location, tuple[int, int]] = field(repr=False)

    def place(self, location: Sequence[str | int]) -> str:
        """``file:line:column`` of the deepest part of ``location`` that the file contains."""
        known: Location = ()
        for part in location:
            if (*known, part) in self.places:
                known = (*known, part)
        line, column = self.places.get(known, (1, 1))
        return f"{self.path}:{line}:{column}"

    def error(self, problems: Iterable[Problem]) -> DocumentError:
        """One error that lists all problems, in the order of the file."""
        lines = {f"{self.place(problem.location)}: {problem.message}" for problem in problems}
        return DocumentError("\n".join(sorted(lines, key=_line_and_column)))


def read_document(path: Path) -> Document:
    """Read one YAML file.

    Raises
    ------
    DocumentError
        The file can't be read, is too large, or is no valid YAML.
    """
    try:
        text = read_limited(path, MAX_DOCUMENT_BYTES, DocumentError).decode("utf-8")
    except UnicodeDecodeError as error:
        raise DocumentError(f"{path}: is not UTF-8 text: {error.reason} at byte {error.start}") from error
    return parse_document(text, path)


def parse_document(text: str, path: Path) -> Document:
    """Parse YAML text that came from ``path``; see :func:`read_document`."""
    try:
        node = yaml.compose(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{mark.line + 1}:{mark.column + 1}" if mark else "1:1"
        raise DocumentError(f"{path}:{place}: not valid YAML: {error.problem or error.context}") from error
    # PyYAML lets the errors of int() and chr() out for absurd version numbers and \U escapes.
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError) as error:
        raise DocumentError(f"{path}:1:1: not valid YAML: {str(error).splitlines()[0]}") from error
    if node is None:
        raise DocumentError(f"{path}:1:1: the file is empty")
    reader = _NodeReader()
    try:
        data = reader.plain(node, ())
    except _TooMuchError:
        raise DocumentError(f"{path}:1:1: {_TOO_MUCH}") from None
    document = Document(path, text, data, reader.places)
    if reader.problems:
        raise document.error(reader.problems)
    return document


def validate(document: Document, model: type[ModelT]) -> ModelT:
    """Turn a document into its model.

    Raises
    ------
    DocumentError
        Lists everything that does not fit the model, each with its place.
    """
    if not isinstance(document.data, dict):
        raise document.error([Problem((), f"expected keys and values; found {_shown(document.data)}")])
    try:
        return model.model_validate(document.data)
    except ValidationError as error:
        raise document.error(problems_of(error)) from error


def problems_of(error: ValidationError, at: Location = ()) -> list[Problem]:
    """Translate a validation error of a value at ``at`` into problems."""
    problems = []
    for detail in error.errors():
        location = (*at, *detail["loc"])
        message = detail["msg"]
        if detail["type"] == "missing":
            location = location[:-1]
        elif detail["type"] != "unknown_key":
            message = f"{message.removeprefix('Value error, ')}; found {_shown(detail['input'])}"
        problems.append(Problem(location, message))
    return problems


def find_document(kind: str, name: str) -> Path:
    """Find a file by path, or a shipped one by its bare name.

    Parameters
    ----------
    kind : {"procedures", "stations", "worlds", "faults", "imports"}
        Which folder of shipped files to look in.
    name : str
        A path, or the name of a shipped file without its ending.

    Raises
    ------
    DocumentError
        There is no such file; the message lists the shipped names.
    """
    path = Path(name)
    if path.suffix in {".yaml", ".yml"} or len(path.parts) > 1:
        if path.is_file():
            return path
        raise DocumentError(f"{name}: there is no such file. {_listed(kind)}")
    for folder in shipped_folders(kind):
        candidate = folder / f"{name}.yaml"
        if candidate.is_file():
            return candidate
    raise DocumentError(f"{name}: no shipped file of that name. {_listed(kind)}")


def hint(name: str, allowed: Iterable[str]) -> str:
    """Say " (did you mean 'x'?)" if one of the allowed names is near, else nothing."""
    close = difflib.get_close_matches(name, list(allowed), n=1)
    return f" (did you mean '{close[0]}'?)" if close else ""


def _listed(kind: str) -> str:
    return f"Shipped {kind}: {', '.join(shipped_names(kind))}"


class _Loader(yaml.SafeLoader):
    """Safe loader with the plain scalars of YAML 1.2: ``1e-5`` is a number, ``on`` is text.

    It gives up at once where a text holds too many values: parsing on would take minutes.
    """

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._values = self._depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        self._values += 1
        self._depth += 1
        if self._values > 2 * _MAX_VALUES or self._depth > 2 * _MAX_DEPTH:  # keys count here, not below
            here = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(None, None, _TOO_MUCH, here)
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node


_SCALARS = {
    "bool": re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"),
    "null": re.compile(r"^(?:~|null|Null|NULL|)$"),
    "int": re.compile(r"^[-+]?[0-9]+$"),
    "float": re.compile(
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
    ),
}
_Loader.yaml_implicit_resolvers = {}
for _tag, _first in (
    ("bool", "tTfF"),
    ("null", ["~", "n", "N", ""]),
    ("int", "-+0123456789"),
    ("float", "-+.0123456789"),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", _SCALARS[_tag], list(_first))


_COLLECTION_TAGS = ("tag:yaml.org,2002:map", "tag:yaml.org,2002:seq")


class _TooMuchError(Exception):
    """A document holds more than any good one; aliases make few bytes many values."""


class _NodeReader:
    """Turns YAML nodes into plain data and remembers where each stood."""

    def __init__(self) -> None:
        self.places: dict[Location, tuple[int, int]] = {}
        self.problems: list[Problem] = []

    def plain(self, node: yaml.Node, location: Location) -> Any:
        self.places.setdefault(location, (node.start_mark.line + 1, node.start_mark.column + 1))
        if len(self.places) > _MAX_VALUES or len(location) > _MAX_DEPTH:
            raise _TooMuchError
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node, location)
        if node.tag not in _COLLECTION_TAGS:
            self.problems.append(Problem(location, f"a value can't have the tag {_quoted(node.tag)}"))
            return None
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, location)
        return [self.plain(item, (*location, index)) for index, item in enumerate(node.value)]

    def _mapping(self, node: yaml.MappingNode, location: Location) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self.problems.append(Problem(location, "a key has to be plain text; found a list or keys"))
                continue
            key = str(key_node.value)
            here = (*location, key)
            self.places[here] = (key_node.start_mark.line + 1, key_node.start_mark.column + 1)
            if key in result:
                self.problems.append(Problem(here, f"the key {_quoted(key)} is given twice"))
                continue
            result[key] = self.plain(value_node, here)
        return result

    def _scalar(self, node: yaml.Node, location: Location) -> Any:
        kind = node.tag.removeprefix("tag:yaml.org,2002:")
        text = str(node.value)
        if kind == "str":
            return text
        # A tag such as !!int may stand before any text, so the text is checked here as well.
        if kind in _SCALARS and _SCALARS[kind].fullmatch(text):
            match kind:
                case "null":
                    return None
                case "bool":
                    return text.lower() == "true"
                case "int" if len(text) <= _SHOWN_CHARACTERS:
                    return int(text)
                case "float" if re.fullmatch(r"[-+.0-9Ee]+", text):
                    return float(text)
        self.problems.append(
            Problem(location, f"expected text, a number or true/false; found {_shown(text)}")
        )
        return None


def _rewritten(detail: Any, model: type[BaseModel]) -> InitErrorDetails:
    kind, message = detail["type"], detail["msg"]
    if len(detail["loc"]) == 1:  # else a model below has said it
        key = str(detail["loc"][0])
        if kind == "extra_forbidden":
            kind, message = "unknown_key", _unknown_key(key, list(model.model_fields))
        elif kind == "missing":
            message = _missing_key(key, model)
        elif message.startswith(_INPUT):
            message = _quoted(key) + message.removeprefix(_INPUT)
    return InitErrorDetails(
        type=PydanticCustomError(kind, message), loc=detail["loc"], input=detail.get("input")
    )


def _unknown_key(key: str, allowed: list[str]) -> str:
    return f"unknown key {_quoted(key)}{hint(key, allowed)}; allowed here: {', '.join(allowed)}"


def _missing_key(key: str, model: type[BaseModel]) -> str:
    field = model.model_fields.get(key)
    meaning = f": {field.description}" if field and field.description else ""
    return f"the key {_quoted(key)} is missing{meaning}"


def _quoted(key: str) -> str:
    return f"'{key}'" if key.isprintable() else json.dumps(key)


def _shown(value: Any) -> str:
    text = json.dumps(value, default=str, ensure_ascii=False)
    if not text.isprintable():
        text = json.dumps(value, default=str)
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[:_SHOWN_CHARACTERS]}..."


def _line_and_column(line: str) -> tuple[int, int, str]:
    match = re.match(r".*?:(\d+):(\d+): ", line)
    return (int(match[1]), int(match[2]), line) if match else (0, 0, line)
