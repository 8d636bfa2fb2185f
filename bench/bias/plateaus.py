"""Plateaus: all dwells at one chamber set point in one cycle.

The dwells of a plateau share the power cycle, the cycle of the temperature profile, the commanded set point
of the chamber and the temperature of the gyros. They follow one another: a set point that the same cycle
visits again is another plateau, since the unit has another thermal history there.

The set point alone does not make a plateau, for a procedure may measure while the chamber still ramps to
it. Dwells on a ramp are therefore grouped by the measured temperature of the gyros, and so are dwells
without a known set point: a dwell opens the next plateau where the mean temperature of its gyros is more
than 5 K from the mean of the plateau so far. After a soak, gyros drift by less.
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
#: The same for planned dwells, whose temperatures are estimates: those that belong together for certain.
MAX_PLANNED_FROM_MEAN_K = 3.0


class AtSetPoint(Protocol):
    """A dwell and what the bench commanded; NaN or None where not known."""

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
    """What decides on which plateau a dwell is; NaN where not known."""

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
    chamber_set_c: float  #: Set point of the chamber; NaN where nothing sets it.
    gyro_c: tuple[float, float, float]  #: Expected temperatures of the gyros; NaN where not known.
    run: str = ""


def group_plateaus(
    dwells: Iterable[_Member], max_from_mean_k: float = MAX_FROM_MEAN_K
) -> list[list[_Member]]:
    """Group dwells, in the order of time, by plateau. Temperatures that are not known divide nothing."""
    plateaus: list[list[_Member]] = []
    for _, group in itertools.groupby(dwells, plateau_key):
        means_c: list[float] = []
        for number, dwell in enumerate(group):
            known = [each for each in means_c if math.isfinite(each)]
            mean = _mean_c(dwell)
            if not number or (known and abs(mean - sum(known) / len(known)) > max_from_mean_k):
                plateaus.append([])
                means_c = []
            plateaus[-1].append(dwell)
            means_c.append(mean)
    return plateaus


def passes_of_plateaus(plateaus: Iterable[Sequence[DwellRow]], axis: int) -> list[list[Sequence[DwellRow]]]:
    """Group plateaus of several cycles that have set point, temperature and some position in common."""
    groups: list[list[Sequence[DwellRow]]] = []
    for plateau in plateaus:
        together = [plateau]
        apart = []
        for group in groups:
            if any(_is_same(plateau, other, axis) for other in group):
                together = group + together
            else:
                apart.append(group)
        groups = [*apart, together]
    return groups


def mean_c(plateau: Sequence[DwellRow], axis: int) -> float:
    """Mean temperature of a gyro over a plateau, degC."""
    return math.fsum(row.gyro_c[axis] for row in plateau) / len(plateau)


def plateau_key(dwell: AtSetPoint) -> tuple[str, int, float | None]:
    """What all dwells of a plateau share: power cycle, cycle and set point."""
    return dwell.run, dwell.cycle, set_point_c(dwell.chamber_set_c)


def set_point_c(set_c: float | None) -> float | None:
    """Commanded set point to 1 mK, degC: means of one may differ by their rounding. None where not known."""
    return None if set_c is None or math.isnan(set_c) else round(set_c, 3) + 0.0


def _mean_c(dwell: PlateauMember) -> float:
    """Mean temperature of the gyros that have one; NaN without any."""
    known = [each for each in dwell.gyro_c if math.isfinite(each)]
    return sum(known) / len(known) if known else math.nan


def _is_same(one: Sequence[DwellRow], other: Sequence[DwellRow], axis: int) -> bool:
    return (
        set_point_c(one[0].chamber_set_c) == set_point_c(other[0].chamber_set_c)
        and abs(mean_c(one, axis) - mean_c(other, axis)) <= MAX_FROM_MEAN_K
        and not {row.position for row in one}.isdisjoint(row.position for row in other)
    )
