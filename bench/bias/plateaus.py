"""Dwells by stop: what a gyro's bias in one position can be compared with.

A stop is one stay of the chamber at one set point in one power-on and cycle of a run, or the part of a ramp
in which the gyros stay as warm. All that changes from one power-on, cycle or leg to the next is the same
for its dwells.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from gyrobench.bench.bias.dwell_table import DwellRow

#: Gyros of one stop differ by this much at most, K. Settled ones come to some 5 K.
COMPARED_WITHIN_C = 8.0
#: The same for dwells that are only planned, with temperatures known less well, K.
PLANNED_WITHIN_C = 5.0


class _Dwell(Protocol):
    """What tells the stop of a dwell."""

    @property
    def run(self) -> str: ...

    @property
    def cycle(self) -> int: ...

    @property
    def chamber_set_c(self) -> float: ...

    @property
    def gyro_c(self) -> tuple[float, float, float]: ...


_D = TypeVar("_D", bound=_Dwell)


@dataclass(frozen=True)
class PlannedDwell:
    """A dwell that a run is to measure.

    Attributes
    ----------
    dwell, cycle, position
        As in :class:`gyrobench.bench.bias.dwell_table.DwellRow`.
    chamber_set_c : float
        Set point of the chamber; NaN where nothing sets it.
    gyro_c : tuple of float
        Temperatures that the gyros are expected to have; NaN where not known.
    """

    dwell: int
    cycle: int
    position: str
    chamber_set_c: float
    gyro_c: tuple[float, float, float]
    run: str = ""


def group_stops(dwells: Iterable[_D], within_c: float) -> list[list[_D]]:
    """Group dwells, in the order of time, by stop of the chamber.

    A stop is one power-on, cycle and set point in a row, with the temperatures of each gyro within a range.
    Temperatures that are not known count as near.
    """
    keys = itertools.groupby(dwells, lambda dwell: (dwell.run, dwell.cycle, _set_point(dwell)))
    return [part for _, group in keys for part in _equally_warm(group, within_c)]


def passes_of_stops(stops: Iterable[Sequence[DwellRow]], axis: int) -> list[list[Sequence[DwellRow]]]:
    """Put stops together that are passes of the same one: set point, warmth and some position in common."""
    groups: list[list[Sequence[DwellRow]]] = []
    for stop in stops:
        together = [stop]
        apart = []
        for group in groups:
            if any(_is_same(stop, other, axis) for other in group):
                together = group + together
            else:
                apart.append(group)
        groups = [*apart, together]
    return groups


def mean_c(stop: Sequence[DwellRow], axis: int) -> float:
    """Mean temperature of a gyro over a stop, degC."""
    return math.fsum(row.gyro_c[axis] for row in stop) / len(stop)


def _equally_warm(dwells: Iterable[_D], within_c: float) -> Iterator[list[_D]]:
    stop: list[_D] = []
    for dwell in dwells:
        if not all(_is_near(dwell, other, within_c) for other in stop):
            yield stop
            stop = []
        stop.append(dwell)
    if stop:
        yield stop


def _set_point(dwell: _Dwell) -> str:
    """Set point as a key: means of the same one may differ by their rounding, and NaN differs from itself."""
    return f"{round(dwell.chamber_set_c, 3) + 0.0:.3f}"


def _is_near(one: _Dwell, other: _Dwell, within_c: float) -> bool:
    return not any(abs(a - b) > within_c for a, b in zip(one.gyro_c, other.gyro_c, strict=True))


def _is_same(one: Sequence[DwellRow], other: Sequence[DwellRow], axis: int) -> bool:
    return (
        _set_point(one[0]) == _set_point(other[0])
        and abs(mean_c(one, axis) - mean_c(other, axis)) <= COMPARED_WITHIN_C
        and not {row.position for row in one}.isdisjoint(row.position for row in other)
    )
