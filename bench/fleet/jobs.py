"""Jobs of a fleet: processing of one run in a worker, and the record ``fleet.json`` of the outcomes."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from pydantic import BaseModel, ValidationError

from gyrobench.bench import __version__
from gyrobench.bench.foundations.clock import WallClock
from gyrobench.bench.foundations.errors import (
    BenchInUseError,
    GyrobenchError,
    MeasurementError,
    RunFolderError,
)
from gyrobench.bench.foundations.files import defer_sync, make_folder, read_limited, write_whole
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.runs.locks import RunLock

#: Matplotlib's style is global, so only one thread draws at a time.
_DRAWING = threading.Lock()


class JobKind(StrEnum):
    """Jobs for many runs, with the names of the commands for one run."""

    BINS = "bins"
    CLOSE = "close"
    REPORT = "report"


class JobState(StrEnum):
    """Outcome of a job."""

    DONE = "done"
    #: Its dwells can't be searched, for instance too few; it is tried again once they have changed.
    NOT_SEARCHED = "not searched"
    FAILED = "failed"
    #: The run folder can't be written at present.
    SKIPPED = "skipped"


@dataclass(frozen=True)
class JobResult:
    """Outcome of the job for one run."""

    path: str  #: The run folder.
    state: JobState  #: The outcome.
    text: str  #: Short result, or the reason why it was not done.
    took_s: float = 0.0  #: Duration.


def do_job(kind: JobKind, path: str, *, is_synced: bool = True) -> JobResult:
    """Process one run under its lock; the result contains errors of the run, other exceptions are raised.

    ``is_synced``: whether each file is flushed to disk when it is written; otherwise by the next
    :func:`gyrobench.bench.foundations.files.sync_all`.
    """
    clock = WallClock()
    run = Path(path)
    try:
        folder = open_run_folder(run)
        if not os.access(run, os.W_OK):
            return JobResult(path, JobState.SKIPPED, "no write permission for its folder")
        with (
            RunLock(run, clock, command=f"gyrobench fleet {kind}"),
            nullcontext() if is_synced else defer_sync(),
        ):
            text = _PROCESSORS[kind](folder)
    except BenchInUseError as error:
        return JobResult(path, JobState.SKIPPED, str(error), clock.now())
    except GyrobenchError as error:
        is_searched = kind is not JobKind.CLOSE or not isinstance(error, MeasurementError)
        state = JobState.FAILED if is_searched else JobState.NOT_SEARCHED
        return JobResult(path, state, str(error), clock.now())
    return JobResult(path, JobState.DONE, text, clock.now())


def inputs_of(kind: JobKind, path: Path) -> str:
    """Sizes and times of the files that a job reads; the text changes with any of them."""
    from gyrobench.bench.report.page import FINDINGS_FILE

    folder = RunFolder(path)
    files = {
        JobKind.BINS: (folder.journal, folder.procedure, folder.station),
        JobKind.CLOSE: (folder.journal, folder.dwells),
        JobKind.REPORT: (
            *(folder.journal, folder.dwells, folder.bias_bins, folder.acceptance, folder.noise),
            *(folder.joint, folder.joint_biases, folder.calibration_check),
            *(subfolder / FINDINGS_FILE for subfolder in (folder.closure, folder.verify)),
        ),
    }[kind]
    return " ".join(_stamp(file) for file in files)


def _recompute(folder: RunFolder) -> str:
    from gyrobench.bench.bias.dwell_table import read_dwells
    from gyrobench.bench.dwells.run_results import recompute_run

    recompute_run(folder.path)
    rows = read_dwells(folder.dwells)
    flagged = sum(bool(row.flags) for row in rows)
    return f"{len(rows)} dwells{f', {flagged} flagged' if flagged else ''}"


def _search(folder: RunFolder) -> str:
    from gyrobench.bench.closure.inputs import read_campaign
    from gyrobench.bench.closure.loop import close_loop
    from gyrobench.bench.report.closure_page import write_search

    closure = close_loop(read_campaign(folder.path))
    with _DRAWING:
        write_search(closure, [folder.path])
    effects = [each.effect.display_name for each in closure.effects]
    return f"{closure.verdict}: {', '.join(effects)}" if effects else closure.verdict


def _report(folder: RunFolder) -> str:
    from gyrobench.bench.report.run_report import write_report

    with _DRAWING:
        return write_report(folder).path.name


#: Imported in the worker: the command that distributes runs starts without them.
_PROCESSORS: dict[JobKind, Callable[[RunFolder], str]] = {
    JobKind.BINS: _recompute,
    JobKind.CLOSE: _search,
    JobKind.REPORT: _report,
}


def _stamp(path: Path) -> str:
    try:
        status = path.stat()
    except OSError:
        return "-"
    return f"{status.st_size}/{status.st_mtime_ns}"


RECORD = "fleet.json"
_MAX_BYTES = 500_000_000


class _RunEntry(BaseModel):
    """Outcome of one run; ``inputs`` as of :func:`inputs_of`."""

    state: JobState
    text: str
    took_s: float
    inputs: str


class _RecordContent(BaseModel):
    kind: JobKind
    gyrobench: str
    runs: dict[str, _RunEntry]


@dataclass
class FleetRecord:
    """Outcomes of the runs of a fleet."""

    kind: JobKind  #: The job.
    folder: Path  #: Folder of the record.
    runs: dict[str, _RunEntry] = field(default_factory=dict)  #: By run folder.

    def pending(self, paths: list[Path]) -> list[Path]:
        """Runs that are new, failed, or have changed since they were processed."""
        return [path for path in paths if not self._is_done(path)]

    def add(self, result: JobResult) -> None:
        """Add an outcome; :meth:`write` saves it."""
        self.runs[result.path] = _RunEntry(
            state=result.state,
            text=result.text,
            took_s=round(result.took_s, 3),
            inputs=inputs_of(self.kind, Path(result.path)),
        )

    def write(self) -> None:
        """Write the record. Raises RunFolderError if it can't be written."""
        content = _RecordContent(kind=self.kind, gyrobench=__version__, runs=dict(sorted(self.runs.items())))
        make_folder(self.folder)
        write_whole(self.folder / RECORD, (content.model_dump_json(indent=1) + "\n").encode())

    def _is_done(self, path: Path) -> bool:
        entry = self.runs.get(str(path))
        if entry is None or entry.state not in (JobState.DONE, JobState.NOT_SEARCHED):
            return False
        return entry.inputs == inputs_of(self.kind, path)


def read_record(kind: JobKind, folder: Path) -> FleetRecord:
    """Read the record of an earlier call; an empty one if there is none.

    Raises RunFolderError if it can't be read, is damaged, or belongs to another job.
    """
    path = folder / RECORD
    if not path.exists():
        return FleetRecord(kind, folder)
    try:
        content = _RecordContent.model_validate_json(read_limited(path, _MAX_BYTES, RunFolderError))
    except ValidationError as error:
        raise RunFolderError(
            f"{path}: damaged: {error.errors()[0]['msg']}. Remove it, or process all runs with --again"
        ) from error
    if content.kind != kind:
        raise RunFolderError(
            f"{path}: record of `gyrobench fleet {content.kind}`. Choose another folder with --out"
        )
    return FleetRecord(kind, folder, content.runs)
