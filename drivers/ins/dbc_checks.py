"""Mistakes of a DBC file that its parser does not name, or only after using up memory or minutes."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator
from itertools import pairwise

from cantools.database import Database
from cantools.database.can import Message

from gyrobench.drivers.ins.bit_fields import FLOAT_LENGTHS
from gyrobench.drivers.ins.frames import MAX_LENGTH

#: The longest message of SAE J1939, whose DBC files describe it as one.
_MAX_MESSAGE_BYTES = 1785
#: Far beyond any device's file; the parser's work grows with their squares.
_MAX_MULTIPLEXER_IDS = 65536
_MAX_SIGNALS = 1000
_MAX_LINE_CHARACTERS = 64_000

_MESSAGE = re.compile(r"^[ \t]*BO_[ \t]+\d+[ \t]+\w+[ \t]*:[ \t]*(?P<bytes>\d+)", re.MULTILINE)
_SIGNAL = re.compile(
    r"\bSG_[ \t]+\w+[ \t]*(?:[mM]\w*)?[ \t]*:[ \t]*(?P<start>\d+)[ \t]*\|[ \t]*(?P<length>\d+)"
)
_MESSAGE_START = re.compile(r"\bBO_\b")
_SIGNAL_START = re.compile(r"\bSG_\b")
_MULTIPLEXER = re.compile(r"^[ \t]*SG_MUL_VAL_[^;]*", re.MULTILINE)
_RANGE = re.compile(r"(\d+)[ \t]*-[ \t]*(\d+)")


def oversized(text: str) -> Iterator[str]:
    """Name, with their lines, what no CAN device has: sizes and numbers beyond all measure."""
    for number, line in enumerate(text.splitlines(), start=1):
        if len(line) > _MAX_LINE_CHARACTERS:
            yield f"line {number}: a line of {len(line)} characters"
            return
    message_starts = [found.start() for found in _MESSAGE_START.finditer(text)]
    for begin, end in pairwise([0, *message_starts, len(text)]):
        count = len(_SIGNAL_START.findall(text, begin, end))
        if count > _MAX_SIGNALS:
            yield f"line {text.count(chr(10), 0, begin) + 1}: a message of {count} signals"
            return
    for found in _MESSAGE.finditer(text):
        if int(found["bytes"]) > _MAX_MESSAGE_BYTES:
            yield f"line {_line(text, found)}: a message of {found['bytes']} bytes"
    for found in _SIGNAL.finditer(text):
        if max(int(found["start"]), int(found["length"])) > 8 * _MAX_MESSAGE_BYTES:
            yield f"line {_line(text, found)}: a signal of {found['length']} bits at bit {found['start']}"
    count = 0
    for found in _MULTIPLEXER.finditer(text):
        count += sum(int(last) - int(first) + 1 for first, last in _RANGE.findall(found[0]))
        if count > _MAX_MULTIPLEXER_IDS:
            yield f"line {_line(text, found)}: {count} multiplexer values up to here"
            return


def undecodable(database: Database) -> Iterator[str]:
    """Name the signals of classic CAN messages whose values can't be computed."""
    for kind, all_of_kind in (
        ("message called", [message.name for message in database.messages]),
        ("message numbered", [_number(message) for message in database.messages]),
    ):
        twice = [each for each, count in Counter(all_of_kind).items() if count > 1]
        yield from (f"a second {kind} {each}" for each in twice)
    for message in database.messages:
        for signal in message.signals if message.length <= MAX_LENGTH else ():
            name = f"{message.name}.{signal.name}"
            if signal.conversion.is_float and signal.length not in FLOAT_LENGTHS:
                yield f"{name}: a floating-point number of {signal.length} bits"
            if signal.scale == 0 or not math.isfinite(signal.scale) or not math.isfinite(signal.offset):
                yield f"{name}: scale {signal.scale} and offset {signal.offset}"


def _number(message: Message) -> str:
    return f"{message.frame_id}{' with 29 bits' if message.is_extended_frame else ''}"


def _line(text: str, found: re.Match[str]) -> int:
    return text.count("\n", 0, found.start()) + 1
