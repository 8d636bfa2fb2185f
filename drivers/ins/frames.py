"""CAN frames in bulk, as numpy arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import can
import numpy as np
from numpy.typing import NDArray

from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray

#: Set in an identifier of 29 bits, as in SocketCAN and in DBC files.
EXTENDED_ID = 0x8000_0000

#: Bytes of data in a classic CAN frame.
MAX_LENGTH = 8


@dataclass(frozen=True, eq=False)
class FrameBlock:
    """Data frames in the order of their arrival.

    Attributes
    ----------
    timestamp_s : ndarray of float64, shape (n,)
        Time of arrival as the CAN interface stamped it.
    arbitration_id : ndarray of uint32, shape (n,)
        Identifier; those of 29 bits have :data:`EXTENDED_ID` set.
    length : ndarray of uint8, shape (n,)
        Number of data bytes, 0 to 8.
    data : ndarray of uint8, shape (n, 8)
        Data bytes, zero beyond the length.
    """

    timestamp_s: FloatArray
    arbitration_id: NDArray[np.uint32]
    length: NDArray[np.uint8]
    data: NDArray[np.uint8]

    @classmethod
    def from_messages(cls, messages: Sequence[can.Message]) -> FrameBlock:
        """Collect python-can messages; error, remote and FD frames are left out."""
        # Read attribute by attribute: list comprehensions are the fastest way through Message objects.
        messages = [m for m in messages if not (m.is_error_frame or m.is_remote_frame or m.is_fd)]
        payloads = [m.data for m in messages]
        lengths = np.array([len(payload) for payload in payloads], np.int64)
        if np.any(lengths > MAX_LENGTH):
            return cls.from_messages([m for m in messages if len(m.data) <= MAX_LENGTH])
        if np.any(lengths < MAX_LENGTH):
            payloads = [payload.ljust(MAX_LENGTH, b"\0") for payload in payloads]
        identifiers = np.array([m.arbitration_id for m in messages], np.uint32)
        extended = np.array([m.is_extended_id for m in messages], np.bool_)
        return cls(
            timestamp_s=np.array([m.timestamp for m in messages], np.float64),
            arbitration_id=np.where(extended, identifiers | np.uint32(EXTENDED_ID), identifiers),
            length=lengths.astype(np.uint8),
            data=np.frombuffer(b"".join(payloads), np.uint8).reshape(-1, MAX_LENGTH),
        )

    def __len__(self) -> int:
        return len(self.timestamp_s)

    def take(self, rows: IntArray | BoolArray | slice) -> FrameBlock:
        """Select frames by a numpy index."""
        return FrameBlock(
            self.timestamp_s[rows], self.arbitration_id[rows], self.length[rows], self.data[rows]
        )

    def with_id(self, arbitration_id: int) -> FrameBlock:
        """Select the frames of one identifier (with :data:`EXTENDED_ID` for one of 29 bits)."""
        return self.take(self.arbitration_id == arbitration_id)


def concatenate(blocks: Sequence[FrameBlock]) -> FrameBlock:
    """Join blocks in the order given; none make an empty block."""
    if not blocks:
        return FrameBlock.from_messages([])
    return FrameBlock(
        np.concatenate([block.timestamp_s for block in blocks]),
        np.concatenate([block.arbitration_id for block in blocks]),
        np.concatenate([block.length for block in blocks]),
        np.concatenate([block.data for block in blocks]),
    )
