"""Signals of CAN payloads as bit fields, read and written in bulk.

Each signal is one shift of the whole payload, taken as a 64-bit number, to the left and one back
to the right; that drops the neighbours and, done on signed numbers, extends the sign.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from cantools.database.can import Signal
from numpy.typing import NDArray

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import MeasurementError

Words = NDArray[np.uint64]

_WORD_BITS = 64
_FLOATS: dict[int, tuple[type[np.unsignedinteger[Any]], type[np.floating[Any]]]] = {
    16: (np.uint16, np.float16),
    32: (np.uint32, np.float32),
    64: (np.uint64, np.float64),
}

#: Bits that a floating-point signal may have.
FLOAT_LENGTHS = frozenset(_FLOATS)


class Payloads:
    """Payloads, shape (n, 8), as 64-bit numbers in both byte orders."""

    def __init__(self, data: NDArray[np.uint8]) -> None:
        self._data = np.ascontiguousarray(data)

    @cached_property
    def little(self) -> Words:
        """Numbers whose first byte is the lowest, shape (n,)."""
        return self._data.view("<u8")[:, 0].astype(np.uint64, copy=False)

    @cached_property
    def big(self) -> Words:
        """Numbers whose first byte is the highest, shape (n,)."""
        return self._data.view(">u8")[:, 0].astype(np.uint64)


@dataclass(frozen=True)
class BitField:
    """The bits of one signal of up to 64 bits."""

    signal: Signal

    @cached_property
    def big_endian(self) -> bool:
        """Whether the field is in the words' big-endian reading."""
        return self.signal.byte_order == "big_endian"

    @cached_property
    def left(self) -> np.uint64:
        """Shift that moves the field's first bit to the top of the word."""
        start, length = self.signal.start, self.signal.length
        if self.big_endian:
            return np.uint64(8 * (start // 8) + 7 - start % 8)
        return np.uint64(_WORD_BITS - start - length)

    @cached_property
    def right(self) -> np.uint64:
        """Shift that then moves the field's last bit to the bottom."""
        return np.uint64(_WORD_BITS - self.signal.length)

    def raw(self, words: Payloads) -> NDArray[Any]:
        """Read the field: int64, uint64 or the signal's float type."""
        at_top = (words.big if self.big_endian else words.little) << self.left
        if self.signal.conversion.is_float:
            bits_type, float_type = _FLOATS[self.signal.length]
            return (at_top >> self.right).astype(bits_type).view(float_type)
        if self.signal.is_signed:
            return at_top.view(np.int64) >> self.right.astype(np.int64)
        return at_top >> self.right

    def physical(self, words: Payloads) -> FloatArray:
        """Read the field, scaled to the DBC's unit."""
        values = self.raw(words).astype(np.float64)
        if self.signal.scale != 1:
            values *= self.signal.scale
        if self.signal.offset != 0:
            values += self.signal.offset
        return values

    def to_raw(self, values: FloatArray) -> Words:
        """Turn values in the DBC's unit into the field's bits, right-aligned.

        Integers are rounded to the nearest step and limited to what the field can hold.

        Raises
        ------
        MeasurementError
            A value for an integer field is not a number.
        """
        scaled = (values - self.signal.offset) / self.signal.scale
        length = self.signal.length
        if self.signal.conversion.is_float:
            bits_type, float_type = _FLOATS[length]
            with np.errstate(over="ignore"):
                return scaled.astype(float_type).view(bits_type).astype(np.uint64)
        if np.any(np.isnan(scaled)):
            raise MeasurementError(f"the signal {self.signal.name} can't carry a value that is not a number")
        return _rounded(scaled, length, self.signal.is_signed) & np.uint64(2**length - 1)

    def placed(self, raw: Words) -> Words:
        """Move right-aligned bits to where they belong in a word."""
        return (raw << self.right) >> self.left


def _rounded(values: FloatArray, length: int, signed: bool) -> Words:
    low, high = (-(2 ** (length - 1)), 2 ** (length - 1) - 1) if signed else (0, 2**length - 1)
    # 2**63 - 1 and 2**64 - 1 round up as float64, to a number that no longer fits.
    inside = np.clip(np.rint(values), low, np.nextafter(float(high + 1), 0.0))
    integers = inside.astype(np.int64).view(np.uint64) if signed else inside.astype(np.uint64)
    return np.where(values >= high, np.uint64(high), integers)
