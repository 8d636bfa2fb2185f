"""The runs of a folder, and the snapshot of each from the files of its run folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from gyrobench.bench.bias.dwell import DwellPurpose
from gyrobench.bench.bias.dwell_table import DwellRow, read_dwells
from gyrobench.bench.bias.verdicts import read_acceptance
from gyrobench.bench.engine.resume import NO_END_RECORDED
from gyrobench.bench.engine.resume_state import ResumeState
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import GyrobenchError, RunFolderError
from gyrobench.bench.monitor.snapshot import (
    MAX_MESSAGES,
    UNKNOWN,
    Attitude,
    BenchReadings,
    MeasuredProfile,
    Note,
    PlannedProfile,
    RunSnapshot,
    RunState,
    live_bins,
    planned_profile,
    profile_of_telemetry,
    read_snapshot,
    snapshot_dwells,
)
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.procedure.procedure_file import load_procedure
from gyrobench.bench.report.journal_sections import Entry
from gyrobench.bench.report.run_content import read_run
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.runs.journal import MAX_RUN_S, RunFacts, facts_of, read_journal
from gyrobench.bench.runs.locks import holder_of
from gyrobench.bench.runs.marks import purpose_of
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.readout import InsMode


def snapshot_of(path: Path) -> RunSnapshot:
    """Snapshot of a run that is in progress or has ended, also of one of an older version of gyrobench.

    Raises RunFolderError if there is no run at that path.
    """
    folder = open_run_folder(path, may_have_units=True)
    try:
        snapshot = read_snapshot(folder.live)
    except RunFolderError:
        return snapshot_from_records(folder)
    if snapshot.state.is_over or holder_of(folder.path) is not None:
        return snapshot
    records = snapshot_from_records(folder)
    # A process that was killed may have recorded more than its last snapshot shows.
    if not snapshot.units and records.finished_dwells >= snapshot.finished_dwells:
        return replace(records, alarms=snapshot.alarms)
    return replace(
        snapshot, state=RunState.STOPPED, reason=NO_END_RECORDED, question=None, step=None, dwell=None
    )


def snapshot_of_unit(run: RunSnapshot, folder: RunFolder) -> RunSnapshot:
    """Snapshot of a run with the dwells and bins of one of its units in place of those of the first unit.

    Omits values that the snapshot has only of the first unit: dwell in progress, attitude, gyro temperatures.
    Raises RunFolderError if the unit's dwell table can't be read.
    """
    number = folder.path.name
    status = next((unit for unit in run.units if unit.number == number), None)
    if status is None or number == run.unit:
        return run
    rows = read_dwells(folder.dwells) if folder.dwells.exists() else []
    _, procedure = load_procedure(folder.procedure)
    unknown = (math.nan,) * len(run.measured.time_s)
    bench = run.bench and replace(
        run.bench,
        gyro_c=status.gyro_c,
        electronics_c=UNKNOWN,
        case_c=math.nan,
        ins_mode=status.ins_mode,
        ins_age_s=status.ins_age_s,
    )
    return replace(
        run,
        unit=number,
        measured=replace(run.measured, gyro_x_c=unknown, gyro_y_c=unknown, gyro_z_c=unknown),
        bench=bench,
        attitude=None,
        dwell=None,
        dwells=snapshot_dwells(rows),
        finished_dwells=status.dwells,
        bins=live_bins(rows, procedure.bin_width_c),
    )


def _state_by_records(folder: RunFolder, facts: RunFacts) -> tuple[RunState, str]:
    """State of a run without a snapshot, and the reason of its end, if it has ended."""
    if holder_of(folder.path) is not None:
        return RunState.RUNNING, ""
    if facts.ended in (RunState.FINISHED, RunState.STOPPED, RunState.FAILED):
        return RunState(facts.ended), facts.reason
    return RunState.STOPPED, NO_END_RECORDED


def snapshot_from_records(folder: RunFolder) -> RunSnapshot:
    """Make a snapshot from journal, telemetry and tables; missing or damaged files are left out.

    It has no traces of the current dwell, and alarms only as part of the reason.
    """
    content = read_run(folder)
    journal: list[Entry] = []
    with suppress(RunFolderError):  # entries up to the first damaged one
        journal.extend(read_journal(folder.journal))
    station, plan = _station_and_plan(folder)
    state, reason = _state_by_records(folder, content.facts)
    rows, now_s = content.dwells, content.facts.last_s
    bench = _last_readings(content.telemetry, now_s)
    return RunSnapshot(
        name=content.name,
        folder=str(folder.path),
        procedure=str(content.procedure.get("procedure", content.facts.procedure)),
        station=str(content.station.get("station", "")),
        unit=content.facts.unit or (rows[-1].unit if rows else ""),
        started_utc=str(content.provenance.get("started_utc", content.facts.started_utc)),
        updated_utc=datetime.fromtimestamp(folder.journal.stat().st_mtime, UTC).isoformat(timespec="seconds"),
        state=state,
        reason=reason,
        now_s=now_s,
        left_s=_left_s(plan, journal) if plan else 0.0,
        planned_s=plan.duration_s if plan else 0.0,
        dwell_count=plan.dwell_count if plan else content.dwell_purposes.total(),
        finished_dwells=content.dwell_purposes.total(),
        skipped=content.skipped,
        planned=planned_profile(plan) if plan else PlannedProfile(),
        measured=profile_of_telemetry(content.telemetry) if content.telemetry else MeasuredProfile(),
        bench=bench,
        attitude=_attitude(station, bench, content.dwells, journal),
        dwells=snapshot_dwells(rows),
        bins=live_bins(rows, plan.procedure.bin_width_c) if plan else (),
        messages=tuple(_messages(journal))[-MAX_MESSAGES:],
    )


def _station_and_plan(folder: RunFolder) -> tuple[Station | None, Plan | None]:
    """Station and plan of a run; None if they can't be read."""
    try:
        station = Station(folder.station)
        return station, station.plan(*load_procedure(folder.procedure))
    except GyrobenchError:
        return None, None


def _left_s(plan: Plan, journal: Sequence[Entry]) -> float:
    """Planned time remaining; the whole duration if the journal does not match the plan."""
    try:
        resume_state = ResumeState.of_journal(journal, plan)
    except RunFolderError:
        return plan.duration_s
    return 0.0 if resume_state.is_over(plan) else resume_state.remaining_plan(plan).duration_s


def _last_readings(telemetry: Mapping[str, FloatArray], now_s: float) -> BenchReadings | None:
    """The last reading, with its age."""
    if not telemetry or not len(telemetry["time_s"]):
        return None
    last = {name: float(values[-1]) for name, values in telemetry.items()}
    age_s = max(0.0, now_s - last["time_s"])
    return BenchReadings(
        chamber_set_c=last["chamber_set_c"],
        chamber_c=last["chamber_c"],
        gyro_c=(last["gyro_x_c"], last["gyro_y_c"], last["gyro_z_c"]),
        electronics_c=(last["board_x_c"], last["board_y_c"], last["board_z_c"]),
        case_c=last["case_c"],
        outer_deg=last["outer_deg"],
        inner_deg=last["inner_deg"],
        outer_rate_dps=last["outer_rate_dps"],
        inner_rate_dps=last["inner_rate_dps"],
        ins_mode=next((mode.name.lower() for mode in InsMode if mode == last["ins_mode"]), "unknown"),
        table_age_s=age_s,
        chamber_age_s=age_s,
        ins_age_s=age_s,
    )


def _attitude(
    station: Station | None, bench: BenchReadings | None, dwells: Sequence[DwellRow], journal: Sequence[Entry]
) -> Attitude | None:
    """Last attitude of the unit; None if unknown."""
    if station is None or bench is None or math.isnan(bench.outer_deg + bench.inner_deg):
        return None
    finished = [entry.get("marks") for entry in journal if entry.get("event") == "dwell_finished"]
    is_rotated = bool(finished) and purpose_of(finished[-1]) is DwellPurpose.ROTATIONS
    last = dwells[-1] if dwells and not is_rotated else None
    position, azimuth_deg = (last.position, last.azimuth_deg) if last else ("", math.nan)
    return Attitude.of(station.table.attitude(bench.outer_deg, bench.inner_deg), position, azimuth_deg)


def _messages(journal: Sequence[Entry]) -> Iterator[Note]:
    """Messages of the run, from its journal."""
    for entry in journal:
        text, time_s = _message_of(entry), entry.get("time_s")
        if text and isinstance(time_s, int | float) and 0.0 <= time_s <= MAX_RUN_S:
            yield Note(float(time_s), text)


def _message_of(entry: Mapping[str, Any]) -> str:
    """Message of a journal entry; empty if it has none."""
    match entry.get("event"):
        case "note" | "soak_not_settled":
            return str(entry.get("text", ""))
        case "held":
            return f"Holding, waiting for {entry.get('waits_for')}: {entry.get('why')}"
        case "continued":
            return f"Continued by {entry.get('by')}"
        case "dwell_given_up":
            return f"dwell {entry.get('dwell')} is repeated: {entry.get('why')}"
        case "dwell_skipped":
            return f"dwell {entry.get('dwell')} is skipped"
        case "repeat_commanded":
            return f"measured again on command: dwell {', '.join(map(str, entry.get('dwells', ())))}"
    return ""


#: Titles of self-contained pages in a run folder, by path.
_PAGES = {
    "report.html": "Report",
    "investigation.html": "Investigation",
    "closure/closure.html": "Search for effects",
    "verify/verification.html": "Verification",
    "verify/comparison.html": "Verification",  # of a run folder made before 2.0
}


@dataclass(frozen=True)
class RunSummary:
    """A run in the list of runs; unknown texts are empty."""

    #: name, procedure, units: Run folder, procedure and serial number of each INS.
    name: str
    procedure: str
    units: Sequence[str]
    #: state, reason: State, and the reason why the run holds, stopped or failed.
    state: RunState
    reason: str
    #: started_utc, updated_utc: ISO 8601.
    started_utc: str
    updated_utc: str = ""
    #: dwells, dwell_count: Completed and planned dwells; 0 for an unknown plan.
    dwells: int = 0
    dwell_count: int = 0
    left_s: float = 0.0  #: Planned time remaining.
    alarms: int = 0  #: Active alarms; 0 after the end.
    verdict: str = ""  #: On the unit; empty before the run is evaluated, and if nothing is judged.


def is_run(folder: Path) -> bool:
    """Whether this is a run folder."""
    run = RunFolder(folder)
    return run.live.is_file() or run.journal.is_file()


def runs_in(folder: Path) -> list[Path]:
    """Run folders directly inside a folder, without links: those in progress first, then the newest.

    Raises RunFolderError if the folder can't be read.
    """
    try:
        folders = [path for path in folder.iterdir() if path.is_dir() and not path.is_symlink()]
    except OSError as error:
        raise RunFolderError(f"{folder}: can't be read: {error.strerror}") from error
    return sorted(filter(is_run, folders), key=_sort_key, reverse=True)


def summarise(folder: Path) -> RunSummary:
    """Summarise a run from its snapshot, or else its journal. Raises RunFolderError if it can't be read."""
    run = RunFolder(folder)
    if run.live.is_file():
        snapshot = snapshot_of(folder)
        state = snapshot.state
        summary = RunSummary(
            name=folder.name,
            procedure=snapshot.procedure,
            units=[unit.number for unit in snapshot.units] or [snapshot.unit],
            state=state,
            reason=snapshot.reason,
            started_utc=snapshot.started_utc,
            updated_utc=snapshot.updated_utc,
            dwells=snapshot.finished_dwells,
            dwell_count=snapshot.dwell_count,
            left_s=snapshot.left_s,
            alarms=0 if state.is_over else len(snapshot.alarms),
        )
    else:
        facts = facts_of(read_journal(run.journal))
        state, reason = _state_by_records(run, facts)
        units = [unit.path.name for unit in run.unit_folders] or [facts.unit]
        start = facts.started_utc
        summary = RunSummary(folder.name, facts.procedure, units, state, reason, start, dwells=facts.dwells)
    known_units = [unit for unit in summary.units if unit]
    return replace(summary, units=known_units, verdict=verdict_in(folder) if state.is_over else "")


def verdict_in(folder: Path) -> str:
    """Verdict on the unit of a run; empty before the run is evaluated, and if nothing is judged."""
    path = RunFolder(folder).acceptance
    try:
        verdict = read_acceptance(path).verdict if path.exists() else "not judged"
    except GyrobenchError:
        return ""
    return "" if verdict == "not judged" else verdict


def signature_of(folder: Path) -> Hashable:
    """Value that changes with every change of the files of a run."""
    run = RunFolder(folder)
    return holder_of(folder), *map(_changed_ns, (run.live, run.journal, run.dwells, run.acceptance))


def pages_of(folder: Path) -> dict[str, str]:
    """Titles of the pages in a run folder, by path, without links out of it."""
    return {
        name: title
        for name, title in _PAGES.items()
        if (page := folder / name).is_file() and page.resolve().is_relative_to(folder.resolve())
    }


def _sort_key(folder: Path) -> tuple[bool, int, str]:
    """Whether the run is in progress, and its start, which is when the procedure was copied."""
    run = RunFolder(folder)
    began_ns = _changed_ns(run.procedure) or _changed_ns(run.journal)
    return holder_of(folder) is not None, began_ns, folder.name


def _changed_ns(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


_Value = TypeVar("_Value")


def cached_by_files(
    make: Callable[[Path], _Value], max_values: int, signature: Callable[[Path], Hashable] = signature_of
) -> Callable[[Path], _Value]:
    """``make`` for run folders, called again only when the signature of a folder changed; thread-safe.

    The values used last are kept, at most ``max_values``, and no error.
    """
    cached = lru_cache(max_values)(lambda folder, _: make(folder))
    return lambda folder: cached(folder, signature(folder))
