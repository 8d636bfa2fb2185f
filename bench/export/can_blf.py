"""The raw CAN log as one BLF file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import can

from gyrobench.bench.export.placed_parts import PlacedPart


def write_blf(path: Path, parts: Iterable[PlacedPart]) -> int:
    """Write all frames, with calendar times; returns how many."""
    with path.open("wb") as stream, can.BLFWriter(stream) as writer:
        for part in parts:
            for message in part.messages:
                writer.on_message_received(message)
        return int(writer.object_count)
