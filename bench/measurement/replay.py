"""Measuring a run anew from its raw CAN log."""

from __future__ import annotations

from collections.abc import Iterator

from bench.bias.dwell_table import DwellRow
from bench.errors import RunFolderError
from bench.measurement.dwell import MeasurementSetup, measure_dwell
from bench.measurement.marks import DwellMarks
from bench.run_store.can_log import read_can_log
from bench.run_store.folder import RunFolder
from bench.run_store.journal import read_journal
from drivers.ins.frames import FrameBlock


def replay(folder: RunFolder, setup: MeasurementSetup) -> Iterator[DwellRow]:
    """Measure every finished dwell of a run again.

    The journal tells which frames make a dwell; the frames themselves come from the raw log.

    Raises
    ------
    RunFolderError
        The journal or the log can't be read, or the log lacks the frames of a dwell.
    """
    entries = read_journal(folder.journal)
    finished = [
        DwellMarks.from_json(entry["marks"]) for entry in entries if entry.get("event") == "dwell_finished"
    ]
    pending = {marks.log_part: marks for marks in finished}
    for number, messages in read_can_log(folder.can) if pending else ():
        marks = pending.pop(number, None)
        if marks is not None:
            frames = FrameBlock.from_messages(messages)
            yield measure_dwell(marks, frames.take(slice(0, marks.windows[-1].end_frame)), setup).row
    if pending:
        raise RunFolderError(f"{folder.can}: lacks the parts {sorted(pending)} that the journal names")
