"""What the units on one table share: its axes, the chamber's air, and the heat that they give each other."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.drivers.emulators.world.chamber_air import ChamberAir, ChamberParameters
from gyrobench.drivers.emulators.world.table_axis import AxisParameters, TableAxis
from gyrobench.drivers.emulators.world.world_file import NeighbourHeating, WorldFile

OUTER, INNER = 1, 2
_AXIS_KEYS = {"rate_limit_dps", "acceleration_limit_dps2", "jerk_limit_dps3", "position_error_arcsec"}


class AirSeconds(NamedTuple):
    """The air at one unit in n successive seconds."""

    air_c: FloatArray  #: Shape (n,). Temperature of the air around the unit.
    duty: FloatArray  #: Shape (n,). Share of the time that the chamber's compressor runs.
    #: Shape (n,). What the neighbours' heat adds to the chamber's temperature there, K.
    neighbours_k: FloatArray


class Surroundings:
    """Table and chamber around the units, from ``start_s``, a whole second.

    Each unit joins once and then takes the air of every second. Units are advanced when their output is
    needed, each to another time; all of them before the table's motion changes, and by the caller before the
    supply of any of them is switched.
    """

    def __init__(self, file: WorldFile, start_s: int) -> None:
        parameters = AxisParameters(**file.table.model_dump(include=_AXIS_KEYS))
        #: The table's axes: 1 outer, 2 inner.
        self.axes = {number: TableAxis(parameters) for number in (OUTER, INNER)}
        self.air = ChamberAir(ChamberParameters(**file.chamber.model_dump()))  #: The chamber.
        self.air_s = start_s  #: Time that the chamber's air has reached.
        self.dissipated_w: dict[int, float] = {}  #: Heat of each unit at present, by its number.
        self._start_s = start_s
        self._heating = file.neighbour_heating
        self._courses: list[deque[tuple[float, float]]] = []
        self._advance: list[Callable[[float], None]] = []
        for axis in self.axes.values():
            axis.before_motion = self._before_motion

    def join(self, number: int, advance: Callable[[float], None]) -> UnitAir:
        """Give the unit of that number its air; before it joins, the air was as at present.

        ``advance`` advances the unit to a time.
        """
        self._advance.append(advance)
        present = self.air.air_c, self.air.compressor_duty
        course = deque([present] * (self.air_s - self._start_s))
        self._courses.append(course)
        return UnitAir(self, course, [each for each in self._heating if each.to_unit == number])

    def step_air(self, seconds: int) -> None:
        """Advance the chamber's air to that time."""
        while self.air_s < seconds:
            self.air_s += 1
            self.air.step(1.0)
            second = self.air.air_c, self.air.compressor_duty
            for course in self._courses:
                course.append(second)

    def _before_motion(self, now_s: float) -> None:
        for advance in self._advance:
            advance(math.floor(now_s))


class UnitAir:
    """The air around one unit."""

    def __init__(
        self,
        surroundings: Surroundings,
        course: deque[tuple[float, float]],
        heating: Sequence[NeighbourHeating],
    ) -> None:
        self._surroundings = surroundings
        self._course = course  # seconds that the unit has not taken yet
        self._heating = heating
        self._added_k = [0.0] * len(heating)

    def take(self, seconds: int) -> AirSeconds:
        """Air of the next seconds, to which the surroundings have been advanced."""
        air_c, duty = np.array([self._course.popleft() for _ in range(seconds)]).T
        if not self._heating:
            return AirSeconds(air_c, duty, np.zeros(seconds))
        added_k = np.zeros(seconds)
        for place, each in enumerate(self._heating):
            final_k = each.coupling_k_per_w * self._surroundings.dissipated_w.get(each.from_unit, 0.0)
            decay = np.exp(-np.arange(1, seconds + 1) / each.time_constant_s)
            course_k = final_k + (self._added_k[place] - final_k) * decay
            self._added_k[place] = float(course_k[-1])
            added_k += course_k
        return AirSeconds(air_c + added_k, duty, added_k)
