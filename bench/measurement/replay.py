"""Measuring a run anew from its raw CAN log."""

from __future__ import annotations

from collections.abc import Iterator

from bench.bias.dwell_table import DwellRow
from bench.measurement.dwell import MeasurementSetup, measure_dwell
from bench.measurement.marks import DwellMarks
from bench.run_store.can_log import read_can_log
from bench.run_store.folder import RunFolder
from bench.run_store.journal import read_journal
from drivers.ins.frames import FrameBlock, concatenate


def replay(folder: RunFolder, setup: MeasurementSetup) -> Iterator[DwellRow]:
    """Measure every finished dwell of a run again.

    The journal tells which frames make a dwell; the frames themselves come from the raw log.

    Raises
    ------
    RunFolderError
        The journal or the log can't be read.
    """
    entries = read_journal(folder.journal)
    pending = [
        DwellMarks.from_json(entry["marks"]) for entry in entries if entry["event"] == "dwell_finished"
    ]
    blocks: list[FrameBlock] = []
    for messages in read_can_log(folder.can) if pending else ():
        blocks.append(FrameBlock.from_messages(messages))
        while pending and _holds(blocks, pending[0].windows[-1].frames_until):
            marks = pending.pop(0)
            frames = _between(concatenate(blocks), marks.frames_from, marks.windows[-1].frames_until)
            yield measure_dwell(marks, frames, setup).row
        wanted_from = pending[0].frames_from if pending else float("inf")
        blocks = [block for block in blocks if len(block) and block.timestamp_s[-1] > wanted_from]
    for marks in pending:
        yield measure_dwell(marks, _between(concatenate(blocks), marks.frames_from, float("inf")), setup).row


def _holds(blocks: list[FrameBlock], until: float) -> bool:
    """Whether the log has been read to the frame before that edge."""
    return any(len(block) and block.timestamp_s[-1] >= until - _FRAME_SPACING_S for block in blocks)


def _between(block: FrameBlock, begin: float, end: float) -> FrameBlock:
    return block.take((block.timestamp_s > begin) & (block.timestamp_s < end))


#: An edge lies this near behind the last frame before it.
_FRAME_SPACING_S = 1e-4
