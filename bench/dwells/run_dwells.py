"""The dwells of a run: collected as they are measured, or measured again from its folder.

A fault that only several dwells together reveal flags each of them. A run of a thousand hours has thousands
of dwells. Their rows and their input to the joint solution are small, but the navigation for the noise
estimate is kept only for some of them, evenly spread over the run. The marks of each dwell are in the
journal of the run folder, its frames in the raw CAN log.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gyrobench.bench.bias.damping import Damping
from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.characteristics.allan_test import RateRecord
from gyrobench.bench.dwells.dwell_output import ALIGNED_AGAIN
from gyrobench.bench.dwells.measure_dwell import CheckDwell, MeasuredDwell, measure_check_dwell, measure_dwell
from gyrobench.bench.dwells.measurement_setup import MeasurementSetup
from gyrobench.bench.dwells.rotated_dwell import increments_from_navigation
from gyrobench.bench.dwells.setup_check import setup_fault
from gyrobench.bench.dwells.temperatures import stuck_sensors
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.marks import DwellMarks
from gyrobench.drivers.frames import FrameBlock, concatenate

#: More dwells than this do not improve the noise estimate.
_MAX_KEPT_NAVIGATIONS = 128


def add_dwell(dwells: list[MeasuredDwell], measured: MeasuredDwell) -> None:
    """Add the next dwell of a run.

    If a temperature sensor is stuck, all dwells since it got stuck are flagged.
    """
    dwells.append(measured)
    for index, flag in stuck_sensors([each.row for each in dwells]):
        if flag not in dwells[index].flags:
            dwells[index] = dwells[index].with_flag(flag)
    _flag_damping(dwells)
    _flag_setup(dwells)
    _thin_navigation(dwells)


#: An INS damps its velocity if the mean rate of all dwells has a smaller p-value.
_MIN_DAMPING_P_VALUE = 1e-5


def _flag_damping(dwells: list[MeasuredDwell]) -> None:
    """Flag all dwells of an INS that damps its velocity; few dwells reveal it by themselves."""
    valid = [each.estimate.damping for each in dwells if each.estimate and not each.is_disturbed]
    if not valid or not (damping := Damping.mean(valid)).is_significant(_MIN_DAMPING_P_VALUE):
        return
    for index, dwell in enumerate(dwells):
        if dwell.estimate and not any(flag.startswith(Damping.FLAG) for flag in dwell.flags):
            persistent = (*dwell.persistent_flags, damping.text)
            dwells[index] = replace(dwell.with_flag(damping.text), persistent_flags=persistent)


def _flag_setup(dwells: list[MeasuredDwell]) -> None:
    """Flag all dwells if together they contradict the signal map or the latitude."""
    fault = setup_fault([each.evidence for each in dwells if each.evidence])
    if not fault:
        return
    for index, dwell in enumerate(dwells):
        if not dwell.setup_fault:
            dwells[index] = replace(dwell.with_flag(fault), setup_fault=fault)


def flag_rest_of_wrong_setup(dwells: Sequence[MeasuredDwell]) -> Sequence[MeasuredDwell]:
    """Flag the other dwells of a finished run if most contradict the set-up, or show a new alignment.

    Both are the same for all dwells. Not done while dwells are added: the flags of a first dwell that is
    wrong by itself would remain on those that follow.
    """
    faults = [dwell.setup_fault for dwell in dwells]
    dwells = _flag_rest(dwells, faults, "most dwells of the run contradict the station file")
    aligned_again = [next((each for each in dwell.flags if ALIGNED_AGAIN in each), "") for dwell in dwells]
    return _flag_rest(dwells, aligned_again, "in most dwells of the run")


def _flag_rest(
    dwells: Sequence[MeasuredDwell], faults: Sequence[str], introduction: str
) -> Sequence[MeasuredDwell]:
    """Flag the dwells without a fault if most have one; ``faults``: of each dwell, empty for none."""
    found = [fault for fault in faults if fault]
    if 2 * len(found) <= len(dwells):
        return dwells
    flag = f"{introduction}: {found[0]}"
    return [dwell if fault else dwell.with_flag(flag) for dwell, fault in zip(dwells, faults, strict=True)]


def _thin_navigation(dwells: list[MeasuredDwell]) -> None:
    spacing, last = _spacing(len(dwells)), len(dwells) - 1
    first = 0 if spacing != _spacing(last) else last
    for index in range(first, len(dwells)):
        if index % spacing and dwells[index].windows:
            dwells[index] = replace(dwells[index], windows=())


def _spacing(count: int) -> int:
    """Smallest power of two n for which every n-th of ``count`` dwells is at most the number to keep."""
    return 1 << max(0, (max(count, 1) - 1) // _MAX_KEPT_NAVIGATIONS).bit_length()


#: A noise record is thinned to about this number of samples; the integral of the rate loses nothing by it.
_MAX_NOISE_SAMPLES = 50_000


def measure_recorded(
    folder: RunFolder, setup: MeasurementSetup
) -> tuple[list[MeasuredDwell], list[CheckDwell]]:
    """Measure every finished dwell of a run again; check dwells are returned separately.

    The journal lists the frames of each dwell; the frames come from the raw log, one part at a time. If a
    dwell was finished twice, the last time counts. Parts of the log that belong to no finished dwell, as a
    kill leaves them, are skipped. Raises RunFolderError if the journal or the log can't be read, or the log
    lacks the frames of a dwell.
    """
    dwells: list[MeasuredDwell] = []
    check_dwells: list[CheckDwell] = []
    for marks, frames in _recorded_dwells(folder):
        if marks.purpose is DwellPurpose.CALIBRATION_CHECK:
            check_dwells.append(measure_check_dwell(marks, frames, setup))
        else:
            add_dwell(dwells, measure_dwell(marks, frames, setup))
    return dwells, check_dwells


def _recorded_dwells(folder: RunFolder) -> Iterator[tuple[DwellMarks, FrameBlock]]:
    finished = [marks for marks in finished_marks(folder) if marks.purpose.gives_bias]
    parts = [marks.log_part for marks in finished if marks.windows]
    if len(set(parts)) < len(parts):
        raise RunFolderError(f"{folder.journal}: damaged: it places two dwells in one part of the log")
    for marks in finished:
        yield marks, read_frames(folder, marks)


def undisturbed_marks(folder: RunFolder, purpose: DwellPurpose) -> list[DwellMarks]:
    """:func:`finished_marks` of the undisturbed dwells with a purpose."""
    return [marks for marks in finished_marks(folder) if marks.purpose is purpose and not marks.disturbances]


def undisturbed_dwells(folder: RunFolder, purpose: DwellPurpose) -> Iterator[tuple[DwellMarks, FrameBlock]]:
    """The same with their frames; raises as :func:`measure_recorded`."""
    for marks in undisturbed_marks(folder, purpose):
        yield marks, read_frames(folder, marks)


def rate_record(marks: DwellMarks, frames: FrameBlock, setup: MeasurementSetup) -> RateRecord:
    """Integrated rates of the gyros over the window of a noise record, split where epochs are missing."""
    increments = increments_from_navigation(setup.decode(frames), setup.site)
    first, end = marks.span
    inside = (increments.row > first) & (increments.row < end)
    angle, is_consecutive = increments.angle[inside], increments.is_consecutive[inside]
    every = int(np.ceil(max(len(angle), 1) / _MAX_NOISE_SAMPLES))
    pieces = np.split(angle, np.flatnonzero(~is_consecutive[1:]) + 1)
    segments = [np.vstack([np.zeros(3), np.cumsum(piece, axis=0)])[::every] for piece in pieces]
    return RateRecord(increments.interval_s * every, segments)


def finished_marks(folder: RunFolder) -> list[DwellMarks]:
    """Marks of the finished dwells in the journal, one for each dwell, in the order of time.

    Raises RunFolderError if the journal is damaged.
    """
    return marks_in(read_journal(folder.journal), folder)


def marks_in(entries: Iterable[Mapping[str, Any]], folder: RunFolder) -> list[DwellMarks]:
    """:func:`finished_marks` of journal entries that are already read."""
    by_dwell: dict[int, DwellMarks] = {}
    for entry in entries:
        if entry.get("event") == "data_given_up":
            given_up = entry.get("dwells")
            if not isinstance(given_up, list):
                raise RunFolderError(f"{folder.journal}: damaged: data_given_up lacks its list of dwells")
            by_dwell = {dwell: marks for dwell, marks in by_dwell.items() if dwell not in given_up}
        elif entry.get("event") == "dwell_finished":
            try:
                marks = DwellMarks.from_json(entry.get("marks", {}))
            except RunFolderError as error:
                raise RunFolderError(f"{folder.journal}: {error}") from error
            by_dwell[marks.dwell] = marks
    return sorted(by_dwell.values(), key=lambda marks: marks.start_s)


def read_dwell_frames(folder: RunFolder, dwell: int) -> FrameBlock:
    """Frames of one finished dwell.

    Raises RunFolderError if the run has no finished dwell of that number, or the log lacks its frames.
    """
    marks = {each.dwell: each for each in finished_marks(folder)}.get(dwell)
    if marks is None:
        raise RunFolderError(f"{folder.path}: has no finished dwell {dwell}")
    return read_frames(folder, marks)


def read_frames(folder: RunFolder, marks: DwellMarks) -> FrameBlock:
    """Frames of a dwell by its marks; empty if the INS never navigated in it.

    Raises RunFolderError if the log lacks them.
    """
    if not marks.windows:
        return concatenate([])
    _, logged = next(iter(read_can_log(folder.can, {marks.log_part})), (0, None))
    if logged is None:
        raise RunFolderError(
            f"{folder.can}: lacks part {marks.log_part}, which dwell {marks.dwell} needs. Restore it"
        )
    frames, needed = logged.data_frames(), marks.frame_count
    if len(frames) < needed:
        raise RunFolderError(
            f"{folder.can}: part {marks.log_part} holds {len(frames)} frames, where dwell {marks.dwell} "
            f"needs {needed}: it is cut off or damaged. Restore the part"
        )
    return frames.take(slice(0, needed))
