"""Standard normal numbers: the same sequence as numpy's generators, in a third of the time.

numpy calls the bit generator through a pointer for each number. Here its output is fetched in blocks, and a
kernel converts it to normal numbers as numpy does: by the ziggurat method of Marsaglia and Tsang, J. Stat.
Softw. 5-8 (2000), with 256 strips.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.kernels import compiled

#: Start of the tail, and area of each strip.
_TAIL, _AREA = 3.6541528853610087963519472518, 0.00492867323397465493159
#: Number of bits for the position within a strip, and size of the blocks that are fetched.
_BITS, _BLOCK = 52, 8192


class NormalNumbers:
    """The sequence of ``np.random.default_rng(seed)`` if only normal numbers are numbers."""

    def __init__(self, seed: Sequence[int]) -> None:
        self._bits = np.random.PCG64(seed)
        self._block: NDArray[np.uint64] = np.empty(0, np.uint64)
        self._used = 0

    def standard_normal(self, shape: int | tuple[int, ...]) -> FloatArray:
        """Draw the next numbers."""
        numbers = np.empty(shape)
        flat = numbers.reshape(-1)
        count, self._used = _draw(flat, 0, self._block, self._used, _LIMITS, _WIDTHS, _HEIGHTS)
        while count < flat.size:
            self._block = np.concatenate([self._block[self._used :], self._bits.random_raw(_BLOCK)])
            count, self._used = _draw(flat, count, self._block, 0, _LIMITS, _WIDTHS, _HEIGHTS)
        return numbers


def _strips() -> tuple[NDArray[np.uint64], FloatArray, FloatArray]:
    """For each strip: largest integer below the curve, width of one integer step, and height of the curve."""
    limits, widths, heights = np.zeros(256, np.uint64), np.empty(256), np.empty(256)
    edge, height = _TAIL, math.exp(-0.5 * _TAIL * _TAIL)
    limits[0] = int(edge / (_AREA / height) * 2**_BITS)
    widths[0], widths[255] = _AREA / height / 2**_BITS, edge / 2**_BITS
    heights[0], heights[255] = 1.0, height
    for strip in range(254, 0, -1):
        outer, height = edge, _AREA / edge + height
        edge = math.sqrt(-2.0 * math.log(height))
        limits[strip + 1] = int(edge / outer * 2**_BITS)
        widths[strip], heights[strip] = edge / 2**_BITS, height
    return limits, widths, heights


_LIMITS, _WIDTHS, _HEIGHTS = _strips()


@compiled
def _draw(
    numbers: FloatArray, count: int, bits: NDArray[np.uint64], used: int, limits: NDArray[np.uint64],
    widths: FloatArray, heights: FloatArray,
) -> tuple[int, int]:  # fmt: skip
    """Fill ``numbers`` from index ``count`` on until all ``bits`` are used; returns both new indices."""
    while count < numbers.size and used < bits.size:
        number = bits[used]
        used += 1
        strip = np.int64(number & np.uint64(255))
        within = (number >> np.uint64(9)) & np.uint64(0x000FFFFFFFFFFFFF)
        value = np.float64(np.int64(within)) * widths[strip]
        if number & np.uint64(256):
            value = -value
        if within >= limits[strip]:
            first = used - 1
            if strip == 0:
                is_accepted = False
                while not is_accepted and used + 2 <= bits.size:
                    beyond = -math.log1p(-_uniform(bits[used])) / _TAIL
                    height = -math.log1p(-_uniform(bits[used + 1]))
                    used += 2
                    is_accepted = height + height > beyond * beyond
                    value = -(_TAIL + beyond) if (within >> np.uint64(8)) & np.uint64(1) else _TAIL + beyond
                if not is_accepted:
                    return count, first
            else:
                if used == bits.size:
                    return count, first
                height = heights[strip] + (heights[strip - 1] - heights[strip]) * _uniform(bits[used])
                used += 1
                if height >= math.exp(-0.5 * value * value):
                    continue
        numbers[count] = value
        count += 1
    return count, used


@compiled
def _uniform(bits: np.uint64) -> float:
    """Convert to a number from 0 to 1."""
    return np.float64(np.int64(bits >> np.uint64(11))) * 2.0**-53
