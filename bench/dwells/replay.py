"""Recomputing a run from its raw CAN log."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import can

from gyrobench.bench.bias.dwell_table import read_dwells, write_dwells
from gyrobench.bench.dwells.dwell import MeasuredDwell, MeasurementSetup, measure_dwell
from gyrobench.bench.dwells.marks import DwellMarks
from gyrobench.bench.dwells.results import evaluate, planned_dwells, write_results
from gyrobench.bench.dwells.run_dwells import add_dwell
from gyrobench.bench.dwells.setup import measurement_setup
from gyrobench.bench.dwells.verification_dwell import VerificationDwell, measure_verification
from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.procedure.document import load_procedure
from gyrobench.bench.runs.can_log import read_can_log
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.frames import FrameBlock


def replay(folder: RunFolder, setup: MeasurementSetup) -> tuple[list[MeasuredDwell], list[VerificationDwell]]:
    """Measure every finished dwell of a run again, those that verify a calibration apart.

    The journal tells which frames make a dwell; the frames themselves come from the raw log, one part of
    it at a time. Of a dwell that the journal says was finished twice, the last time counts; parts of the
    log that belong to no finished dwell, as a kill leaves them, are passed over.

    Raises
    ------
    RunFolderError
        The journal or the log can't be read, or the log lacks the frames of a dwell.
    """
    dwells: list[MeasuredDwell] = []
    verifications: list[VerificationDwell] = []
    for marks, frames in _recorded(folder):
        if marks.is_verification:
            verifications.append(measure_verification(marks, frames, setup))
        else:
            add_dwell(dwells, measure_dwell(marks, frames, setup))
    return dwells, verifications


def recompute_run(path: Path) -> RunFolder:
    """Measure a run again from its raw log, and write its tables.

    Raises
    ------
    RunFolderError
        The folder is no run folder, or its log can't be read.
    DocumentError
        The procedure, station or DBC file in it is wrong.
    """
    folder = open_run_folder(path)
    document, procedure = load_procedure(folder.procedure)
    station = Station(folder.station)
    setup = measurement_setup(station)
    dwells, verifications = replay(folder, setup)
    write_dwells(folder.dwells, [dwell.row for dwell in dwells])
    calibration = read_dwells(folder.calibration) if folder.calibration.exists() else []
    planned = planned_dwells(station.plan(document, procedure))
    results = evaluate(
        dwells, verifications, calibration, setup, procedure.bin_width_c, procedure.acceptance, planned
    )
    write_results(folder, results)
    return folder


def _recorded(folder: RunFolder) -> Iterator[tuple[DwellMarks, FrameBlock]]:
    finished = _finished(folder)
    pending = {marks.log_part: marks for marks in finished}
    if len(pending) < len(finished):
        raise RunFolderError(f"{folder.journal}: damaged: two dwells are said to be in one part of the log")
    for number, messages in read_can_log(folder.can) if pending else ():
        marks = pending.pop(number, None)
        if marks is not None:
            yield marks, _frames(folder, marks, messages)
    if pending:
        raise RunFolderError(f"{folder.can}: lacks the parts {sorted(pending)} that the journal names")


def finished_marks(folder: RunFolder) -> Iterator[DwellMarks]:
    """Marks of the finished dwells as the journal tells them, in the order of time.

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
