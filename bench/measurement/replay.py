"""Measuring a run anew from its raw CAN log."""

from __future__ import annotations

from collections.abc import Iterator

from bench.errors import RunFolderError
from bench.measurement.dwell import MeasuredDwell, MeasurementSetup, measure_dwell
from bench.measurement.marks import DwellMarks
from bench.measurement.verification_dwell import VerificationDwell, measure_verification
from bench.run_store.can_log import read_can_log
from bench.run_store.folder import RunFolder
from bench.run_store.journal import read_journal
from drivers.ins.frames import FrameBlock


def replay(folder: RunFolder, setup: MeasurementSetup) -> tuple[list[MeasuredDwell], list[VerificationDwell]]:
    """Measure every finished dwell of a run again, those that verify a calibration apart.

    The journal tells which frames make a dwell; the frames themselves come from the raw log.

    Raises
    ------
    RunFolderError
        The journal or the log can't be read, or the log lacks the frames of a dwell.
    """
    dwells, verifications = [], []
    for marks, frames in _recorded(folder):
        if marks.is_verification:
            verifications.append(measure_verification(marks, frames, setup))
        else:
            dwells.append(measure_dwell(marks, frames, setup))
    return dwells, verifications


def _recorded(folder: RunFolder) -> Iterator[tuple[DwellMarks, FrameBlock]]:
    entries = read_journal(folder.journal)
    finished = [
        DwellMarks.from_json(entry["marks"]) for entry in entries if entry.get("event") == "dwell_finished"
    ]
    pending = {marks.log_part: marks for marks in finished}
    for number, messages in read_can_log(folder.can) if pending else ():
        marks = pending.pop(number, None)
        if marks is not None:
            yield marks, FrameBlock.from_messages(messages).take(slice(0, marks.windows[-1].end_frame))
    if pending:
        raise RunFolderError(f"{folder.can}: lacks the parts {sorted(pending)} that the journal names")
