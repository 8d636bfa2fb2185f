"""Plateaus of several runs of one procedure, paired by what they are.

A run may lack what another measured: a dwell has flags, an operator skipped it, a power cycle divides a
plateau. So plateaus are not paired by their number within a run. The number of a dwell in the plan, its cycle
and its set point are the same in all runs. Dwells of all runs are therefore grouped together, by the rules of
:mod:`gyrobench.bench.bias.plateaus`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from gyrobench.bench.bias.plateaus import (
    MAX_FROM_MEAN_K,
    PlannedDwell,
    PlateauMember,
    group_plateaus,
    set_point_c,
)


class NumberedDwell(PlateauMember, Protocol):
    """A dwell of a run."""

    @property
    def dwell(self) -> int:
        """Number of the dwell in the plan."""

    @property
    def flags(self) -> tuple[str, ...]:
        """What was wrong; empty where nothing was."""


@dataclass(frozen=True)
class PlateauPlace:
    """A plateau of one run: what it is paired by."""

    cycle: int
    chamber_set_c: float | None  #: None or NaN where the chamber had no set point.
    gyro_c: float  #: Mean temperature of the gyros.


_Dwell = TypeVar("_Dwell", bound=NumberedDwell)
#: The same dwell of the plan in several runs: number, cycle and set point.
_Key = tuple[int, int, float | None]


def pair_dwells(runs: Sequence[Iterable[_Dwell]]) -> list[list[list[_Dwell]]]:
    """Group the dwells of all runs by plateau.

    Returns, for each plateau in the order of the plan, the dwells without flags of each run; empty where a
    run has none. Those with flags count in the grouping, so that a plateau is neither divided nor joined to
    the next one by them. Gyros that differ by more than 5 K between two runs are at two plateaus. A power
    cycle in one run divides the plateau in all runs: each begins with another constant.
    """
    by_key = [{_key(each): each for each in sorted(run, key=lambda each: each.dwell)} for run in runs]
    plateaus: list[list[list[_Dwell]]] = []
    for group in group_plateaus(_joint(by_key)):
        keys = [_key(each) for each in group]
        members = [[run[key] for key in keys if key in run and not run[key].flags] for run in by_key]
        plateaus += _by_temperature(members)
    return plateaus


def _key(each: NumberedDwell | PlannedDwell) -> _Key:
    return each.dwell, each.cycle, set_point_c(each.chamber_set_c)


def _joint(runs: Sequence[dict[_Key, _Dwell]]) -> list[PlannedDwell]:
    """Each dwell that any run has, with its mean gyro temperature over the runs."""
    power_cycle = 0
    last = [""] * len(runs)
    found = []
    for key in sorted({key for run in runs for key in run}, key=lambda key: key[0]):
        mine = {index: run[key] for index, run in enumerate(runs) if key in run}
        power_cycle += any(last[index] not in ("", each.run) for index, each in mine.items())
        for index, each in mine.items():
            last[index] = each.run
        number, cycle, set_c = key
        gyro_c = _mean(_gyro_c([each]) for each in mine.values())
        found.append(
            PlannedDwell(
                dwell=number,
                cycle=cycle,
                position="",
                chamber_set_c=math.nan if set_c is None else set_c,
                gyro_c=(gyro_c, gyro_c, gyro_c),
                run=str(power_cycle),
            )
        )
    return found


def _by_temperature(members: Sequence[list[_Dwell]]) -> list[list[list[_Dwell]]]:
    """Divide a plateau where the gyros of some runs are more than 5 K from those of the others."""
    groups: list[list[int]] = []
    temperatures_c = [_gyro_c(each) for each in members]
    for index, each in enumerate(members):
        if not each:
            continue
        for group in groups:
            mean_c = _mean(temperatures_c[other] for other in group)
            if not abs(temperatures_c[index] - mean_c) > MAX_FROM_MEAN_K:
                group.append(index)
                break
        else:
            groups.append([index])
    return [[each if index in group else [] for index, each in enumerate(members)] for group in groups]


def pair_places(runs: Sequence[Sequence[PlateauPlace]]) -> list[list[int]]:
    """Pair plateaus of which only cycle, set point and temperature are known.

    Returns the number, from 1, of each plateau of each run in the joint order. Plateaus with one number have
    the cycle, the set point, and gyro temperatures within 5 K in common, and the order of all runs is kept.
    """
    joint: list[PlateauPlace] = []
    indices: list[list[int]] = []
    for run in runs:
        mine: list[int] = []
        for place in run:
            begin = mine[-1] + 1 if mine else 0
            fits = [index for index in range(begin, len(joint)) if _is_same(place, joint[index])]
            found = min(fits, key=lambda index: abs(joint[index].gyro_c - place.gyro_c), default=-1)
            if found < 0:
                found = begin
                joint.insert(found, place)
                indices = [[each + (each >= found) for each in other] for other in indices]
            mine.append(found)
        indices.append(mine)
    return [[each + 1 for each in mine] for mine in indices]


def _is_same(one: PlateauPlace, other: PlateauPlace) -> bool:
    return (
        one.cycle == other.cycle
        and set_point_c(one.chamber_set_c) == set_point_c(other.chamber_set_c)
        and not abs(one.gyro_c - other.gyro_c) > MAX_FROM_MEAN_K
    )


def in_all(runs: Sequence[Iterable[int]]) -> set[int]:
    """Numbers of the dwells that all runs have which have any: these are comparable."""
    measured = [set(each) for each in runs]
    return set.intersection(*(each for each in measured if each)) if any(measured) else set()


def _gyro_c(dwells: Iterable[NumberedDwell]) -> float:
    return _mean(each for dwell in dwells for each in dwell.gyro_c)


def _mean(values: Iterable[float]) -> float:
    """Mean of what is known; NaN without any."""
    known = [each for each in values if math.isfinite(each)]
    return math.fsum(known) / len(known) if known else math.nan
