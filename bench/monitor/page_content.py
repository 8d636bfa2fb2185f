"""Content of the pages as text: headline, tables, list of runs, and age of the snapshot."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from urllib.parse import quote

from gyrobench.bench.foundations.clock import parse_utc
from gyrobench.bench.foundations.text import bin_label, counted, hours_minutes
from gyrobench.bench.monitor.run_list import RunSummary
from gyrobench.bench.monitor.snapshot import (
    BenchReadings,
    LiveBin,
    RunSnapshot,
    RunState,
    SnapshotDwell,
    mean_known,
)
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.report.number_format import BiasScale, group_by_temperature, true_minus

#: Age from which a run is silent; it writes every two seconds, or less often under load.
_SILENT_AFTER_S = 20.0
_UNKNOWN = "unknown"


@dataclass(frozen=True)
class Freshness:
    """Age of a snapshot, 0 if unknown; whether the run has ended; and a warning if it is silent."""

    age_s: float
    is_over: bool
    warning: str


def freshness_of(state: RunState, updated_utc: str, now: datetime) -> Freshness:
    """Freshness of a snapshot from its state, its time, empty if unknown, and the host's calendar time."""
    updated = parse_utc(updated_utc)
    age_s = max(0.0, (now - updated).total_seconds()) if updated else 0.0
    if state.is_over or age_s < _SILENT_AFTER_S:
        return Freshness(age_s, state.is_over, "")
    cause = "The run's process exists but writes no snapshot. Check whether it is stuck or the disk is full."
    return Freshness(age_s, False, f"No update for {age_text(age_s)}. {cause}")


def age_text(age_s: float) -> str:
    """Age as text: "40 s", "12 min", "5 h", "3 days"."""
    if age_s < 120.0:
        return f"{age_s:.0f} s"
    if age_s < 7200.0:
        return f"{age_s / 60.0:.0f} min"
    return f"{age_s / 3600.0:.0f} h" if age_s < 172800.0 else f"{age_s / 86400.0:.0f} days"


#: Symbol of each state, recognisable from a distance and without colours.
STATE_SYMBOLS = {
    RunState.STARTING: "▷",
    RunState.RUNNING: "▶",
    RunState.HOLDING: "▲",
    RunState.PAUSED: "▲",
    RunState.WAITING: "?",
    RunState.FINISHED: "✓",
    RunState.STOPPED: "■",
    RunState.FAILED: "✕",
}
_PROGRESSING = {RunState.STARTING, RunState.RUNNING}
#: States that need attention.
_ATTENTION_STATES = {RunState.HOLDING, RunState.PAUSED, RunState.WAITING, RunState.STOPPED}
_MIN_DELAY_S = 300.0
#: The clock of a faster run is soon further ahead of the calendar.
_MAX_AHEAD_S = 60.0


@dataclass(frozen=True)
class Tile:
    """A large value with its name, and a line of detail below it."""

    name: str
    value: str
    detail: str


@dataclass(frozen=True)
class Headline:
    """The top of the page.

    ``css_class`` is a CSS class: "good", "notable" or "bad". ``end``: expected end, None if unknown, for
    example while the run waits; ``share_done`` is of the planned duration.
    """

    symbol: str
    state: str
    reason: str
    css_class: str
    tiles: tuple[Tile, ...]
    end: datetime | None
    share_done: float
    next_step: str  #: Commands with which the operator can continue; empty if there are none.


def headline(snapshot: RunSnapshot, verdict: str = "") -> Headline:
    """Headline of a run; ``verdict``: on its unit, empty if it was not judged."""
    state = snapshot.state
    css_class = "bad" if snapshot.alarms and not state.is_over else _state_class(state, verdict)
    return Headline(
        symbol=_symbol(state, verdict),
        state=_state_text(state, verdict),
        reason=snapshot.reason,
        css_class=css_class,
        tiles=(_time_tile(snapshot), _temperature_tile(snapshot.bench), _dwell_tile(snapshot)),
        end=_expected_end(snapshot) if state in _PROGRESSING else None,
        share_done=snapshot.share_done,
        next_step=_next_step(snapshot),
    )


def _next_step(snapshot: RunSnapshot) -> str:
    """Commands with which the operator can continue."""
    folder = shlex.quote(snapshot.folder)
    if snapshot.state in (RunState.STOPPED, RunState.FAILED):
        return f"gyrobench resume {folder} --look shows what is left; without --look it resumes."
    answers = snapshot.question.answers if snapshot.question else ()
    if snapshot.state is RunState.PAUSED or "continue" in answers:
        return f"gyrobench control {folder} continue resumes it, abort in its place ends it."
    return ""


def _state_class(state: RunState, verdict: str) -> str:
    """CSS class of a state, and of the verdict on the unit of a run that finished."""
    if state is RunState.FINISHED and verdict:
        return {"accepted": "good", "rejected": "bad"}.get(verdict, "notable")
    return "bad" if state is RunState.FAILED else "notable" if state in _ATTENTION_STATES else "good"


def _state_text(state: RunState, verdict: str) -> str:
    """State, and the verdict on the unit: "finished, unit rejected"."""
    return f"{state.value}, unit {verdict}" if state is RunState.FINISHED and verdict else state.value


def _symbol(state: RunState, verdict: str) -> str:
    return STATE_SYMBOLS[RunState.FAILED if _state_class(state, verdict) == "bad" else state]


def _temperature_text(temperature_c: float, decimals: int = 1) -> str:
    """Format a temperature with its unit; "unknown" for NaN."""
    if math.isnan(temperature_c):
        return _UNKNOWN
    return true_minus(f"{temperature_c:z.{decimals}f} °C")


def _expected_end(snapshot: RunSnapshot) -> datetime | None:
    """Expected end on the host's calendar; None for a run faster than real time."""
    started, updated = parse_utc(snapshot.started_utc), parse_utc(snapshot.updated_utc)
    if started is None or updated is None:
        return None
    ahead_s = (started + timedelta(seconds=snapshot.now_s) - updated).total_seconds()
    is_real_time = -3600.0 < ahead_s < _MAX_AHEAD_S
    return updated + timedelta(seconds=snapshot.left_s) if is_real_time else None


def _time_tile(snapshot: RunSnapshot) -> Tile:
    planned = f"{hours_minutes(snapshot.planned_s)} h planned"
    if snapshot.state.is_over:
        return Tile("Took", f"{hours_minutes(snapshot.now_s)} h", planned)
    delay = f", {hours_minutes(snapshot.behind_s)} h behind" if snapshot.behind_s >= _MIN_DELAY_S else ""
    return Tile("Time left", f"{hours_minutes(snapshot.left_s)} h", f"of {planned}{delay}")


def _temperature_tile(bench: BenchReadings | None) -> Tile:
    if bench is None:
        return Tile("Chamber", _UNKNOWN, "")
    gyro_c = mean_known(bench.gyro_c)
    gyros = "INS silent" if math.isnan(gyro_c) else f"gyros {_temperature_text(gyro_c)}"
    target = (
        "no set point" if math.isnan(bench.chamber_set_c) else f"set {_temperature_text(bench.chamber_set_c)}"
    )
    return Tile("Chamber", _temperature_text(bench.chamber_c), f"{target}, {gyros}")


def _dwell_tile(snapshot: RunSnapshot) -> Tile:
    flagged = sum(bool(dwell.flags) for dwell in snapshot.dwells)
    counts = {"flagged": flagged, "skipped": len(snapshot.skipped)}
    measured = ", ".join(
        [f"{snapshot.finished_dwells} measured", *(f"{n} {what}" for what, n in counts.items() if n)]
    )
    if snapshot.dwell is None or snapshot.state.is_over:
        return Tile("Dwells", f"{snapshot.finished_dwells} of {snapshot.dwell_count}", measured)
    dwell = snapshot.dwell
    place = f"{position_label(dwell.position)}, cycle {dwell.cycle}"
    return Tile("Dwell", f"{dwell.number} of {dwell.count}", f"{place}; {measured}")


@dataclass(frozen=True)
class Cell:
    """A bias and its standard uncertainty, from ``count`` dwells; empty texts for an empty bin."""

    bias: str = ""
    sigma: str = ""
    count: int = 0


@dataclass(frozen=True)
class BinTable:
    """Bins of one gyro: their ranges with a cell for each position; no cells for an empty range."""

    gyro: str
    unit: str
    positions: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]


#: A dwell, the mean temperature of its gyros, and a cell for each gyro.
DwellTableRow = tuple[SnapshotDwell, str, list[Cell]]


def bin_tables(bins: Iterable[LiveBin]) -> list[BinTable]:
    """Tables of the bins of each gyro, the warmest first; empty while all bins are empty."""
    all_bins = list(bins)
    filled = [each for each in all_bins if each.count]
    if not filled:
        return []
    scale = BiasScale.of([each.bias_dph for each in filled], [each.sigma_dph for each in filled])
    return [_bin_table(gyro, [each for each in all_bins if each.gyro == gyro], scale) for gyro in AXES]


def dwell_table(dwells: Sequence[SnapshotDwell]) -> tuple[str, list[DwellTableRow]]:
    """Unit of the biases, and a row for each dwell, the newest first."""
    biases = [value for dwell in dwells for value in dwell.bias_dph]
    scale = BiasScale.of(biases, [value for dwell in dwells for value in dwell.sigma_dph])
    return scale.unit, [_dwell_table_row(dwell, scale) for dwell in reversed(dwells)]


def reading_rows(bench: BenchReadings) -> list[tuple[str, str, str]]:
    """Present readings: quantity, value, and age of the instrument's last reply.

    Temperatures that not every INS sends are left out while unknown.
    """
    chamber, table, ins = (
        "never" if math.isnan(age_s) else f"{age_s:.1f} s"
        for age_s in (bench.chamber_age_s, bench.table_age_s, bench.ins_age_s)
    )
    has_set_point = not math.isnan(bench.chamber_set_c)
    set_point = _temperature_text(bench.chamber_set_c, 2) if has_set_point else "not controlled"
    electronics, case = _triple_text(bench.electronics_c), _temperature_text(bench.case_c, 2)
    optional = [("electronics x, y, z", electronics, ins), ("INS case", case, ins)]
    return [
        ("chamber air", _temperature_text(bench.chamber_c, 2), chamber),
        ("chamber set", set_point, chamber),
        ("gyro optics x, y, z", _triple_text(bench.gyro_c), ins),
        *(row for row in optional if row[1] != _UNKNOWN),
        ("INS mode", bench.ins_mode, ins),
        ("table outer axis", _axis_text(bench.outer_deg, bench.outer_rate_dps), table),
        ("table inner axis", _axis_text(bench.inner_deg, bench.inner_rate_dps), table),
    ]


def _bin_table(gyro: str, bins: list[LiveBin], scale: BiasScale) -> BinTable:
    used = {each.position for each in bins}
    positions = [position for position in POSITIONS if position in used]
    ranges = group_by_temperature(bins, lambda each: (each.low_c, each.high_c), lambda each: each.count > 0)
    filled = [index for index, (_, _, members) in enumerate(ranges) if members]
    shown = ranges[filled[0] : filled[-1] + 1] if filled else []
    cells = {
        (each.low_c, each.position): _cell(each.bias_dph, each.sigma_dph, scale, each.count) for each in bins
    }
    return BinTable(
        gyro=gyro_label(gyro),
        unit=scale.unit,
        positions=tuple(position_label(position) for position in positions),
        rows=tuple(
            (
                true_minus(bin_label(low_c, high_c, "…")),
                tuple(cells.get((low_c, position), Cell()) for position in positions) if members else (),
            )
            for low_c, high_c, members in reversed(shown)
        ),
    )


def _cell(bias_dph: float, sigma_dph: float, scale: BiasScale, count: int = 1) -> Cell:
    if not (math.isfinite(bias_dph) and math.isfinite(sigma_dph)):
        return Cell()
    return Cell(true_minus(scale.text(bias_dph)), scale.text(sigma_dph), count)


def _dwell_table_row(dwell: SnapshotDwell, scale: BiasScale) -> DwellTableRow:
    pairs = zip(dwell.bias_dph, dwell.sigma_dph, strict=True)
    gyro_c = mean_known(dwell.gyro_c)
    temperature = "" if math.isnan(gyro_c) else true_minus(f"{gyro_c:z.1f}")
    return dwell, temperature, [_cell(bias, sigma, scale) for bias, sigma in pairs]


def _triple_text(values_c: Iterable[float]) -> str:
    values = list(values_c)
    if all(math.isnan(value) for value in values):
        return _UNKNOWN
    return true_minus(", ".join("–" if math.isnan(value) else f"{value:z.2f}" for value in values)) + " °C"


def _axis_text(angle_deg: float, rate_dps: float) -> str:
    if math.isnan(angle_deg):
        return _UNKNOWN
    rate = "" if math.isnan(rate_dps) else f", {rate_dps:z.2f} deg/s"
    return true_minus(f"{angle_deg:z.3f}°{rate}")


@dataclass(frozen=True)
class ListRow:
    """One run in the list: name and address, state with symbol and CSS class, other facts in one line."""

    name: str
    address: str
    css_class: str
    symbol: str
    state: str
    reason: str
    facts: str


def list_row(run: RunSummary, freshness: Freshness) -> ListRow:
    """Row of a run."""
    is_silent = bool(freshness.warning)
    return ListRow(
        name=run.name,
        address=_address_of(run.name),
        css_class="bad" if is_silent or run.alarms else _state_class(run.state, run.verdict),
        symbol="▲" if is_silent else _symbol(run.state, run.verdict),
        state="silent" if is_silent else _state_text(run.state, run.verdict),
        reason=freshness.warning or run.reason,
        facts=", ".join(_run_facts(run)),
    )


def unreadable_row(name: str, problem: str) -> ListRow:
    """Row of a run that can't be read."""
    return ListRow(name, _address_of(name), "bad", "▲", "can't be read", problem, "")


def _address_of(name: str) -> str:
    """Address of a run's page, from the page of the list."""
    return f"runs/{quote(name, safe='')}/"


def _run_facts(run: RunSummary) -> Iterable[str]:
    """Facts of a run in the list."""
    if run.alarms:
        yield f"▲ {counted(run.alarms, 'alarm').upper()}"
    if run.procedure:
        yield run.procedure
    if run.units:
        yield f"{'units' if len(run.units) > 1 else 'unit'} {', '.join(run.units)}"
    yield (
        f"{run.dwells} of {counted(run.dwell_count, 'dwell')}"
        if run.dwell_count
        else counted(run.dwells, "dwell")
    )
    if run.left_s and not run.state.is_over:
        yield f"{hours_minutes(run.left_s)} h left"
    if run.started_utc:
        yield f"started {run.started_utc[:16].replace('T', ' ')} UTC"
