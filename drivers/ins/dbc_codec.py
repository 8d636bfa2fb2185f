"""CAN payloads decoded and encoded in bulk, as a DBC file lays them out.

cantools reads the file; its own decoding, frame by frame, is the reference that the bulk decoding
equals.
"""

from __future__ import annotations

import difflib
import logging
from collections.abc import Callable, Iterable, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import textparser
from cantools.database import Database
from cantools.database.can import Message, Signal
from numpy.typing import ArrayLike, NDArray

from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.files import read_limited
from gyrobench.drivers.ins.bit_fields import BitField, Payloads
from gyrobench.drivers.ins.dbc_checks import oversized, undecodable
from gyrobench.drivers.ins.frames import EXTENDED_ID, MAX_LENGTH, FrameBlock

MAX_DBC_BYTES = 2_000_000

# It warns of messages of the same name or number, which are refused here.
logging.getLogger("cantools").setLevel(logging.ERROR)
_SHOWN_MISTAKES = 20

#: What cantools is known to raise for a file that is wrong; it has no single error for that.
_DBC_ERRORS = (
    cantools.Error,
    textparser.Error,
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    ArithmeticError,
    RecursionError,
)


def load_dbc(path: Path) -> Database:
    """Read a DBC file in UTF-8 or Windows-1252.

    Raises
    ------
    DocumentError
        The file can't be read, is too large, or is no valid DBC.
    """
    content = read_limited(path, MAX_DBC_BYTES, DocumentError)
    database = Database()
    try:
        text = _text(content)
        _refuse(path, oversized(text))
        database.add_dbc_string(text)
    except DocumentError:
        raise
    except _DBC_ERRORS as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DocumentError(f"{path}: not a valid DBC file: {reason}") from error
    _refuse(path, undecodable(database))
    return database


def _text(content: bytes) -> str:
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252")


def _refuse(path: Path, mistakes: Iterable[str]) -> None:
    lines = [f"{path}: {mistake} is not possible" for mistake in islice(mistakes, _SHOWN_MISTAKES)]
    if lines:
        raise DocumentError("\n".join(lines))


class DbcCodec:
    """Bulk decoding and encoding of the messages of one DBC file.

    Messages longer than a classic CAN frame are unknown to it.
    """

    def __init__(self, database: Database) -> None:
        self.database = database
        self._layouts = {
            message.name: _Layout(message) for message in database.messages if message.length <= MAX_LENGTH
        }

    @property
    def message_names(self) -> list[str]:
        """Names of the messages that can be decoded."""
        return list(self._layouts)

    def arbitration_id(self, message_name: str) -> int:
        """Find the identifier of a message, with :data:`EXTENDED_ID` for one of 29 bits."""
        return self._layout(message_name).arbitration_id

    def signal(self, message_name: str, signal_name: str) -> Signal:
        """Find the description of a signal.

        Raises
        ------
        DocumentError
            There is no such message or signal; the message names those that look alike.
        """
        layout = self._layout(message_name)
        if signal_name not in layout.fields:
            known = _suggestion(signal_name, list(layout.fields))
            raise DocumentError(f"the message {message_name} of the DBC has no signal '{signal_name}'{known}")
        return layout.fields[signal_name].signal

    def select(self, block: FrameBlock, message_name: str) -> FrameBlock:
        """Those frames that :meth:`decode` decodes, in order."""
        return block.take(self.rows(block, message_name))

    def rows(self, block: FrameBlock, message_name: str) -> IntArray:
        """Where in the block the frames of a message stand; ones that are too short are left out."""
        layout = self._layout(message_name)
        found = np.flatnonzero(block.arbitration_id == layout.arbitration_id)
        return found[block.length[found] >= layout.length]

    def count_short(self, block: FrameBlock, message_name: str) -> int:
        """Count the frames of a message with fewer bytes than its DBC says."""
        layout = self._layout(message_name)
        return int(np.sum(block.length[block.arbitration_id == layout.arbitration_id] < layout.length))

    def decode(self, block: FrameBlock, message_name: str) -> dict[str, FloatArray]:
        """Values of every signal of a message, in the DBC's units, one for each selected frame.

        NaN where a multiplexed signal is not in the frame. Integers of more than 53 bits are
        rounded to float64.
        """
        layout = self._layout(message_name)
        data = block.data[self.rows(block, message_name)]
        words = Payloads(data)
        return {name: layout.physical(name, words) for name in layout.fields}

    def decode_one(self, data: bytes | bytearray, message_name: str) -> dict[str, float]:
        """Decode one payload to the same values, without the cost of arrays.

        Signals that are not in it are left out; all are if it is too short.
        """
        message = self._layout(message_name).message
        try:
            values = message.decode(bytes(data[: message.length]), decode_choices=False)
        except cantools.Error:
            return {}
        assert isinstance(values, dict)  # noqa: S101 - container messages are not in a DBC
        return {name: float(value) for name, value in values.items() if isinstance(value, int | float)}

    def decode_raw(self, block: FrameBlock, message_name: str) -> dict[str, NDArray[Any]]:
        """As :meth:`decode` without scale and offset: int64, uint64 or the DBC's float type.

        A multiplexed signal that is not in the frame has whatever the bits there say.
        """
        layout = self._layout(message_name)
        words = Payloads(block.data[self.rows(block, message_name)])
        return {name: field.raw(words) for name, field in layout.fields.items()}

    def encode(self, message_name: str, values: Mapping[str, ArrayLike]) -> NDArray[np.uint8]:
        """Payloads of a message, shape (n, length of the message).

        Values are rounded to the nearest step and limited to what the field can hold. Signals
        that are not given are zero, as are those that the multiplexer leaves out.

        Parameters
        ----------
        message_name : str
            Message of the DBC.
        values : mapping of str to array_like, each of shape (n,) or ()
            Physical values in the DBC's units.

        Raises
        ------
        DocumentError
            There is no such message or signal.
        MeasurementError
            A value for an integer field is not a number.
        """
        layout = self._layout(message_name)
        for name in values:
            self.signal(message_name, name)
        arrays = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, np.float64)) for v in values.values()))
        return layout.encode(dict(zip(values, arrays, strict=True)))

    def _layout(self, message_name: str) -> _Layout:
        if message_name not in self._layouts:
            known = _suggestion(message_name, list(self._layouts))
            raise DocumentError(f"the DBC has no message '{message_name}'{known}")
        return self._layouts[message_name]


class _Layout:
    """Where the signals of one message are."""

    def __init__(self, message: Message) -> None:
        extended = EXTENDED_ID if message.is_extended_frame else 0
        self.message = message
        self.arbitration_id = message.frame_id | extended
        self.length = message.length
        self.fields = {signal.name: BitField(signal) for signal in message.signals}

    def physical(self, name: str, words: Payloads) -> FloatArray:
        values = self.fields[name].physical(words)
        if self.fields[name].signal.multiplexer_ids is None:
            return values
        return np.where(
            self._present(name, lambda selector: self.fields[selector].raw(words)), values, np.nan
        )

    def encode(self, values: dict[str, FloatArray]) -> NDArray[np.uint8]:
        count = len(next(iter(values.values()), np.zeros(1)))
        raw = {
            name: field.to_raw(values[name]) if name in values else np.zeros(count, np.uint64)
            for name, field in self.fields.items()
        }
        little, big = np.zeros(count, "<u8"), np.zeros(count, ">u8")
        for name, field in self.fields.items():
            bits = np.where(self._present(name, raw.__getitem__), field.placed(raw[name]), np.uint64(0))
            if field.big_endian:
                big |= bits
            else:
                little |= bits
        payloads = little.view(np.uint8) | big.view(np.uint8)
        return payloads.reshape(count, MAX_LENGTH)[:, : self.length]

    def _present(self, name: str, raw_of: Callable[[str], NDArray[Any]]) -> BoolArray:
        """Whether the multiplexer, and the one above it, select the signal."""
        signal = self.fields[name].signal
        selector = signal.multiplexer_signal
        if signal.multiplexer_ids is None or selector is None:
            return np.array(True)
        return np.isin(raw_of(selector), signal.multiplexer_ids) & self._present(selector, raw_of)


def _suggestion(name: str, known: list[str]) -> str:
    close = difflib.get_close_matches(name.upper(), known, n=3, cutoff=0.5)
    return f" (did you mean {' or '.join(close)}?)" if close else f"; it has {', '.join(known)}"
