"""What stands above all else on the page of a run: state, time left, temperature, dwell."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime, timedelta

from gyrobench.bench.foundations.clock import parsed_utc
from gyrobench.bench.live.picture import Picture, RunState
from gyrobench.bench.live.picture_parts import BenchNow, mean_known
from gyrobench.bench.navigation.positions import position_label
from gyrobench.bench.procedure.timeline import hours_minutes
from gyrobench.bench.report.number_format import true_minus

#: Sign beside each state, so that it is known from afar and without colours.
SIGNS = {
    RunState.STARTING: "▷",
    RunState.RUNNING: "▶",
    RunState.HOLDING: "▲",
    RunState.PAUSED: "▲",
    RunState.WAITING: "?",
    RunState.FINISHED: "✓",
    RunState.STOPPED: "■",
    RunState.FAILED: "✕",
}
_GOING_ON = {RunState.STARTING, RunState.RUNNING}
#: States of which somebody should take notice.
_NOTABLE = {RunState.HOLDING, RunState.PAUSED, RunState.WAITING, RunState.STOPPED}
_NOTABLE_DELAY_S = 300.0


@dataclass(frozen=True)
class Tile:
    """A large value with its name above and a line below."""

    name: str
    value: str
    below: str


@dataclass(frozen=True)
class Headline:
    """The top of the page.

    Attributes
    ----------
    sign, state, reason : str
        What the run is doing, and why if it is not simply going on.
    look : str
        CSS class: "good", "notable" or "bad".
    tiles : tuple of Tile
        Time left, temperature, dwell.
    end : datetime or None
        When it is expected to end; None where that can't be told, as while it waits.
    share_done : float
        Of the planned duration.
    """

    sign: str
    state: str
    reason: str
    look: str
    tiles: tuple[Tile, ...]
    end: datetime | None
    share_done: float


def headline(picture: Picture) -> Headline:
    """Choose what stands on top."""
    state = picture.state
    look = "bad" if picture.alarms and not state.is_over else state_look(state)
    share = 1.0 - picture.left_s / picture.planned_s if picture.planned_s > 0.0 else 0.0
    return Headline(
        sign=SIGNS[state],
        state=state.value,
        reason=picture.reason,
        look=look,
        tiles=(_time_tile(picture), _temperature_tile(picture.bench), _dwell_tile(picture)),
        end=_expected_end(picture) if state in _GOING_ON else None,
        share_done=min(max(share, 0.0), 1.0),
    )


def state_look(state: RunState) -> str:
    """CSS class of a state."""
    return "bad" if state is RunState.FAILED else "notable" if state in _NOTABLE else "good"


def celsius(temperature_c: float, decimals: int = 1) -> str:
    """Write a temperature with its unit; "not known" for NaN."""
    if math.isnan(temperature_c):
        return "not known"
    return true_minus(f"{temperature_c:z.{decimals}f} °C")


def _expected_end(picture: Picture) -> datetime | None:
    """End on the calendar of the run; a run faster than the calendar is over before that means anything."""
    started, updated = parsed_utc(picture.started_utc), parsed_utc(picture.updated_utc)
    if started is None or updated is None:
        return None
    is_real_time = abs((started + timedelta(seconds=picture.now_s) - updated).total_seconds()) < 3600.0
    return updated + timedelta(seconds=picture.left_s) if is_real_time else None


def _time_tile(picture: Picture) -> Tile:
    planned = f"{hours_minutes(picture.planned_s)} h planned"
    if picture.state.is_over:
        return Tile("Took", f"{hours_minutes(picture.now_s)} h", planned)
    behind = f", {hours_minutes(picture.behind_s)} h behind" if picture.behind_s >= _NOTABLE_DELAY_S else ""
    return Tile("Time left", f"{hours_minutes(picture.left_s)} h", f"of {planned}{behind}")


def _temperature_tile(bench: BenchNow | None) -> Tile:
    if bench is None:
        return Tile("Chamber", "not known", "")
    gyro_c = mean_known(bench.gyro_c)
    gyros = "INS silent" if math.isnan(gyro_c) else f"gyros {celsius(gyro_c)}"
    target = "no set point" if math.isnan(bench.chamber_set_c) else f"set {celsius(bench.chamber_set_c)}"
    return Tile("Chamber", celsius(bench.chamber_c), f"{target}, {gyros}")


def _dwell_tile(picture: Picture) -> Tile:
    flagged = sum(bool(dwell.flags) for dwell in picture.dwells)
    measured = f"{len(picture.dwells)} measured" + (f", {flagged} flagged" if flagged else "")
    if picture.dwell is None or picture.state.is_over:
        return Tile("Dwells", f"{len(picture.dwells)} of {picture.dwell_count}", measured)
    dwell = picture.dwell
    where = f"{position_label(dwell.position)}, cycle {dwell.cycle}"
    return Tile("Dwell", f"{dwell.number} of {dwell.count}", f"{where}; {measured}")
