"""Decodes and encodes CAN payloads in bulk according to a DBC file.

cantools reads the file; the bulk decoding gives the same values as cantools gives for single frames. A signal
is extracted from the payload, as a 64-bit number, by one left shift and one right shift. They remove the
neighbouring signals and, for signed numbers, extend the sign.
"""

from __future__ import annotations

import difflib
import logging
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import islice, pairwise
from pathlib import Path
from typing import Any, Literal

import cantools
import numpy as np
import textparser
from cantools.database import Database
from cantools.database.can import Message, Signal
from numpy.typing import ArrayLike, NDArray

from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray
from gyrobench.bench.foundations.errors import DocumentError, MeasurementError
from gyrobench.bench.foundations.files import read_limited
from gyrobench.drivers.frames import EXTENDED_ID, MAX_LENGTH, FrameBlock

MAX_DBC_BYTES = 2_000_000

# cantools only warns of duplicate messages; they are errors here.
logging.getLogger("cantools").setLevel(logging.ERROR)
_MAX_LISTED_MISTAKES = 20

#: Errors that cantools raises for an invalid file; they have no common base class.
_DBC_ERRORS = (
    cantools.Error, textparser.Error, ValueError, TypeError, LookupError, AttributeError, ArithmeticError,
    RecursionError,
)  # fmt: skip


def load_dbc(path: Path, identifier_offset: int = 0) -> Database:
    """Read a DBC file in UTF-8 or Windows-1252, and add an offset to the identifier of each message.

    Raises DocumentError if the file can't be read, is too large, or is not a valid DBC, or if an identifier
    with the offset is out of range.
    """
    return _database(path, read_limited(path, MAX_DBC_BYTES, DocumentError), identifier_offset)


@lru_cache(maxsize=8)
def _database(path: Path, content: bytes, identifier_offset: int) -> Database:
    database = Database()
    try:
        text = _text(content)
        _raise_mistakes(path, _find_oversized(text))
        database.add_dbc_string(text)
    except DocumentError:
        raise
    except _DBC_ERRORS as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DocumentError(f"{path}: not a valid DBC file: {reason}") from error
    _raise_mistakes(path, _find_undecodable(database))
    if identifier_offset:
        _add_offset(path, database, identifier_offset)
    return database


def _add_offset(path: Path, database: Database, offset: int) -> None:
    """Add an offset to the identifiers; raises DocumentError if one is then out of range."""
    for message in database.messages:
        identifier, highest = message.frame_id + offset, 0x1FFFFFFF if message.is_extended_frame else 0x7FF
        if not 0 <= identifier <= highest:
            raise DocumentError(
                f"{path}: message {message.name} would have the identifier {identifier} with the offset "
                f"{offset}; allowed: 0 to {highest}. Choose another identifier_offset"
            )
        message.frame_id = identifier
    database.refresh()


def _text(content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252")


def _raise_mistakes(path: Path, mistakes: Iterable[str]) -> None:
    lines = [f"{path}: {mistake} is not possible" for mistake in islice(mistakes, _MAX_LISTED_MISTAKES)]
    if lines:
        raise DocumentError("\n".join(lines))


class DbcCodec:
    """Bulk decoding and encoding of the messages of one DBC file.

    Messages longer than a classic CAN frame are ignored.
    """

    def __init__(self, database: Database) -> None:
        self.database = database
        self._layouts = {
            message.name: _Layout(message) for message in database.messages if message.length <= MAX_LENGTH
        }
        #: By identifier of each multiplexed message: the bits of its payload that select a page.
        self.page_masks = {
            each.arbitration_id: each.page_mask for each in self._layouts.values() if each.page_mask
        }

    @property
    def message_names(self) -> list[str]:
        """Names of the messages that can be decoded."""
        return list(self._layouts)

    def arbitration_ids(self) -> NDArray[np.uint32]:
        """Identifiers of all messages; see :meth:`arbitration_id`."""
        return np.array([layout.arbitration_id for layout in self._layouts.values()], np.uint32)

    def arbitration_id(self, message_name: str) -> int:
        """Identifier of a message, with :data:`EXTENDED_ID` set if it has 29 bits."""
        return self._layout(message_name).arbitration_id

    def signal(self, message_name: str, signal_name: str) -> Signal:
        """Description of a signal in the DBC.

        Raises DocumentError if there is no such message or signal; the message has similar names.
        """
        layout = self._layout(message_name)
        if signal_name not in layout.fields:
            similar = _similar_names(signal_name, list(layout.fields))
            raise DocumentError(
                f"the message {message_name} of the DBC has no signal '{signal_name}'{similar}"
            )
        return layout.fields[signal_name].signal

    def rows(self, block: FrameBlock, message_name: str) -> IntArray:
        """Row indices of the frames of a message in the block, without frames that are too short."""
        layout = self._layout(message_name)
        rows = block.rows_with_id(layout.arbitration_id)
        return rows[block.length[rows] >= layout.length]

    def count_short(self, block: FrameBlock, message_name: str) -> int:
        """Count the frames of a message with fewer bytes than in the DBC."""
        layout = self._layout(message_name)
        return int(np.sum(block.length[block.rows_with_id(layout.arbitration_id)] < layout.length))

    def decode(self, block: FrameBlock, message_name: str) -> dict[str, FloatArray]:
        """Decode every signal of a message, in the DBC's units; shape (n,) for its n frames in the block.

        The value is NaN where a multiplexed signal is absent. Integers of more than 53 bits are rounded to
        float64.
        """
        payloads = self.payloads(block, self.rows(block, message_name))
        names = self._layout(message_name).fields
        return {name: self.values(payloads, message_name, name) for name in names}

    def payloads(self, block: FrameBlock, rows: IntArray) -> Payloads:
        """Payloads of the frames at ``rows``, for :meth:`values`."""
        return Payloads(block.data.view(np.uint64)[rows].view(np.uint8))

    def values(self, payloads: Payloads, message_name: str, signal_name: str) -> FloatArray:
        """Decode one signal; see :meth:`decode`."""
        return self._layout(message_name).physical(signal_name, payloads)

    def selected(self, payloads: Payloads, message_name: str, signal_name: str) -> BoolArray:
        """Mask of the payloads that have a multiplexed signal, shape (n,)."""
        return self._layout(message_name).selected(signal_name, payloads)

    def decoder(self, message_name: str, signal_name: str) -> Callable[[bytes], float]:
        """Return a function that decodes a signal of one payload; NaN if absent, or the payload is short."""
        layout = self._layout(message_name)
        field, length = layout.fields[signal_name], layout.length
        raw_value = field.raw_from_payload
        scale, offset = float(field.signal.scale), float(field.signal.offset)

        def decode(data: bytes) -> float:
            return raw_value(data) * scale + offset if len(data) >= length else math.nan

        if field.signal.multiplexer_ids is None:
            return decode
        return lambda data: decode(data) if layout.is_selected_by(signal_name, data) else math.nan

    def encode(self, message_name: str, values: Mapping[str, ArrayLike]) -> NDArray[np.uint8]:
        """Encode the payloads of a message, shape (n, length of the message).

        Values are rounded to the nearest step and clipped to the field's range. Signals without a value, or
        not selected by the multiplexer, are zero. ``values`` are in the DBC's units, each of shape (n,) or
        (). Raises DocumentError if there is no such message or signal. Raises MeasurementError if a value for
        an integer field is not a number.
        """
        layout = self._layout(message_name)
        for name in values:
            self.signal(message_name, name)
        arrays = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, np.float64)) for v in values.values()))
        return layout.encode(dict(zip(values, arrays, strict=True)))

    def __contains__(self, message_name: str) -> bool:
        return message_name in self._layouts

    def _layout(self, message_name: str) -> _Layout:
        if message_name not in self._layouts:
            similar = _similar_names(message_name, list(self._layouts))
            raise DocumentError(f"the DBC has no message '{message_name}'{similar}")
        return self._layouts[message_name]


class _Layout:
    """Bit fields of one message."""

    def __init__(self, message: Message) -> None:
        extended = EXTENDED_ID if message.is_extended_frame else 0
        self.arbitration_id = message.frame_id | extended
        self.length = message.length
        self.fields = {signal.name: BitField(signal) for signal in message.signals}

    def physical(self, name: str, words: Payloads) -> FloatArray:
        values = self.fields[name].physical(words)
        if self.fields[name].signal.multiplexer_ids is None:
            return values
        return np.where(self.selected(name, words), values, np.nan)

    def selected(self, name: str, words: Payloads) -> BoolArray:
        """Mask of the payloads whose multiplexers select the signal."""
        return self._is_selected(name, lambda selector: self.fields[selector].raw(words))

    @property
    def page_mask(self) -> np.uint64:
        """Bits of the multiplexers in the payload as a little-endian number; 0 without multiplexers."""
        little, big = np.zeros(1, "<u8"), np.zeros(1, ">u8")
        for field in self.fields.values():
            if field.signal.is_multiplexer:
                bits = (np.uint64(2**_WORD_BITS - 1) << field.right_shift) >> field.left_shift
                words = big if field.big_endian else little
                words |= bits
        return np.uint64((little.view("<u8") | big.view("<u8"))[0])

    def is_selected_by(self, name: str, data: bytes) -> bool:
        """Whether the multiplexers in the payload select the signal."""
        return bool(self._is_selected(name, lambda selector: self.fields[selector].raw_from_payload(data)))

    def encode(self, values: dict[str, FloatArray]) -> NDArray[np.uint8]:
        """Encode values of n frames by signal name; see :meth:`DbcCodec.encode`."""
        count = len(next(iter(values.values()), np.zeros(1)))
        raw = {
            name: field.to_raw(values[name]) if name in values else np.zeros(count, np.uint64)
            for name, field in self.fields.items()
        }
        little, big = np.zeros(count, "<u8"), np.zeros(count, ">u8")
        for name, field in self.fields.items():
            bits = (raw[name] << field.right_shift) >> field.left_shift
            bits = np.where(self._is_selected(name, raw.__getitem__), bits, np.uint64(0))
            if field.big_endian:
                big |= bits
            else:
                little |= bits
        payloads = little.view(np.uint8) | big.view(np.uint8)
        return payloads.reshape(count, MAX_LENGTH)[:, : self.length]

    def _is_selected(self, name: str, raw_of: Callable[[str], ArrayLike]) -> BoolArray:
        """Mask of the frames whose multiplexers, with raw values ``raw_of(name)``, select the signal."""
        signal = self.fields[name].signal
        selector = signal.multiplexer_signal
        if signal.multiplexer_ids is None or selector is None:
            return np.array(True)
        return np.isin(raw_of(selector), signal.multiplexer_ids) & self._is_selected(selector, raw_of)


def _similar_names(name: str, names: list[str]) -> str:
    close = difflib.get_close_matches(name.upper(), names, n=3, cutoff=0.5)
    return f" (did you mean {' or '.join(close)}?)" if close else f"; it has {', '.join(names)}"


Words = NDArray[np.uint64]

_WORD_BITS = 64
#: Types of floating-point signals by their numbers of bits.
_FLOATS: dict[int, tuple[type[np.unsignedinteger[Any]], type[np.floating[Any]]]] = {
    16: (np.uint16, np.float16),
    32: (np.uint32, np.float32),
    64: (np.uint64, np.float64),
}


class Payloads:
    """Payloads of n frames, shape (n, 8), as 64-bit numbers in both byte orders."""

    def __init__(self, data: NDArray[np.uint8]) -> None:
        self._data = data

    @cached_property
    def little(self) -> Words:
        """Payloads as little-endian numbers, shape (n,)."""
        return self._data.view("<u8")[:, 0].astype(np.uint64)

    @cached_property
    def big(self) -> Words:
        """Payloads as big-endian numbers, shape (n,)."""
        return self._data.view(">u8")[:, 0].astype(np.uint64)


@dataclass(frozen=True)
class BitField:
    """The bits of one signal of up to 64 bits."""

    signal: Signal

    @cached_property
    def big_endian(self) -> bool:
        """Whether the signal is big-endian."""
        return self.signal.byte_order == "big_endian"

    @cached_property
    def left_shift(self) -> np.uint64:
        """Shift that moves the field's first bit to the top of the word."""
        start, length = self.signal.start, self.signal.length
        if self.big_endian:
            return np.uint64(8 * (start // 8) + 7 - start % 8)
        return np.uint64(_WORD_BITS - start - length)

    @cached_property
    def right_shift(self) -> np.uint64:
        """Shift that then moves the field's last bit to the bottom."""
        return np.uint64(_WORD_BITS - self.signal.length)

    def raw(self, words: Payloads) -> NDArray[Any]:
        """Extract raw values, shape (n,): int64, uint64 or the signal's float type."""
        at_top = (words.big if self.big_endian else words.little) << self.left_shift
        if self.signal.conversion.is_float:
            bits_type, float_type = _FLOATS[self.signal.length]
            return (at_top >> self.right_shift).astype(bits_type).view(float_type)
        if self.signal.is_signed:
            return at_top.view(np.int64) >> self.right_shift.astype(np.int64)
        return at_top >> self.right_shift

    def physical(self, words: Payloads) -> FloatArray:
        """Extract values in the DBC's unit, shape (n,)."""
        values = self.raw(words).astype(np.float64)
        if self.signal.scale != 1:
            values *= self.signal.scale
        if self.signal.offset != 0:
            values += self.signal.offset
        return values

    @cached_property
    def raw_from_payload(self) -> Callable[[bytes], float]:
        """Function that extracts the raw value of one payload; see :meth:`raw`."""
        signal, shift = self.signal, int(self.right_shift) - int(self.left_shift)
        order: Literal["little", "big"] = "big" if self.big_endian else "little"
        mask, sign = (1 << signal.length) - 1, 1 << signal.length - 1 if signal.is_signed else 0

        def read_integer(data: bytes) -> int:
            raw = int.from_bytes(data.ljust(MAX_LENGTH, b"\0"), order) >> shift & mask
            return raw - 2 * (raw & sign)

        if signal.conversion.is_float:
            bits_type, float_type = _FLOATS[signal.length]
            return lambda data: float(bits_type(read_integer(data) & mask).view(float_type))
        return read_integer

    def to_raw(self, values: FloatArray) -> Words:
        """Convert values in the DBC's unit to right-aligned bits; see :meth:`DbcCodec.encode`."""
        scaled = (values - self.signal.offset) / self.signal.scale
        length = self.signal.length
        if self.signal.conversion.is_float:
            bits_type, float_type = _FLOATS[length]
            with np.errstate(over="ignore"):
                return scaled.astype(float_type).view(bits_type).astype(np.uint64)
        if np.any(np.isnan(scaled)):
            raise MeasurementError(f"the integer signal {self.signal.name} can't carry NaN")
        return _rounded(scaled, length, self.signal.is_signed) & np.uint64(2**length - 1)


def _rounded(values: FloatArray, length: int, signed: bool) -> Words:
    low, high = (-(2 ** (length - 1)), 2 ** (length - 1) - 1) if signed else (0, 2**length - 1)
    # As float64, 2**63 - 1 and 2**64 - 1 round up to numbers that do not fit.
    clipped = np.clip(np.rint(values), low, np.nextafter(float(high + 1), 0.0))
    integers = clipped.astype(np.int64).view(np.uint64) if signed else clipped.astype(np.uint64)
    return np.where(values >= high, np.uint64(high), integers)


#: Length of the longest message of SAE J1939; DBC files describe it as a single message.
_MAX_MESSAGE_BYTES = 1785
#: Far above any device's file; the parser's time grows with the squares of these numbers.
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


def _find_oversized(text: str) -> Iterator[str]:
    """Find sizes and counts that no CAN device has and that would exhaust the parser, with their lines."""
    for number, line in enumerate(text.splitlines(), start=1):
        if len(line) > _MAX_LINE_CHARACTERS:
            yield f"line {number}: a line of {len(line)} characters"
            return
    message_starts = [match.start() for match in _MESSAGE_START.finditer(text)]
    for begin, end in pairwise([0, *message_starts, len(text)]):
        count = len(_SIGNAL_START.findall(text, begin, end))
        if count > _MAX_SIGNALS:
            yield f"line {text.count(chr(10), 0, begin) + 1}: a message of {count} signals"
            return
    for match in _MESSAGE.finditer(text):
        if int(match["bytes"]) > _MAX_MESSAGE_BYTES:
            yield f"line {_line(text, match)}: a message of {match['bytes']} bytes"
    for match in _SIGNAL.finditer(text):
        if max(int(match["start"]), int(match["length"])) > 8 * _MAX_MESSAGE_BYTES:
            yield f"line {_line(text, match)}: a signal of {match['length']} bits at bit {match['start']}"
    count = 0
    for match in _MULTIPLEXER.finditer(text):
        count += sum(int(last) - int(first) + 1 for first, last in _RANGE.findall(match[0]))
        if count > _MAX_MULTIPLEXER_IDS:
            yield f"line {_line(text, match)}: {count} multiplexer values up to here"
            return


def _find_undecodable(database: Database) -> Iterator[str]:
    """Find duplicate messages, and signals of classic CAN messages whose values can't be computed."""
    identifiers = [
        f"{each.frame_id}{' with 29 bits' if each.is_extended_frame else ''}" for each in database.messages
    ]
    for kind, keys in (
        ("message called", [message.name for message in database.messages]),
        ("message numbered", identifiers),
    ):
        duplicates = [each for each, count in Counter(keys).items() if count > 1]
        yield from (f"a second {kind} {each}" for each in duplicates)
    for message in database.messages:
        for signal in message.signals if message.length <= MAX_LENGTH else ():
            name = f"{message.name}.{signal.name}"
            if signal.conversion.is_float and signal.length not in _FLOATS:
                yield f"{name}: a floating-point number of {signal.length} bits"
            if signal.scale == 0 or not math.isfinite(signal.scale) or not math.isfinite(signal.offset):
                yield f"{name}: scale {signal.scale} and offset {signal.offset}"


def _line(text: str, match: re.Match[str]) -> int:
    return text.count("\n", 0, match.start()) + 1
