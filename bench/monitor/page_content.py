"""What the page of a run shows, as text: headline, tables, and how fresh the snapshot is."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from urllib.parse import quote

from gyrobench.bench.foundations.clock import parsed_utc
from gyrobench.bench.foundations.text import bin_label, counted
from gyrobench.bench.monitor.run_list import RunSummary
from gyrobench.bench.monitor.snapshot import BenchNow, DwellDone, FillingBin, Picture, RunState, mean_known
from gyrobench.bench.navigation.positions import AXES, POSITIONS, gyro_label, position_label
from gyrobench.bench.procedure.timeline import hours_minutes
from gyrobench.bench.report.wording import BiasScale, by_temperature, true_minus

#: A run writes every other second; one that is busy may take some longer.
SILENT_AFTER_S = 20.0


@dataclass(frozen=True)
class News:
    """How fresh a picture is.

    Attributes
    ----------
    age_s : float
        Since it was made; 0 where that is not known.
    is_over : bool
        Whether nothing more is to be expected.
    warning : str
        What is wrong; empty if nothing is.
    """

    age_s: float
    is_over: bool
    warning: str


def news_of(state: RunState, updated_utc: str, now: datetime) -> News:
    """Judge how fresh a picture is.

    Parameters
    ----------
    state, updated_utc
        Of the picture; the time is empty where it is not known.
    now : datetime
        The host's calendar.
    """
    age_s = _age_s(updated_utc, now)
    if state.is_over or age_s < SILENT_AFTER_S:
        return News(age_s, state.is_over, "")
    why = "The run's process is there, but it writes nothing: is it busy or stuck, or the disk full?"
    return News(age_s, False, f"No news for {age_text(age_s)}. {why}")


def age_text(age_s: float) -> str:
    """Write an age: "40 s", "12 min", "5 h", "3 days"."""
    if age_s < 120.0:
        return f"{age_s:.0f} s"
    if age_s < 7200.0:
        return f"{age_s / 60.0:.0f} min"
    return f"{age_s / 3600.0:.0f} h" if age_s < 172800.0 else f"{age_s / 86400.0:.0f} days"


def _age_s(updated_utc: str, now: datetime) -> float:
    updated = parsed_utc(updated_utc)
    return max(0.0, (now - updated).total_seconds()) if updated else 0.0


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


@dataclass(frozen=True)
class Cell:
    """A bias and its standard uncertainty; ``count`` dwells stand behind it. Empty text for nothing."""

    bias: str = ""
    sigma: str = ""
    count: int = 0


@dataclass(frozen=True)
class BinTable:
    """Bins of one gyro: their ranges with a cell for each position. No cells: a range that is empty."""

    gyro: str
    unit: str
    positions: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]


@dataclass(frozen=True)
class ShownDwell:
    """A dwell as text, with a cell for each gyro; flagged dwells are in no bin."""

    number: int
    cycle: int
    position: str
    temperature: str
    cells: tuple[Cell, ...]
    flags: str


@dataclass(frozen=True)
class ShownDwells:
    """Dwells, the newest first, and the unit of their biases."""

    unit: str
    rows: tuple[ShownDwell, ...]


def bin_tables(bins: Iterable[FillingBin]) -> list[BinTable]:
    """Bins by gyro, the warmest first; none as long as all are empty."""
    known = list(bins)
    filled = [each for each in known if each.count]
    if not filled:
        return []
    scale = BiasScale.of([each.bias_dph for each in filled], [each.sigma_dph for each in filled])
    return [_bin_table(gyro, [each for each in known if each.gyro == gyro], scale) for gyro in AXES]


def shown_dwells(dwells: Sequence[DwellDone]) -> ShownDwells:
    """Dwells, the newest first."""
    biases = [value for dwell in dwells for value in dwell.bias_dph]
    scale = BiasScale.of(biases, [value for dwell in dwells for value in dwell.sigma_dph])
    return ShownDwells(scale.unit, tuple(_shown_dwell(dwell, scale) for dwell in reversed(dwells)))


def reading_rows(bench: BenchNow) -> list[tuple[str, str, str]]:
    """Present readings: what, value, and how old the instrument's last answer is."""
    chamber, table, ins = (_age(age_s) for age_s in (bench.chamber_age_s, bench.table_age_s, bench.ins_age_s))
    return [
        ("chamber air", celsius(bench.chamber_c, 2), chamber),
        ("chamber set", _set_point(bench.chamber_set_c), chamber),
        ("gyro optics x, y, z", _triple(bench.gyro_c), ins),
        ("electronics x, y, z", _triple(bench.electronics_c), ins),
        ("INS case", celsius(bench.case_c, 2), ins),
        ("INS mode", bench.ins_mode, ins),
        ("table outer axis", _axis(bench.outer_deg, bench.outer_rate_dps), table),
        ("table inner axis", _axis(bench.inner_deg, bench.inner_rate_dps), table),
    ]


def _bin_table(gyro: str, bins: list[FillingBin], scale: BiasScale) -> BinTable:
    used = {each.position for each in bins}
    positions = [position for position in POSITIONS if position in used]
    ranges = by_temperature(bins, lambda each: (each.low_c, each.high_c), lambda each: each.count > 0)
    filled = [number for number, (_, _, members) in enumerate(ranges) if members]
    shown = ranges[filled[0] : filled[-1] + 1] if filled else []
    return BinTable(
        gyro=gyro_label(gyro),
        unit=scale.unit,
        positions=tuple(position_label(position) for position in positions),
        rows=tuple(
            (true_minus(bin_label(low_c, high_c, "…")), _bin_cells(members, positions, scale))
            for low_c, high_c, members in reversed(shown)
        ),
    )


def _bin_cells(members: list[FillingBin], positions: list[str], scale: BiasScale) -> tuple[Cell, ...]:
    """A cell for each position; none for a range that is empty in all of them."""
    by_position = {each.position: each for each in members}
    return tuple(_bin_cell(by_position.get(position), scale) for position in positions) if members else ()


def _bin_cell(each: FillingBin | None, scale: BiasScale) -> Cell:
    if each is None or not each.count:
        return Cell()
    return _cell(each.bias_dph, each.sigma_dph, scale, each.count)


def _cell(bias_dph: float, sigma_dph: float, scale: BiasScale, count: int = 1) -> Cell:
    if not (math.isfinite(bias_dph) and math.isfinite(sigma_dph)):
        return Cell()
    return Cell(true_minus(scale.text(bias_dph)), scale.text(sigma_dph), count)


def _shown_dwell(dwell: DwellDone, scale: BiasScale) -> ShownDwell:
    pairs = zip(dwell.bias_dph, dwell.sigma_dph, strict=True)
    gyro_c = mean_known(dwell.gyro_c)
    return ShownDwell(
        number=dwell.number,
        cycle=dwell.cycle,
        position=position_label(dwell.position),
        temperature="" if math.isnan(gyro_c) else true_minus(f"{gyro_c:z.1f}"),
        cells=tuple(_cell(bias, sigma, scale) for bias, sigma in pairs),
        flags=dwell.flags,
    )


def _set_point(temperature_c: float) -> str:
    return "not controlled" if math.isnan(temperature_c) else celsius(temperature_c, 2)


def _triple(values_c: Iterable[float]) -> str:
    values = list(values_c)
    if all(math.isnan(value) for value in values):
        return "not known"
    return true_minus(", ".join("–" if math.isnan(value) else f"{value:z.2f}" for value in values)) + " °C"


def _axis(angle_deg: float, rate_dps: float) -> str:
    if math.isnan(angle_deg):
        return "not known"
    rate = "" if math.isnan(rate_dps) else f", {rate_dps:z.2f} deg/s"
    return true_minus(f"{angle_deg:z.3f}°{rate}")


def _age(age_s: float) -> str:
    return "never" if math.isnan(age_s) else f"{age_s:.1f} s"


@dataclass(frozen=True)
class ListRow:
    """One run in the list: name and address, state with sign and CSS class, and the rest in a line."""

    name: str
    address: str
    look: str
    sign: str
    state: str
    reason: str
    facts: str


def list_row(run: RunSummary, news: News) -> ListRow:
    """Write a run as text."""
    is_silent = bool(news.warning)
    return ListRow(
        name=run.name,
        address=address_of(run.name),
        look="bad" if is_silent or run.alarms else state_look(run.state),
        sign="▲" if is_silent else SIGNS[run.state],
        state="silent" if is_silent else run.state.value,
        reason=news.warning or run.reason,
        facts=", ".join(_facts(run)),
    )


def unreadable_row(name: str, problem: str) -> ListRow:
    """Write a run that can't be read."""
    return ListRow(name, address_of(name), "bad", "▲", "can't be read", problem, "")


def address_of(name: str) -> str:
    """Address of a run's page, from the page of the list."""
    return f"runs/{quote(name, safe='')}/"


def _facts(run: RunSummary) -> Iterable[str]:
    if run.alarms:
        yield f"▲ {counted(run.alarms, 'alarm').upper()}"
    if run.procedure:
        yield run.procedure
    if run.unit:
        yield f"unit {run.unit}"
    yield (
        f"{run.dwells} of {counted(run.dwell_count, 'dwell')}"
        if run.dwell_count
        else counted(run.dwells, "dwell")
    )
    if run.left_s and not run.state.is_over:
        yield f"{hours_minutes(run.left_s)} h left"
    if run.started_utc:
        yield f"started {run.started_utc[:16].replace('T', ' ')} UTC"
