"""CAN frames in blocks: one structured array for many frames."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import can
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gyrobench.bench.foundations.arrays import BoolArray, FloatArray, IntArray

#: Flag of a 29-bit identifier, as in SocketCAN and in DBC files.
EXTENDED_ID = 0x8000_0000

#: Bytes of data in a classic CAN frame.
MAX_LENGTH = 8

#: Bits of ``flags``.
REMOTE_FRAME, ERROR_FRAME = 1, 2

#: One frame of 24 bytes; the data are aligned so that they can be read as a 64-bit number.
FRAME_DTYPE = np.dtype(
    {
        "names": ["time_s", "id", "length", "flags", "data"],
        "formats": ["f8", "u4", "u1", "u1", ("u1", (MAX_LENGTH,))],
        "offsets": [0, 8, 12, 13, 16],
        "itemsize": 24,
    },
    align=True,
)


#: The same size without fields; numpy copies it much faster.
_OPAQUE = np.dtype((np.void, FRAME_DTYPE.itemsize))


class FrameBlock:
    """Frames in order of arrival; the properties are views of ``rows``.

    ``rows``: shape (n,), of :data:`FRAME_DTYPE`. There are no CAN FD frames: no INS that the bench supports
    sends them, and their 64 bytes would need a second layout.
    """

    __slots__ = ("_ids", "_only_data", "rows")

    def __init__(self, rows: NDArray[np.void], only_data: bool = False) -> None:
        self.rows = rows
        self._only_data = only_data  # False if it has not been checked
        # Contiguous copy of the identifiers, made when first used.
        self._ids: NDArray[np.uint32] | None = None

    @classmethod
    def from_columns(
        cls,
        timestamp_s: ArrayLike,
        arbitration_id: ArrayLike,
        length: ArrayLike,
        data: ArrayLike,
        flags: ArrayLike = 0,
    ) -> FrameBlock:
        """Make a block from columns in the shapes of the properties of the same names."""
        rows = np.zeros(np.shape(timestamp_s), FRAME_DTYPE)
        rows["time_s"], rows["id"], rows["length"] = timestamp_s, arbitration_id, length
        rows["data"], rows["flags"] = data, flags
        return cls(rows)

    @classmethod
    def from_messages(cls, messages: Sequence[can.Message]) -> FrameBlock:
        """Make a block from python-can messages; drops those of CAN FD or with more than 8 bytes."""
        messages = [m for m in messages if not (m.is_fd or m.dlc > MAX_LENGTH or len(m.data) > MAX_LENGTH)]
        # One list comprehension for each attribute is the fastest way to read Message objects.
        identifiers = np.array([m.arbitration_id for m in messages], np.uint32)
        extended = np.array([m.is_extended_id for m in messages], np.bool_)
        remote = np.array([m.is_remote_frame for m in messages], np.uint8)
        error = np.array([m.is_error_frame for m in messages], np.uint8)
        return cls.from_columns(
            timestamp_s=np.array([m.timestamp for m in messages], np.float64),
            arbitration_id=np.where(extended, identifiers | np.uint32(EXTENDED_ID), identifiers),
            length=np.array([m.dlc for m in messages], np.uint8),
            data=np.frombuffer(
                b"".join([m.data.ljust(MAX_LENGTH, b"\0") for m in messages]), np.uint8
            ).reshape(-1, MAX_LENGTH),
            flags=REMOTE_FRAME * remote | ERROR_FRAME * error,
        )

    @property
    def timestamp_s(self) -> FloatArray:
        """Time stamps of the CAN interface, shape (n,)."""
        return self.rows["time_s"]

    @property
    def arbitration_id(self) -> NDArray[np.uint32]:
        """Identifiers, shape (n,), with :data:`EXTENDED_ID` set if they have 29 bits."""
        return self.rows["id"]

    @property
    def length(self) -> NDArray[np.uint8]:
        """Numbers of data bytes, shape (n,), 0 to 8; of a remote frame, the number that it requests."""
        return self.rows["length"]

    @property
    def flags(self) -> NDArray[np.uint8]:
        """Kinds, shape (n,): :data:`REMOTE_FRAME`, :data:`ERROR_FRAME`, or 0 for data frames."""
        return self.rows["flags"]

    @property
    def data(self) -> NDArray[np.uint8]:
        """Data bytes, shape (n, 8), zero beyond the length."""
        return self.rows["data"]

    def __len__(self) -> int:
        return len(self.rows)

    def take(self, rows: IntArray | BoolArray | slice) -> FrameBlock:
        """Select frames by a numpy index."""
        if isinstance(rows, slice):
            return FrameBlock(self.rows[rows], self._only_data)
        frames = self.rows.view(_OPAQUE)
        selected = frames.compress(rows) if np.asarray(rows).dtype == np.bool_ else frames.take(rows)
        return FrameBlock(selected.view(FRAME_DTYPE))

    def in_order(self) -> FrameBlock:
        """Sort by the time stamps; frames with the same one stay in order."""
        return self.take(np.argsort(self.timestamp_s, kind="stable"))

    def rows_with_id(self, arbitration_id: int) -> IntArray:
        """Indices of the frames of one identifier, with :data:`EXTENDED_ID` set if it has 29 bits."""
        if self._ids is None:
            self._ids = np.ascontiguousarray(self.rows["id"])
        return np.flatnonzero(self._ids == arbitration_id)

    def with_id(self, arbitration_id: int) -> FrameBlock:
        """Select the frames of one identifier, with :data:`EXTENDED_ID` set if it has 29 bits."""
        return self.take(self.rows_with_id(arbitration_id))

    def with_fields(self, **values: ArrayLike) -> FrameBlock:
        """Return a copy with new values of some fields of :data:`FRAME_DTYPE`."""
        rows = self.rows.copy()
        for name, column in values.items():
            rows[name] = column
        return FrameBlock(rows)

    def matching(self, filters: Iterable[can.typechecking.CanFilter]) -> FrameBlock:
        """Select the frames that pass one of python-can's filters."""
        identifiers, passes = self.arbitration_id, np.zeros(len(self), np.bool_)
        for each in filters:
            matches = (identifiers & np.uint32(EXTENDED_ID - 1) ^ each["can_id"]) & each["can_mask"] == 0
            if "extended" in each:
                matches &= (identifiers & np.uint32(EXTENDED_ID) != 0) == each["extended"]
            passes |= matches
        return self.take(passes)

    def data_frames(self) -> FrameBlock:
        """Return the block without remote and error frames; the block itself if it has none."""
        if self._only_data:
            return self
        flags = self.rows["flags"]
        if flags.tobytes().strip(b"\0"):
            return FrameBlock(self.take(flags == 0).rows, only_data=True)
        self._only_data = True
        return self

    def messages(self) -> list[can.Message]:
        """Make a python-can message of each frame."""
        return [
            can.Message(
                timestamp=time_s,
                arbitration_id=identifier & ~EXTENDED_ID,
                is_extended_id=bool(identifier & EXTENDED_ID),
                dlc=length,
                data=None if flags & REMOTE_FRAME else data[:length],
                is_remote_frame=bool(flags & REMOTE_FRAME),
                is_error_frame=bool(flags & ERROR_FRAME),
            )
            for (time_s, identifier, length, flags, _), data in zip(
                self.rows.tolist(), map(bytes, self.data), strict=True
            )
        ]


def concatenate(blocks: Sequence[FrameBlock]) -> FrameBlock:
    """Join blocks in the order given; without blocks, an empty block."""
    if not blocks:
        return FrameBlock(np.empty(0, FRAME_DTYPE))
    if len(blocks) == 1:
        return blocks[0]
    rows = np.concatenate([block.rows.view(_OPAQUE) for block in blocks]).view(FRAME_DTYPE)
    return FrameBlock(rows, all(block._only_data for block in blocks))  # noqa: SLF001
