"""The picture of a run from its folder: what it wrote itself while it goes on, else what it left."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gyrobench.bench.engine.resume import NO_END_RECORDED, resume_state_of
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.errors import GyrobenchError, RunFolderError
from gyrobench.bench.live.picture import MOST_MESSAGES, Picture, RunState, read_picture
from gyrobench.bench.live.picture_parts import Attitude, BenchNow, MeasuredProfile, Note, PlannedProfile
from gyrobench.bench.live.profiles import planned_profile, profile_of_telemetry
from gyrobench.bench.live.tables import dwells_done, filling_bins
from gyrobench.bench.procedure.document import load_procedure
from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.report.content import Entry, RunContent, read_run
from gyrobench.bench.runs.folder import RunFolder, open_run_folder
from gyrobench.bench.runs.run_facts import LONGEST_RUN_S, RunFacts
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
    """What the journal says that a person was told."""
    for entry in journal:
        text, time_s = _told(entry), entry.get("time_s")
        if text and isinstance(time_s, int | float) and 0.0 <= time_s <= LONGEST_RUN_S:
            yield Note(float(time_s), text)


def _told(entry: Mapping[str, Any]) -> str:
    match entry.get("event"):
        case "note":
            return str(entry.get("text", ""))
        case "held":
            return f"Holding, waiting for {entry.get('waits_for')}: {entry.get('why')}"
        case "continued":
            return f"Going on, by {entry.get('by')}"
        case "dwell_given_up":
            return f"dwell {entry.get('dwell')} is repeated: {entry.get('why')}"
        case "dwell_skipped":
            return f"dwell {entry.get('dwell')} is left out"
    return ""
