"""Pairs the plateaus of several runs of one procedure.

A run may lack dwells of another: a dwell has flags, an operator skipped it, a power cycle divides a plateau.
Plateaus are therefore not paired by their number within a run. The number of a dwell in the plan, its cycle
and its set point are the same in all runs, so the dwells of all runs are grouped together by the rules of
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
        """Reasons why the dwell is not valid; empty if it is."""


@dataclass(frozen=True)
class PlateauProperties:
    """Properties of a plateau of one run by which it is paired."""

    cycle: int
    chamber_set_c: float | None  #: None or NaN if the chamber had no set point.
    gyro_c: float  #: Mean temperature of the gyros.


_Dwell = TypeVar("_Dwell", bound=NumberedDwell)
#: Key of a dwell of the plan, equal in all runs: number, cycle and set point.
_Key = tuple[int, int, float | None]


def pair_dwells(runs: Sequence[Iterable[_Dwell]]) -> list[list[list[_Dwell]]]:
    """Group the dwells of all runs by plateau.

    Returns, for each plateau in the order of the plan, the dwells without flags of each run; an empty list if
    a run has none. Dwells with flags take part in the grouping, so that they neither divide a plateau nor
    join it to the next one. If the gyro temperatures of two runs differ by more than 5 K, they are at two
    plateaus. A power cycle in one run divides the plateau in all runs, since the constant of the bias
    changes.
    """
    by_key = [{_key(each): each for each in sorted(run, key=lambda each: each.dwell)} for run in runs]
    plateaus: list[list[list[_Dwell]]] = []
    for group in group_plateaus(_joint_dwells(by_key)):
        keys = [_key(each) for each in group]
        members = [[run[key] for key in keys if key in run and not run[key].flags] for run in by_key]
        plateaus += _split_by_temperature(members)
    return plateaus


def _key(each: NumberedDwell | PlannedDwell) -> _Key:
    return each.dwell, each.cycle, set_point_c(each.chamber_set_c)


def _joint_dwells(runs: Sequence[dict[_Key, _Dwell]]) -> list[PlannedDwell]:
    """All dwells that any run has, with the mean gyro temperature over the runs."""
    power_cycle = 0
    last = [""] * len(runs)
    planned = []
    for key in sorted({key for run in runs for key in run}, key=lambda key: key[0]):
        by_run = {index: run[key] for index, run in enumerate(runs) if key in run}
        power_cycle += any(last[index] not in ("", each.run) for index, each in by_run.items())
        for index, each in by_run.items():
            last[index] = each.run
        number, cycle, set_c = key
        gyro_c = _mean(_gyro_c([each]) for each in by_run.values())
        planned.append(
            PlannedDwell(
                dwell=number,
                cycle=cycle,
                position="",
                chamber_set_c=math.nan if set_c is None else set_c,
                gyro_c=(gyro_c, gyro_c, gyro_c),
                run=str(power_cycle),
            )
        )
    return planned


def _split_by_temperature(members: Sequence[list[_Dwell]]) -> list[list[list[_Dwell]]]:
    """Divide a plateau if the gyro temperatures of some runs differ by more than 5 K from the others."""
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


def pair_plateaus(runs: Sequence[Sequence[PlateauProperties]]) -> list[list[int]]:
    """Pair plateaus by cycle, set point and temperature only.

    Returns the number, from 1, of each plateau of each run in the joint order. Plateaus with the same number
    have the same cycle and set point, and gyro temperatures within 5 K; the order of each run is kept.
    """
    joint: list[PlateauProperties] = []
    indices: list[list[int]] = []
    for run in runs:
        run_indices: list[int] = []
        for plateau in run:
            begin = run_indices[-1] + 1 if run_indices else 0
            candidates = [index for index in range(begin, len(joint)) if _is_same(plateau, joint[index])]
            match = min(candidates, key=lambda index: abs(joint[index].gyro_c - plateau.gyro_c), default=-1)
            if match < 0:
                match = begin
                joint.insert(match, plateau)
                indices = [[each + (each >= match) for each in other] for other in indices]
            run_indices.append(match)
        indices.append(run_indices)
    return [[each + 1 for each in run_indices] for run_indices in indices]


def _is_same(plateau: PlateauProperties, other: PlateauProperties) -> bool:
    return (
        plateau.cycle == other.cycle
        and set_point_c(plateau.chamber_set_c) == set_point_c(other.chamber_set_c)
        and not abs(plateau.gyro_c - other.gyro_c) > MAX_FROM_MEAN_K
    )


def comparable_dwells(runs: Sequence[Iterable[int]]) -> set[int]:
    """Numbers of the comparable dwells: those in all runs that have any dwells."""
    measured = [set(each) for each in runs]
    return set.intersection(*(each for each in measured if each)) if any(measured) else set()


def _gyro_c(dwells: Iterable[NumberedDwell]) -> float:
    return _mean(each for dwell in dwells for each in dwell.gyro_c)


def _mean(values: Iterable[float]) -> float:
    """Mean of the finite values; NaN without any."""
    finite = [each for each in values if math.isfinite(each)]
    return math.fsum(finite) / len(finite) if finite else math.nan
