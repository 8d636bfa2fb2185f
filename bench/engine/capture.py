"""What is kept of a dwell under way."""

from __future__ import annotations

from dataclasses import dataclass, field

import can

from gyrobench.bench.navigation.table_axes import Angles
from gyrobench.drivers.ins.can_bus import FrameBlock, concatenate

_FRAMES_PER_BLOCK = 2000


@dataclass
class Capture:
    """Frames, chamber temperatures and table angles since an alignment began."""

    log_part: int
    chamber_c: list[float] = field(default_factory=list)
    table_deg: list[Angles] = field(default_factory=list)
    _blocks: list[FrameBlock] = field(default_factory=list)
    _messages: list[can.Message] = field(default_factory=list)

    def add(self, messages: list[can.Message]) -> None:
        """Keep frames; as arrays, since a dwell has tens of thousands of them."""
        self._messages += messages
        if len(self._messages) >= _FRAMES_PER_BLOCK:
            self._pack()

    def count(self) -> int:
        """Number of data frames so far."""
        self._pack()
        return sum(map(len, self._blocks))

    def frames(self, first: int = 0) -> FrameBlock:
        """Data frames so far, from a number on."""
        self._pack()
        blocks, start = self._blocks, 0
        while blocks and start + len(blocks[0]) <= first:
            start += len(blocks[0])
            blocks = blocks[1:]
        return concatenate(blocks).take(slice(first - start, None))

    def _pack(self) -> None:
        if self._messages:
            self._blocks.append(FrameBlock.from_messages(self._messages))
            self._messages = []
