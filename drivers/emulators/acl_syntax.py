"""Text of the ACL, the command language of the Acutrol 3000 (manual TM-8004).

A message is a row of units ``:MAIN:Sub argument,argument`` joined by ``;``. A unit that starts
without a colon continues in the node of the unit before it. Keywords may be shortened to their
leading letters; where several fit, the one listed first here is meant.

The public manual lists no error codes. Those below are an assumption: any nonzero code.
"""

from __future__ import annotations

import math
import re
from enum import IntEnum
from functools import lru_cache
from typing import NamedTuple

MAX_MESSAGE_CHARACTERS = 32768
_MAX_NUMBER_CHARACTERS = 28
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,3})?", re.ASCII)
_HEADER = re.compile(r"(\*[A-Za-z]+|:?[A-Za-z]+(:[A-Za-z]+)*)(\??)", re.ASCII)

#: The keywords, in the order in which an abbreviation is looked for.
KEYWORDS: dict[str, tuple[str, ...]] = {
    "INTERLOCK": ("CLOSE", "OPEN", "RESET"),
    "MODE": ("POSITION", "RATE", "ARATE", "SYNTHESIS", "TRACK", "OFF", "HOME"),
    "DEMAND": ("POSITION", "RATE", "ACCELERATION", "DELTAPOSITION", "SHORTVECTOR", "VECTOR"),
    "LIMIT": ("RATE", "ACCELERATION", "HIGHPOSITION", "LOWPOSITION", "VTRIP", "GLOBAL", "ABSOLUTE"),
    "READ": ("POSITION", "RATE", "ACCELERATION", "VECTOR", "SHORTVECTOR", "VARIABLE"),
    "STATUS": ("CSR", "ECP", "MSG"),
    "QUERY": ("ERROR", "SYSTEM"),
    "UTILITY": ("LOCKOUT", "FORMAT"),
}

Argument = float | str


class ErrorCode(IntEnum):
    """What can be wrong with a message."""

    NONE = 0
    SYNTAX = 100
    UNKNOWN_COMMAND = 101
    WRONG_PARAMETER_COUNT = 102
    WRONG_PARAMETER_TYPE = 103
    MESSAGE_TOO_LONG = 104
    PARAMETER_OUT_OF_RANGE = 200
    NOT_SERVOED = 201
    CANNOT_SERVO = 202
    NOT_AVAILABLE = 203

    @property
    def text(self) -> str:
        """Words for a person."""
        return "No error" if self is ErrorCode.NONE else self.name.replace("_", " ").capitalize()


class AclError(Exception):
    """A message that is refused; never leaves the emulator."""

    def __init__(self, code: ErrorCode) -> None:
        super().__init__(code.text)
        self.code = code


class Unit(NamedTuple):
    """One command or query, its keywords written out."""

    header: tuple[str, ...]
    is_query: bool
    arguments: tuple[Argument, ...]


@lru_cache(maxsize=512)
def parse_message(text: str) -> tuple[Unit, ...]:
    """Take a message apart.

    Raises
    ------
    AclError
        The text is no ACL, or has a keyword that does not exist.
    """
    units = []
    node: tuple[str, ...] = ()
    for part in text.split(";"):
        unit = _parse_unit(part.strip(), node)
        if not unit.header[0].startswith("*"):
            node = unit.header[:-1]
        units.append(unit)
    return tuple(units)


def _parse_unit(text: str, node: tuple[str, ...]) -> Unit:
    header_text, *rest = text.split(maxsplit=1) if text else [""]
    match = _HEADER.fullmatch(header_text)
    if match is None:
        raise AclError(ErrorCode.SYNTAX)
    arguments = tuple(_parse_argument(word.strip()) for word in rest[0].split(",")) if rest else ()
    return Unit(_written_out(match[1], node), bool(match[3]), arguments)


def _written_out(header: str, node: tuple[str, ...]) -> tuple[str, ...]:
    header = header.upper()
    if header.startswith("*"):
        return (header,)
    path = () if header.startswith(":") else node
    for word in header.removeprefix(":").split(":"):
        path = (*path, _keyword(word, path))
    return path


def _keyword(word: str, path: tuple[str, ...]) -> str:
    known = KEYWORDS if not path else KEYWORDS[path[0]] if len(path) == 1 else ()
    found = find_keyword(word, tuple(known))
    if found is None:
        raise AclError(ErrorCode.UNKNOWN_COMMAND)
    return found


def find_keyword(word: str, known: tuple[str, ...]) -> str | None:
    """First of the known keywords that starts with the word, whatever its case."""
    return next((keyword for keyword in known if word and keyword.startswith(word.upper())), None)


def _parse_argument(word: str) -> Argument:
    if _NUMBER.fullmatch(word):
        if len(word) >= _MAX_NUMBER_CHARACTERS:
            raise AclError(ErrorCode.WRONG_PARAMETER_TYPE)
        if not math.isfinite(value := float(word)):
            raise AclError(ErrorCode.PARAMETER_OUT_OF_RANGE)
        return value
    if not word:
        raise AclError(ErrorCode.SYNTAX)
    return word.upper()


def format_number(value: float, decimals: int) -> str:
    """Write a number in NR2: fixed point, no exponent, no plus sign, no negative zero."""
    return f"{round(value, decimals) + 0.0:.{decimals}f}"
