"""What is done with each run of a fleet; it runs in a worker, where what comes in and goes out is small."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType

from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import BenchInUseError, GyrobenchError, MeasurementError
from gyrobench.bench.foundations.text import plain_name
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.station.bench_lock import RunLock

#: The style of figures is the whole process's, so of several threads one draws at a time.
_DRAWING = threading.Lock()


class JobKind(StrEnum):
    """What can be done with many runs; named as the command for one run."""

    BINS = "bins"
    CLOSE = "close"
    REPORT = "report"


class JobState(StrEnum):
    """What became of a job."""

    DONE = "done"
    FAILED = "failed"
    #: Nothing may be written in the run folder now.
    SKIPPED = "skipped"


@dataclass(frozen=True)
class JobResult:
    """What became of one run.

    Attributes
    ----------
    path : str
        The run folder.
    state : JobState
        Whether it was done.
    text : str
        In a few words what was found, or why it was not done.
    took_s : float
        How long it took.
    """

    path: str
    state: JobState
    text: str
    took_s: float = 0.0


def do_job(kind: JobKind, path: str) -> JobResult:
    """Do a job with one run, whose folder nobody else may write in meanwhile.

    What is wrong with the run is in the result; other errors are bugs and come out.
    """
    clock = WallClock()
    run = Path(path)
    try:
        folder = open_run_folder(run)
        if not os.access(run, os.W_OK):
            return JobResult(path, JobState.SKIPPED, "nothing may be written in its folder")
        with RunLock(run, clock, command=f"gyrobench fleet {kind}"):
            text = _DOERS[kind](folder)
    except BenchInUseError as error:
        return JobResult(path, JobState.SKIPPED, str(error), clock.now())
    except GyrobenchError as error:
        return JobResult(path, JobState.FAILED, str(error), clock.now())
    return JobResult(path, JobState.DONE, text, clock.now())


def inputs_of(kind: JobKind, path: Path) -> str:
    """Sizes and times of what a job is made from: another text after that changed."""
    from gyrobench.bench.report.page import FINDINGS_FILE

    folder = RunFolder(path)
    files = {
        JobKind.BINS: (folder.journal, folder.procedure, folder.station),
        JobKind.CLOSE: (folder.journal, folder.dwells),
        JobKind.REPORT: (
            *(folder.journal, folder.dwells, folder.bias_bins, folder.acceptance, folder.noise),
            *(folder.joint, folder.joint_biases, folder.verification),
            *(place / FINDINGS_FILE for place in (folder.closure, folder.verify)),
        ),
    }[kind]
    return " ".join(_stamp(file) for file in files)


def _measured(folder: RunFolder) -> str:
    from gyrobench.bench.bias.dwell_table import read_dwells
    from gyrobench.bench.engine.session import measure_again

    measure_again(folder.path)
    rows = read_dwells(folder.dwells)
    flagged = sum(bool(row.flags) for row in rows)
    return f"{len(rows)} dwells{f', {flagged} flagged' if flagged else ''}"


def _closed(folder: RunFolder) -> str:
    from gyrobench.bench.closure.loop import close_loop
    from gyrobench.bench.dwells.closure_inputs import read_campaign
    from gyrobench.bench.report.closure.closure_page import write_search

    try:
        closure = close_loop(read_campaign(folder.path))
    except MeasurementError as error:
        return f"not searched: {error}"  # of one cycle, for instance: that is no failure of the run
    with _DRAWING:
        write_search(closure, folder.path)
    effects = [plain_name(each.candidate.effect.name) for each in closure.effects]
    return f"{closure.verdict}: {', '.join(effects)}" if effects else closure.verdict


def _reported(folder: RunFolder) -> str:
    from gyrobench.bench.report.run_report import write_report

    with _DRAWING:
        return write_report(folder).name


#: Imports are inside, so that a command that hands runs out does not wait for what workers need.
_DOERS: Mapping[JobKind, Callable[[RunFolder], str]] = MappingProxyType(
    {JobKind.BINS: _measured, JobKind.CLOSE: _closed, JobKind.REPORT: _reported}
)


def _stamp(path: Path) -> str:
    try:
        status = path.stat()
    except OSError:
        return "-"
    return f"{status.st_size}/{status.st_mtime_ns}"
