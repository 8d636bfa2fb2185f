"""Mistakes of a DBC file that its parser does not name, or only after using up the memory."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

from cantools.database import Database

from drivers.ins.bit_fields import FLOAT_LENGTHS
from drivers.ins.frames import MAX_LENGTH

#: The longest message of SAE J1939, whose DBC files describe it as one.
_MAX_MESSAGE_BYTES = 1785
_MAX_MULTIPLEXER_IDS = 65536

_MESSAGE = re.compile(r"^[ \t]*BO_[ \t]+\d+[ \t]+\w+[ \t]*:[ \t]*(?P<bytes>\d+)", re.MULTILINE)
_SIGNAL = re.compile(r"\bSG_[ \t]+\w+[ \t\w]*:[ \t]*(?P<start>\d+)[ \t]*\|[ \t]*(?P<length>\d+)")
_MULTIPLEXER = re.compile(r"^[ \t]*SG_MUL_VAL_[^;]*", re.MULTILINE)
_RANGE = re.compile(r"(\d+)[ \t]*-[ \t]*(\d+)")


def oversized(text: str) -> Iterator[str]:
    """Name, with their lines, the numbers that no CAN message has."""
    for found in _MESSAGE.finditer(text):
        if int(found["bytes"]) > _MAX_MESSAGE_BYTES:
            yield f"line {_line(text, found)}: a message of {found['bytes']} bytes"
    for found in _SIGNAL.finditer(text):
        if max(int(found["start"]), int(found["length"])) > 8 * _MAX_MESSAGE_BYTES:
            yield f"line {_line(text, found)}: a signal of {found['length']} bits at bit {found['start']}"
    for found in _MULTIPLEXER.finditer(text):
        count = sum(int(last) - int(first) for first, last in _RANGE.findall(found[0]))
        if count > _MAX_MULTIPLEXER_IDS:
            yield f"line {_line(text, found)}: a signal with {count} multiplexer values"


def undecodable(database: Database) -> Iterator[str]:
    """Name the signals of classic CAN messages whose values can't be computed."""
    for message in database.messages:
        for signal in message.signals if message.length <= MAX_LENGTH else ():
            name = f"{message.name}.{signal.name}"
            if signal.conversion.is_float and signal.length not in FLOAT_LENGTHS:
                yield f"{name}: a floating-point number of {signal.length} bits"
            if signal.scale == 0 or not math.isfinite(signal.scale) or not math.isfinite(signal.offset):
                yield f"{name}: scale {signal.scale} and offset {signal.offset}"


def _line(text: str, found: re.Match[str]) -> int:
    return text.count("\n", 0, found.start()) + 1
