"""The runs of a folder, and the snapshot of each from what its run folder holds."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Generic, TypeVar

from gyrobench.bench.engine.resume import NO_END_RECORDED, resume_state_of
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import GyrobenchError, RunFolderError
from gyrobench.bench.monitor.recorder import dwells_done, filling_bins, planned_profile, profile_of_telemetry
from gyrobench.bench.monitor.snapshot import (
    MOST_MESSAGES,
    Attitude,
    BenchNow,
    MeasuredProfile,
    Note,
    Picture,
    PlannedProfile,
    RunState,
    read_picture,
)
from gyrobench.bench.procedure.document import load_procedure
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.report.content import Entry, RunContent, read_run
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.runs.journal import LONGEST_RUN_S, RunFacts, facts_of, read_journal
from gyrobench.bench.station.bench_lock import holder_of
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.readout import InsMode


def picture_of(path: Path) -> Picture:
    """The picture of a run, whether it goes on, is over, or was made by an older gyrobench.

    Raises
    ------
    RunFolderError
        There is no run at that path.
    """
    folder = open_run_folder(path)
    try:
        picture = read_picture(folder.live)
    except RunFolderError:
        return picture_from_records(folder)
    if picture.state.is_over or holder_of(folder.path) is not None:
        return picture
    return replace(
        picture,
        state=RunState.STOPPED,
        reason=NO_END_RECORDED,
        question=None,
        step=None,
        dwell=None,
        alarms=(),
    )


def end_of(folder: RunFolder, facts: RunFacts) -> tuple[RunState, str]:
    """Whether a run without a picture goes on, and how and why it ended."""
    if holder_of(folder.path) is not None:
        return RunState.RUNNING, ""
    if facts.ended in (RunState.FINISHED, RunState.STOPPED, RunState.FAILED):
        return RunState(facts.ended), facts.reason
    return RunState.STOPPED, NO_END_RECORDED


def picture_from_records(folder: RunFolder) -> Picture:
    """Make a picture from journal, telemetry and tables; what is missing or damaged is left out of it.

    It has no traces of a dwell under way, and of the alarms only what the reason says.
    """
    content = read_run(folder)
    station, plan = _station_and_plan(folder)
    state, reason = end_of(folder, content.facts)
    rows, now_s = content.dwells, content.facts.last_s
    bench = _bench_at_end(content.telemetry, now_s)
    return Picture(
        name=content.name,
        folder=str(folder.path),
        procedure=str(content.procedure.get("procedure", "")),
        station=str(content.station.get("station", "")),
        unit=content.facts.unit or (rows[-1].unit if rows else ""),
        started_utc=str(content.provenance.get("started_utc", "")),
        updated_utc=_updated_utc(folder),
        state=state,
        reason=reason,
        now_s=now_s,
        left_s=_left_s(plan, content) if plan else 0.0,
        planned_s=plan.duration_s if plan else 0.0,
        dwell_count=plan.dwell_count if plan else len(rows),
        planned=planned_profile(plan) if plan else PlannedProfile(),
        measured=profile_of_telemetry(content.telemetry) if content.telemetry else MeasuredProfile(),
        bench=bench,
        attitude=_attitude(station, bench, content),
        dwells=dwells_done(rows),
        bins=filling_bins(rows, plan.procedure.bin_width_c) if plan else (),
        messages=tuple(_messages(content.journal))[-MOST_MESSAGES:],
    )


def _station_and_plan(folder: RunFolder) -> tuple[Station | None, Plan | None]:
    try:
        station = Station(folder.station)
        return station, station.plan(*load_procedure(folder.procedure))
    except GyrobenchError:
        return None, None


def _left_s(plan: Plan, content: RunContent) -> float:
    """What is left by the plan: all of it where the journal does not fit the plan."""
    try:
        done = resume_state_of(content.journal, plan)
    except RunFolderError:
        return plan.duration_s
    return 0.0 if done.is_over(plan) else plan.duration_s - plan.steps[done.next_index].start_s


def _updated_utc(folder: RunFolder) -> str:
    changed_s = folder.journal.stat().st_mtime
    return datetime.fromtimestamp(changed_s, UTC).isoformat(timespec="seconds")


def _bench_at_end(telemetry: Mapping[str, FloatArray], now_s: float) -> BenchNow | None:
    """The last reading, as old as it is."""
    if not telemetry or not len(telemetry["time_s"]):
        return None
    last = {name: float(values[-1]) for name, values in telemetry.items()}
    age_s = max(0.0, now_s - last["time_s"])
    return BenchNow(
        chamber_set_c=last["chamber_set_c"],
        chamber_c=last["chamber_c"],
        gyro_c=(last["gyro_x_c"], last["gyro_y_c"], last["gyro_z_c"]),
        electronics_c=(last["board_x_c"], last["board_y_c"], last["board_z_c"]),
        case_c=last["case_c"],
        outer_deg=last["outer_deg"],
        inner_deg=last["inner_deg"],
        outer_rate_dps=last["outer_rate_dps"],
        inner_rate_dps=last["inner_rate_dps"],
        ins_mode=_mode(last["ins_mode"]),
        table_age_s=age_s,
        chamber_age_s=age_s,
        ins_age_s=age_s,
    )


def _mode(code: float) -> str:
    known = {float(mode): mode.name.lower() for mode in InsMode}
    return known.get(code, "unknown")


def _attitude(station: Station | None, bench: BenchNow | None, content: RunContent) -> Attitude | None:
    if station is None or bench is None or math.isnan(bench.outer_deg + bench.inner_deg):
        return None
    east, north, up = station.table.attitude(bench.outer_deg, bench.inner_deg).tolist()
    last = content.dwells[-1] if content.dwells else None
    position, azimuth_deg = (last.position, last.azimuth_deg) if last else ("", math.nan)
    return Attitude(position, azimuth_deg, (tuple(east), tuple(north), tuple(up)))


def _messages(journal: Sequence[Entry]) -> Iterator[Note]:
    """Messages of the journal."""
    for entry in journal:
        text, time_s = _message(entry), entry.get("time_s")
        if text and isinstance(time_s, int | float) and 0.0 <= time_s <= LONGEST_RUN_S:
            yield Note(float(time_s), text)


def _message(entry: Mapping[str, Any]) -> str:
    match entry.get("event"):
        case "note":
            return str(entry.get("text", ""))
        case "held":
            return f"Holding, waiting for {entry.get('waits_for')}: {entry.get('why')}"
        case "continued":
            return f"Continued by {entry.get('by')}"
        case "dwell_given_up":
            return f"Dwell {entry.get('dwell')} is repeated: {entry.get('why')}"
        case "dwell_skipped":
            return f"Dwell {entry.get('dwell')} is skipped"
    return ""


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


Value = TypeVar("Value")


class FolderMemory(Generic[Value]):
    """Values made of folders, each made again only when its folder has changed.

    Safe for several threads; they wait for each other, so that nothing is made twice.

    Parameters
    ----------
    make : callable
        Makes the value of a folder.
    signature : callable
        Gives something of a folder that is another whenever its value may be.
    most : int
        How many values are kept; the one that was asked for longest ago goes first.
    """

    def __init__(
        self, make: Callable[[Path], Value], signature: Callable[[Path], Hashable], most: int
    ) -> None:
        self._make, self._signature, self._most = make, signature, most
        self._values: OrderedDict[Path, tuple[Hashable, Value]] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, folder: Path) -> Value:
        """Value of a folder; errors of making it are passed on."""
        with self._lock:
            signature = self._signature(folder)
            known = self._values.pop(folder, None)
            if known is None or known[0] != signature:
                known = (signature, self._make(folder))
            self._values[folder] = known
            if len(self._values) > self._most:
                self._values.popitem(last=False)
            return known[1]
