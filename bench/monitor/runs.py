"""Finding runs and reading what is known of them."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path

from gyrobench.bench.foundations.errors import RunFolderError
from gyrobench.bench.live.from_folder import end_of, picture_of
from gyrobench.bench.live.picture import Picture, RunState
from gyrobench.bench.runs.folder import RunFolder
from gyrobench.bench.runs.journal import read_journal
from gyrobench.bench.runs.run_facts import facts_of
from gyrobench.bench.station.bench_lock import holder_of

#: Pages that a run may leave, each whole in itself, and what they are called.
RECORDS = {
    "report.html": "Report",
    "closure/closure.html": "Search for effects",
    "verify/comparison.html": "Proof of the compensation",
}


@dataclass(frozen=True)
class RunSummary:
    """What a list of runs tells of one.

    Attributes
    ----------
    name, procedure, unit : str
        Run folder, procedure and INS; empty where not known.
    state, reason
        What it is doing, and why it holds, stopped or failed.
    started_utc, updated_utc : str
        ISO 8601; ``updated_utc`` is empty where not known.
    dwells, dwell_count : int
        Measured so far, and by the plan; 0 for a plan that is not known.
    left_s : float
        What is left by the plan.
    alarms : int
        How many are up; 0 for a run that is over.
    """

    name: str
    procedure: str
    unit: str
    state: RunState
    reason: str
    started_utc: str
    updated_utc: str = ""
    dwells: int = 0
    dwell_count: int = 0
    left_s: float = 0.0
    alarms: int = 0


def is_run(folder: Path) -> bool:
    """Whether a run has begun in this folder."""
    found = RunFolder(folder)
    return found.live.is_file() or found.journal.is_file()


def runs_in(folder: Path) -> list[Path]:
    """Run folders directly inside a folder: those under way, then the others; of each the newest first.

    Links are passed over.

    Raises
    ------
    RunFolderError
        The folder can't be read.
    """
    try:
        inside = [path for path in folder.iterdir() if path.is_dir() and not path.is_symlink()]
    except OSError as error:
        raise RunFolderError(f"{folder}: can't be read: {error.strerror}") from error
    return sorted(filter(is_run, inside), key=_order, reverse=True)


def summarise(folder: Path) -> RunSummary:
    """Tell of a run in short, without reading more than its picture or its journal.

    Raises
    ------
    RunFolderError
        It can't be read.
    """
    found = RunFolder(folder)
    return _of_picture(folder.name, picture_of(folder)) if found.live.is_file() else _of_journal(found)


def signature_of(folder: Path) -> Hashable:
    """Something of a run folder that is another whenever there is news of the run."""
    return holder_of(folder), *map(_changed_ns, _news(folder))


def records_of(folder: Path) -> dict[str, str]:
    """Pages that a run has left, and their titles."""
    return {name: title for name, title in RECORDS.items() if _is_inside(folder / name, folder)}


def _is_inside(path: Path, folder: Path) -> bool:
    """Whether a file is there, and not through a link that leads out of the run folder."""
    return path.is_file() and path.resolve().is_relative_to(folder.resolve())


def _order(folder: Path) -> tuple[bool, int, str]:
    """Under way or not, and when it began: its copy of the procedure is written then and never again."""
    found = RunFolder(folder)
    began_ns = _changed_ns(found.procedure) or _changed_ns(found.journal)
    return holder_of(folder) is not None, began_ns, folder.name


def _news(folder: Path) -> tuple[Path, ...]:
    """Files whose change is news of a run."""
    found = RunFolder(folder)
    return found.live, found.journal, found.dwells


def _changed_ns(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def _of_picture(name: str, picture: Picture) -> RunSummary:
    return RunSummary(
        name=name,
        procedure=picture.procedure,
        unit=picture.unit,
        state=picture.state,
        reason=picture.reason,
        started_utc=picture.started_utc,
        updated_utc=picture.updated_utc,
        dwells=len(picture.dwells),
        dwell_count=picture.dwell_count,
        left_s=picture.left_s,
        alarms=0 if picture.state.is_over else len(picture.alarms),
    )


def _of_journal(folder: RunFolder) -> RunSummary:
    facts = facts_of(read_journal(folder.journal))
    state, reason = end_of(folder, facts)
    return RunSummary(
        name=folder.path.name,
        procedure=facts.procedure,
        unit=facts.unit,
        state=state,
        reason=reason,
        started_utc=facts.started_utc,
        dwells=facts.dwells,
    )
