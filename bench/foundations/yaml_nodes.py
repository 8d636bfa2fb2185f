"""Reads YAML text to plain data with the place of every value; a mistake is described by its probable cause.

No code is run, the number of values is limited, and plain scalars are those of YAML 1.2.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import yaml

from gyrobench.bench.foundations.text import WRITE_POINT, excerpt, quoted

#: Path of keys and indices from the top of a document to one of its values.
KeyPath = tuple[str | int, ...]

_MAX_VALUES, _MAX_DEPTH = 50_000, 50
_TOO_LARGE = f"more than {_MAX_VALUES} values or deeper than {_MAX_DEPTH} levels"
_MAX_NUMBER_CHARACTERS = 60


class InvalidYamlError(ValueError):
    """A text is not valid YAML, is empty or has too many values; ``place``: line and column, from 1."""

    def __init__(self, place: tuple[int, int], problem: str) -> None:
        super().__init__(problem)
        self.place = place


@dataclass(frozen=True)
class YamlText:
    """What a text contains."""

    data: Any
    places: dict[KeyPath, tuple[int, int]]  #: Line and column, from 1, of every key and item.
    #: What plain data can't hold, each with its path: keys given twice, tags, lists as keys, infinities.
    problems: list[tuple[KeyPath, str]]


def read_yaml(text: str) -> YamlText:
    """Read YAML text; raises InvalidYamlError."""
    try:
        node = _compose(text)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        if str(error.problem).startswith(_NO_COLON):
            mark = error.context_mark
        place = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        raise InvalidYamlError(place, f"not valid YAML: {_describe_yaml_error(error, text)}") from error
    # For invalid version numbers and \U escapes PyYAML raises the errors of int() and chr().
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError) as error:
        raise InvalidYamlError((1, 1), f"not valid YAML: {str(error).splitlines()[0]}") from error
    if node is None:
        raise InvalidYamlError((1, 1), "the file is empty")
    reader = _NodeReader()
    try:
        data = reader.read(node, ())
    except _TooManyValuesError:
        raise InvalidYamlError((1, 1), _TOO_LARGE) from None
    return YamlText(data, reader.places, reader.problems)


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
    "int": re.compile(r"^(?:[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+)$"),
    "float": re.compile(
        r"^(?:[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN))$"
    ),
}
_BASES = {"0o": 8, "0x": 16}
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
    if problem.startswith("mapping values are not allowed"):
        return _describe_unexpected_colon("" if mark is None else lines[mark.line])
    if begin is None:
        return problem
    if problem.startswith(_NO_COLON):
        return f"no colon after the key {quoted(lines[begin.line].strip())}, or an item without '-'"
    if problem.startswith("expected <block end>") and problem.endswith(_START_TOKENS):
        return f"the indentation differs from that of line {begin.line + 1}, where the list or the keys begin"
    if problem.startswith(("expected ',' or '}'", "expected ',' or ']'")):
        return f"{problem}. Is the bracket of line {begin.line + 1}, column {begin.column + 1} closed?"
    if problem == "expected the node content, but found '<stream end>'":
        return "the file ends where a value is expected. Is each bracket closed?"
    return problem


def _describe_unexpected_colon(line: str) -> str:
    if re.match(r"\s*-[^-\s]", line):
        return "no blank after '-'. Write '- ', with a blank, before an item"
    if re.match(r".*\S:\s+\S.*:(\s|$)", line):
        return "a second colon. Put a text that contains ': ' in quotes"
    return "no colon is expected here. Check the indentation, and that no key has a value and keys below it"


def _compose(text: str) -> yaml.Node | None:
    try:
        return yaml.compose(text, Loader=_FastLoader)
    except _TooLargeError:
        raise
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError):
        return yaml.compose(text, Loader=_Loader)


_COLLECTION_TAGS = ("tag:yaml.org,2002:map", "tag:yaml.org,2002:seq")


_INTEGER = re.compile(r"[-+]?[0-9]+")


def _columns_between(first: yaml.Node, second: yaml.Node) -> int:
    """Characters between two items of a list; -1 if they are on different lines."""
    end, start = first.end_mark, second.start_mark
    return start.column - end.column if start.line == end.line else -1


class _TooManyValuesError(Exception):
    """A document has too many values, which aliases can produce from few bytes."""


class _NodeReader:
    """Converts YAML nodes to plain data and records their places."""

    def __init__(self) -> None:
        self.places: dict[KeyPath, tuple[int, int]] = {}
        self.problems: list[tuple[KeyPath, str]] = []

    def read(self, node: yaml.Node, location: KeyPath) -> Any:
        self.places.setdefault(location, (node.start_mark.line + 1, node.start_mark.column + 1))
        if len(self.places) > _MAX_VALUES or len(location) > _MAX_DEPTH:
            raise _TooManyValuesError
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node, location)
        if node.tag not in _COLLECTION_TAGS:
            self.problems.append((location, f"a value can't have the tag {quoted(node.tag)}"))
            return None
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, location)
        self._find_decimal_commas(node.value, location)
        return [self.read(item, (*location, index)) for index, item in enumerate(node.value)]

    def _find_decimal_commas(self, items: list[yaml.Node], location: KeyPath) -> None:
        """Find 60,5 in [60,5, -30]: digits on both sides of a comma where other commas have a blank."""
        pairs = list(enumerate(pairwise(items)))
        tight = [(index, pair) for index, pair in pairs if _columns_between(*pair) == 1]
        if len(tight) == len(pairs):
            return
        for index, (first, second) in tight:
            if _INTEGER.fullmatch(str(first.value)) and str(second.value).isdecimal():
                numbers = f"{first.value},{second.value}"
                problem = f"{numbers} is two numbers. {WRITE_POINT}; put a blank after the comma of a list"
                self.problems.append(((*location, index), problem))

    def _mapping(self, node: yaml.MappingNode, location: KeyPath) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self.problems.append((location, "a key has to be plain text; found a list or keys"))
                continue
            key = str(key_node.value)
            key_path = (*location, key)
            self.places[key_path] = (key_node.start_mark.line + 1, key_node.start_mark.column + 1)
            if key in result:
                self.problems.append((key_path, f"the key {quoted(key)} is given twice"))
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
                case "int" if len(text) <= _MAX_NUMBER_CHARACTERS:
                    return int(text, _BASES.get(text[:2], 10))
                case "float" if re.fullmatch(r"[-+.0-9Ee]+", text):
                    return float(text)
                case "float":  # .inf or .nan
                    self.problems.append(
                        (location, f"the value must be a finite number; found {json.dumps(text)}")
                    )
                    return None
        self.problems.append((location, f"expected text, a number or true/false; found {excerpt(text)}"))
        return None
