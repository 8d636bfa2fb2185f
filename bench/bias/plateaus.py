"""Plateaus: all dwells at one chamber set point in one cycle.

The dwells of a plateau share the power cycle, the cycle of the temperature profile, the commanded set point
of the chamber and the temperature of the gyros. They follow one another: a set point that the same cycle
visits again is another plateau, since the unit has another thermal history there.

The set point alone does not define a plateau, since a procedure may measure while the chamber still ramps to
it. Therefore dwells are also grouped by the measured temperature of the gyros: a dwell begins the next
plateau if the mean temperature of its gyros differs by more than 5 K from the mean of the plateau so far.
After a soak, gyros drift by less.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from gyrobench.bench.bias.dwell_table import DwellRow

#: Largest difference of a dwell's gyro temperature from the mean of its plateau, K.
MAX_FROM_MEAN_K = 5.0
#: The same for planned dwells; smaller, since their temperatures are estimates.
MAX_PLANNED_FROM_MEAN_K = 3.0


class AtSetPoint(Protocol):
    """Power cycle, cycle and commanded set point of a dwell; NaN or None if not known."""

    @property
    def run(self) -> str:
        """Power cycle of the unit."""

    @property
    def cycle(self) -> int:
        """Cycle of the temperature profile."""

    @property
    def chamber_set_c(self) -> float | None:
        """Set point of the chamber, degC."""


class PlateauMember(AtSetPoint, Protocol):
    """Properties of a dwell that determine its plateau; NaN if not known."""

    @property
    def gyro_c(self) -> tuple[float, float, float]:
        """Mean temperatures of the gyros, degC."""


_Member = TypeVar("_Member", bound=PlateauMember)


@dataclass(frozen=True)
class PlannedDwell:
    """A dwell that a run is to measure."""

    #: dwell, cycle, position: As in :class:`gyrobench.bench.bias.dwell_table.DwellRow`.
    dwell: int
    cycle: int
    position: str
    chamber_set_c: float  #: Set point of the chamber; NaN if there is none.
    gyro_c: tuple[float, float, float]  #: Expected temperatures of the gyros; NaN if not known.
    run: str = ""


def group_plateaus(
    dwells: Iterable[_Member], max_from_mean_k: float = MAX_FROM_MEAN_K
) -> list[list[_Member]]:
    """Group dwells, in the order of time, by plateau; unknown temperatures do not begin a plateau."""
    plateaus: list[list[_Member]] = []
    for _, group in itertools.groupby(dwells, plateau_key):
        means_c: list[float] = []
        for index, dwell in enumerate(group):
            known_c = [each for each in means_c if math.isfinite(each)]
            mean = _mean_c(dwell)
            if not index or (known_c and abs(mean - sum(known_c) / len(known_c)) > max_from_mean_k):
                plateaus.append([])
                means_c = []
            plateaus[-1].append(dwell)
            means_c.append(mean)
    return plateaus


def passes_of_plateaus(plateaus: Iterable[Sequence[DwellRow]], axis: int) -> list[list[Sequence[DwellRow]]]:
    """Group plateaus of several cycles with equal set point and temperature and a position in common."""
    groups: list[list[Sequence[DwellRow]]] = []
    for plateau in plateaus:
        merged = [plateau]
        separate = []
        for group in groups:
            if any(_are_passes_of_one(plateau, each, axis) for each in group):
                merged = group + merged
            else:
                separate.append(group)
        groups = [*separate, merged]
    return groups


def mean_c(plateau: Sequence[DwellRow], axis: int) -> float:
    """Mean temperature of a gyro over a plateau, degC."""
    return math.fsum(row.gyro_c[axis] for row in plateau) / len(plateau)


def plateau_key(dwell: AtSetPoint) -> tuple[str, int, float | None]:
    """Key of the plateau of a dwell: power cycle, cycle and set point."""
    return dwell.run, dwell.cycle, set_point_c(dwell.chamber_set_c)


def set_point_c(set_c: float | None) -> float | None:
    """Commanded set point rounded to 1 mK, degC, since means may differ by rounding; None if not known."""
    return None if set_c is None or math.isnan(set_c) else round(set_c, 3) + 0.0


def _mean_c(dwell: PlateauMember) -> float:
    """Mean of the known gyro temperatures; NaN without any."""
    known_c = [each for each in dwell.gyro_c if math.isfinite(each)]
    return sum(known_c) / len(known_c) if known_c else math.nan


def _are_passes_of_one(first: Sequence[DwellRow], second: Sequence[DwellRow], axis: int) -> bool:
    return (
        set_point_c(first[0].chamber_set_c) == set_point_c(second[0].chamber_set_c)
        and abs(mean_c(first, axis) - mean_c(second, axis)) <= MAX_FROM_MEAN_K
        and not {row.position for row in first}.isdisjoint(row.position for row in second)
    )
