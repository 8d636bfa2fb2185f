"""Preflight of the disk: what a run will write, and what is free."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

from gyrobench.bench.procedure.plan import Plan
from gyrobench.bench.procedure.timeline import hours_minutes
from gyrobench.bench.runs.telemetry import COLUMNS
from gyrobench.bench.station.check import Check
from gyrobench.bench.station.station import Station

_SUBJECT = "disk"
#: Of the raw log, compressed; of the journal, per tick at most.
_BYTES_PER_FRAME = 12.0
_BYTES_PER_VALUE = 8.0
#: Reports, figures, copies of the inputs, journal.
_FIXED_BYTES = 50e6
#: Dwells that have to be repeated, holds, and what else fills the disk meanwhile.
_MARGIN = 2.0
_GB = 1e9


def disk_check(station: Station, folder: Path, plan: Plan | None, frames_per_s: float) -> Check:
    """Tell whether a whole run fits on the disk, with a margin of two.

    Parameters
    ----------
    folder : Path
        Where run folders are made; it need not exist yet.
    plan : Plan or None
        What is to be run.
    frames_per_s : float
        Frames that the bus carries; NaN where nobody knows.
    """
    what = "space for the run"
    if math.isnan(frames_per_s):
        return Check.skipped(
            _SUBJECT, what, "nothing was heard from the bus, so nobody knows what there is to write"
        )
    telemetry_per_s = len(COLUMNS) * _BYTES_PER_VALUE / station.instruments_period_s
    per_h = 3600.0 * (frames_per_s * _BYTES_PER_FRAME + telemetry_per_s)
    existing = next(each for each in (folder.absolute(), *folder.absolute().parents) if each.exists())
    free = shutil.disk_usage(existing).free
    room = f"{free / _GB:.1f} GB free at {existing}, {per_h / 1e6:.1f} MB an hour"
    if plan is None:
        return Check.skipped(_SUBJECT, what, room, "Give --procedure to have its whole duration looked at.")
    hours = plan.duration_s / 3600.0
    needed = _FIXED_BYTES + _MARGIN * per_h * hours
    return Check.of(
        _SUBJECT,
        what,
        free >= needed,
        f"{room}, {needed / _GB:.2f} GB for {hours_minutes(plan.duration_s)} h with margin",
        "Free some space, or take a run folder on another disk.",
    )
