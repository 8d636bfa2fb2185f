"""Dwell tables and runs of one unit joined to one campaign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np

from gyrobench.bench.closure.campaign import Campaign, Table
from gyrobench.bench.closure.temperature_record import TemperatureRecord
from gyrobench.bench.foundations.arrays import FloatArray, IntArray
from gyrobench.bench.foundations.errors import MeasurementError

#: Time from the end of a table to the power-on of the next one where no common clock is known.
ASSUMED_PAUSE_S = 3600.0
_SAME_S = 1.0
_ON_CLOCK = "on the clock of "


@dataclass(frozen=True)
class TableToJoin:
    """A table or run before it is joined."""

    name: str  #: Its path, for messages.
    campaign: Campaign
    is_run: bool = False  #: A run folder; its times begin with the run.
    began_s: float | None = None  #: Calendar time (UTC) at zero of its clock; None if unknown.

    @property
    def start_s(self) -> float:
        """Start of its first dwell on its own clock."""
        return float(self.campaign.whole.start_s.min())

    @property
    def end_s(self) -> float:
        """End of its last dwell on its own clock."""
        return float(self.campaign.whole.end_s.max())

    @property
    def power_on_s(self) -> float:
        """Power-on before its first dwell, on its own clock."""
        return float(self.campaign.power_on_s[0])

    def is_after(self, other: TableToJoin) -> bool:
        """Whether this is a table that continues another one on the same clock."""
        same = {self.campaign.whole.run_names[0]} & set(other.campaign.whole.run_names)
        known_s = other.campaign.power_on_s if same else np.empty(0)
        is_same_power_cycle = np.any(np.abs(known_s - self.power_on_s) <= _SAME_S)
        begins = is_same_power_cycle or self.power_on_s >= other.end_s - _SAME_S
        return not self.is_run and self.start_s >= other.end_s - 1e-3 and bool(begins)


def join_tables(sources: Sequence[TableToJoin]) -> Campaign:
    """Join tables of one unit on one time axis, with unique numbers of dwells and cycles.

    Runs with a calendar time are placed by it. A table that continues the one before on its clock stays
    there; another one is placed after the one before, :data:`ASSUMED_PAUSE_S` before its power-on.

    Raises MeasurementError if they are of several units, overlap in time, or have dwells in common.
    """
    sources = _ordered(sources)
    first = sources[0]
    for each in sources[1:]:
        if each.campaign.unit != first.campaign.unit:
            raise MeasurementError(
                f"{each.name} is of unit {each.campaign.unit}, {first.name} of unit {first.campaign.unit}. "
                "Search each unit by itself"
            )
    parts: list[Campaign] = []
    tables: list[Table] = []
    shifts_s: list[float] = []
    for index, each in enumerate(sources):
        shift_s, placed = _placed(each, sources[:index], shifts_s)
        part = _shifted(each, shift_s, parts, is_on_clock=placed.startswith(_ON_CLOCK))
        shifts_s.append(shift_s)
        parts.append(part)
        whole = part.whole
        tables.append(
            Table(
                each.name,
                tuple(np.unique(whole.cycle).tolist()),
                int(whole.dwell[0] - each.campaign.whole.dwell[0]),
                float(whole.start_s[0]),
                placed,
            )
        )
    return _together(parts, tables)


def _ordered(sources: Sequence[TableToJoin]) -> list[TableToJoin]:
    """Sources in the order of time if that is known, otherwise as given."""
    began_s = [each.began_s for each in sources if each.began_s is not None]
    if len(began_s) == len(sources):
        return [sources[index] for index in np.argsort(began_s, kind="stable")]
    in_time = sorted(sources, key=lambda each: each.start_s)
    return in_time if all(later.is_after(each) for each, later in pairwise(in_time)) else list(sources)


def _placed(
    source: TableToJoin, before: Sequence[TableToJoin], shifts_s: Sequence[float]
) -> tuple[float, str]:
    """What is added to the times of a source, and how that was found."""
    if not before:
        return 0.0, ""
    for other in before:
        mine, theirs = source.campaign.whole.bias_dph, other.campaign.whole.bias_dph
        common = np.flatnonzero((mine[:, np.newaxis] == theirs).all(axis=2).any(axis=1))
        if len(common):
            raise MeasurementError(
                f"{source.name}: {len(common)} of its dwells, the first is number "
                f"{source.campaign.whole.dwell[common[0]]}, are also in {other.name}. Give each dwell once"
            )
    last, last_shift_s = before[-1], shifts_s[-1]
    end_s = last.end_s + last_shift_s
    for other, other_shift_s in zip(before, shifts_s, strict=True):
        if source.began_s is not None and other.began_s is not None:
            shift_s = other_shift_s + source.began_s - other.began_s
            overlap_s = end_s - source.start_s - shift_s
            if overlap_s > _SAME_S:
                raise MeasurementError(
                    f"{source.name} starts {overlap_s / 3600.0:.2f} h before {last.name} ends. A unit can't "
                    "be in two runs: leave one out"
                )
            return shift_s, "by its calendar time"
    if source.is_after(last):
        return last_shift_s, f"{_ON_CLOCK}{last.name}"
    return end_s + ASSUMED_PAUSE_S - source.power_on_s, f"after {last.name}: it has no common clock with it"


def _shifted(
    source: TableToJoin, shift_s: float, before: Sequence[Campaign], *, is_on_clock: bool
) -> Campaign:
    """Campaign on the common clock, with numbers of dwells and cycles and runs that those before lack."""
    campaign = source.campaign
    whole = campaign.whole
    names: list[str] = list(before[-1].run_names) if before else []
    known_s = np.concatenate([each.power_on_s for each in before]) if before else np.empty(0)
    runs = []
    for index, name in enumerate(whole.run_names):
        on_s = shift_s + float((whole.start_s - whole.since_power_on_s)[whole.run == index].min())
        if name in names and not np.any(np.abs(known_s - on_s) <= _SAME_S):
            name = f"{name} ({source.name})"
        names += [] if name in names else [name]
        runs.append(names.index(name))

    last_cycle = _highest([each.whole.cycle for each in before])
    continues_cycle = is_on_clock and whole.cycle.min() == last_cycle
    moved = replace(
        whole,
        run_names=tuple(names),
        run=np.array(runs)[whole.run],
        dwell=_above(_highest([each.whole.dwell for each in before]), whole.dwell),
        cycle=whole.cycle if continues_cycle else _above(last_cycle, whole.cycle),
        start_s=whole.start_s + shift_s,
        end_s=whole.end_s + shift_s,
        record=replace(whole.record, time_s=whole.record.time_s + shift_s),
    )
    return moved if campaign.part_of is None else moved.part(campaign.part_of[1])


def _highest(used: Sequence[IntArray]) -> float:
    return max((float(each.max()) for each in used), default=-np.inf)


def _above(highest: float, numbers: IntArray) -> IntArray:
    """Numbers, shifted if the first is not above the highest used one."""
    first = int(numbers.min())
    return numbers if first > highest else numbers + int(highest) + 1 - first


def _together(parts: Sequence[Campaign], tables: Sequence[Table]) -> Campaign:
    wholes = [each.whole for each in parts]
    arrays: dict[str, Any] = {
        each.name: np.concatenate([getattr(whole, each.name) for whole in wholes])
        for each in fields(Campaign)
        if each.name != "azimuth_deg" and isinstance(getattr(wholes[0], each.name), np.ndarray)
    }
    together = replace(
        wholes[-1],
        **arrays,
        position=tuple(name for whole in wholes for name in whole.position),
        record=TemperatureRecord.joined([whole.record for whole in wholes]),
        azimuth_deg=np.concatenate([_known(whole, whole.azimuth_deg) for whole in wholes]),
        columns={
            name: np.concatenate([_known(whole, whole.columns.get(name)) for whole in wholes])
            for name in dict.fromkeys(name for whole in wholes for name in whole.columns)
        },
        without_temperatures=tuple(
            number + table.added
            for whole, table in zip(wholes, tables, strict=True)
            for number in whole.without_temperatures
        ),
        tables=tuple(tables),
    )
    good = np.concatenate(
        [np.ones(len(each), dtype=bool) if each.part_of is None else each.part_of[1] for each in parts]
    )
    return together if good.all() else together.part(good)


def _known(whole: Campaign, values: FloatArray | None) -> FloatArray:
    return np.full(len(whole), np.nan) if values is None else values
