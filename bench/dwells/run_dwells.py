"""The dwells of a run: added one after the other, or measured again from the raw CAN log.

A run of a thousand hours has thousands of dwells. Their rows and what the joint solution needs are small; the
navigation for the noise estimate is kept of some dwells only, evenly spread over the run.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import can

from gyrobench.bench.dwells.check_dwell import CheckDwell, measure_check_dwell
from gyrobench.bench.dwells.dwell import MeasuredDwell, MeasurementSetup, measure_dwell
from gyrobench.bench.dwells.marks import DwellMarks
from gyrobench.bench.dwells.temperatures import stuck_sensors
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.drivers.ins.can_bus import FrameBlock


def replay(folder: RunFolder, setup: MeasurementSetup) -> tuple[list[MeasuredDwell], list[CheckDwell]]:
    """Measure every finished dwell of a run again; check dwells are returned separately.

    The journal lists the frames of each dwell; the frames themselves come from the raw log, one part of
    it at a time. Of a dwell that was finished twice, the last time counts; parts of the
    log that belong to no finished dwell, as a kill leaves them, are passed over.

    Raises
    ------
    RunFolderError
        The journal or the log can't be read, or the log lacks the frames of a dwell.
    """
    dwells: list[MeasuredDwell] = []
    verifications: list[CheckDwell] = []
    for marks, frames in _recorded(folder):
        if marks.is_verification:
            verifications.append(measure_check_dwell(marks, frames, setup))
        else:
            add_dwell(dwells, measure_dwell(marks, frames, setup))
    return dwells, verifications


def _recorded(folder: RunFolder) -> Iterator[tuple[DwellMarks, FrameBlock]]:
    finished = _finished(folder)
    pending = {marks.log_part: marks for marks in finished}
    if len(pending) < len(finished):
        raise RunFolderError(f"{folder.journal}: damaged: it places two dwells in one part of the log")
    for number, messages in read_can_log(folder.can) if pending else ():
        marks = pending.pop(number, None)
        if marks is not None:
            yield marks, _frames(folder, marks, messages)
    if pending:
        raise RunFolderError(f"{folder.can}: lacks the parts {sorted(pending)} that the journal names")


def finished_marks(folder: RunFolder) -> Iterator[DwellMarks]:
    """Marks of the finished dwells in the journal, in the order of time.

    Raises
    ------
    RunFolderError
        The journal is damaged.
    """
    for entry in read_journal(folder.journal):
        if entry.get("event") == "dwell_finished":
            try:
                yield DwellMarks.from_json(entry.get("marks", {}))
            except RunFolderError as error:
                raise RunFolderError(f"{folder.journal}: {error}") from error


def read_dwell_frames(folder: RunFolder, dwell: int) -> FrameBlock:
    """Frames of one finished dwell.

    Raises
    ------
    RunFolderError
        The run has no finished dwell of that number, or the log lacks its frames.
    """
    marks = {each.dwell: each for each in finished_marks(folder)}.get(dwell)
    if marks is None:
        raise RunFolderError(f"{folder.path}: has no finished dwell {dwell}")
    for _, messages in read_can_log(folder.can, {marks.log_part}):
        return _frames(folder, marks, messages)
    raise RunFolderError(f"{folder.can}: lacks part {marks.log_part}, which dwell {dwell} needs. Restore it")


def _finished(folder: RunFolder) -> list[DwellMarks]:
    """Marks of the finished dwells, each number once."""
    return list({marks.dwell: marks for marks in finished_marks(folder)}.values())


def _frames(folder: RunFolder, marks: DwellMarks, messages: list[can.Message]) -> FrameBlock:
    frames, needed = FrameBlock.from_messages(messages), marks.frame_count
    if len(frames) < needed:
        raise RunFolderError(
            f"{folder.can}: part {marks.log_part} holds {len(frames)} frames, where dwell {marks.dwell} "
            f"needs {needed}: it is cut off or damaged. Restore the part"
        )
    return frames.take(slice(0, needed))


#: The noise estimate does not improve with more dwells than this.
_MAX_WITH_NAVIGATION = 128


def add_dwell(dwells: list[MeasuredDwell], measured: MeasuredDwell) -> None:
    """Add the next dwell of a run.

    A temperature sensor that turns out to be stuck flags the dwells since it is, earlier ones too.
    """
    dwells.append(measured)
    for index, flag in stuck_sensors([each.row for each in dwells]):
        row = dwells[index].row
        if flag not in row.flags:
            flags = "; ".join(text for text in (row.flags, flag) if text)
            dwells[index] = replace(dwells[index], row=replace(row, flags=flags))
    _keep_navigation_of_some(dwells)


def _keep_navigation_of_some(dwells: list[MeasuredDwell]) -> None:
    spacing, last = _spacing(len(dwells)), len(dwells) - 1
    first = 0 if spacing != _spacing(last) else last
    for index in range(first, len(dwells)):
        if index % spacing and dwells[index].windows:
            dwells[index] = replace(dwells[index], windows=())


def _spacing(count: int) -> int:
    """Smallest power of two that leaves few enough."""
    return 1 << max(0, (max(count, 1) - 1) // _MAX_WITH_NAVIGATION).bit_length()
