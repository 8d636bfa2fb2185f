"""The temperatures and positions of a procedure, which an adaptive campaign has to determine as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.planned_campaign import UnitProperties, planned_campaign
from gyrobench.bench.foundations.arrays import S_PER_H, FloatArray
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.investigation.blocks import BlockKind, BlockStart, Timeline
from gyrobench.bench.investigation.choice import Rival
from gyrobench.bench.investigation.external_bench import BlockPlan
from gyrobench.bench.procedure.plan import Plan

#: Dwells of a block at one temperature, in those of the table.
_LONG = 2.0


@dataclass(frozen=True)
class Visit:
    """The dwells of a procedure at one set point, in order."""

    set_c: float  #: Set point of the chamber.
    positions: tuple[str, ...]  #: Of the dwells.
    wait_h: float  #: From the dwell before, or from the begin, to the first of them: ramp and soak.


@dataclass(frozen=True)
class Profile:
    """What a procedure measures, and in which time."""

    visits: tuple[Visit, ...]  #: In the order of time.
    ramp_c_per_h: float  #: Its fastest ramp.
    duration_h: float  #: Of the whole procedure.
    pause_h: float  #: From the end of a dwell to the start of the next one at the same set point.

    @classmethod
    def of(cls, plan: Plan) -> Profile:
        """The profile of a plan.

        Raises DocumentError if it has fewer than two temperatures, and MeasurementError without dwells.
        """
        campaign = planned_campaign(plan, UnitProperties())
        waits_h = (campaign.start_s - np.append(0.0, campaign.end_s[:-1])) / S_PER_H
        visits = []
        places = zip(campaign.cycle.tolist(), campaign.set_c.tolist(), range(len(campaign)), strict=True)
        for (_, set_c), members in groupby(places, key=lambda each: each[:2]):
            own = [index for *_, index in members]
            visits.append(Visit(set_c, tuple(campaign.position[each] for each in own), waits_h[own[0]]))
        if len({each.set_c for each in visits if np.isfinite(each.set_c)}) < 2:
            raise DocumentError(
                f"{plan.procedure.procedure}: has fewer than two temperatures. Leave --adaptive out"
            )
        ramps = [each.after.ramp_c_per_s for each in plan.steps]
        return cls(tuple(visits), max(ramps) * S_PER_H, plan.duration_s / S_PER_H, float(np.median(waits_h)))

    @property
    def set_points_c(self) -> list[float]:
        """Each temperature, the highest first."""
        return sorted({each.set_c for each in self.visits}, reverse=True)

    @property
    def positions(self) -> list[str]:
        """Each position, in the order of the procedure."""
        return list(dict.fromkeys(position for each in self.visits for position in each.positions))

    @property
    def opening(self) -> tuple[tuple[float, ...], ...]:
        """Set points of the cycles of the first campaign: extremes and middle, and the lowest again.

        At the lowest, effects of gravity and temperature are largest, and the next block can stay there.
        """
        points = self.set_points_c
        middle = points[1:-1][len(points) // 2 - 1 : len(points) // 2]
        return (points[-1], points[0], *middle), (points[-1],)

    @cached_property
    def means(self) -> FloatArray:
        """Means over the n dwells of each of m set points and positions, gyro by gyro, (3 m, 3 n)."""
        places = [(each.set_c, position) for each in self.visits for position in each.positions]
        found = np.array([[one == other for other in places] for one in dict.fromkeys(places)], dtype=float)
        return np.kron(np.eye(3), found / found.sum(axis=1, keepdims=True))

    def kinds(self) -> list[BlockKind]:
        """Blocks of dwells at each temperature, which begin when the ramp ends and last while it settles."""

        def leg(to_c: float, length: float) -> Any:
            def add(timeline: Timeline) -> None:
                timeline.ramp(to_c, self.ramp_c_per_h / timeline.times.ramp_c_per_h)
                timeline.dwells(self.positions[:: -1 if timeline.next_cycle % 2 else 1], length=length)

            return add

        return [
            BlockKind(
                f"{words} at {to_c:g} degC",
                f"measure all positions at {to_c:g} degC{more}",
                leg(to_c, length),
            )
            for to_c in self.set_points_c
            for words, more, length in (
                ("dwells", " without a soak", 1.0),
                ("long dwells", " in long dwells", _LONG),
            )
        ]

    def whole(self, rows: Sequence[DwellRow], start: BlockStart | None) -> BlockPlan:
        """The procedure measured after these dwells, from a power-on."""
        timeline = Timeline(rows, start=start)
        timeline.off_and_on()
        for visit in self.visits:
            before_s = timeline.now_s
            timeline.ramp(visit.set_c, self.ramp_c_per_h / timeline.times.ramp_c_per_h)
            spent_h = (timeline.now_s - before_s) / S_PER_H
            timeline.soak(max(visit.wait_h - spent_h, self.pause_h))
            for position in visit.positions:
                timeline.dwells([position])
                timeline.soak(self.pause_h)
        return timeline.plan()


@dataclass(frozen=True)
class ProfileCalibration:
    """What the dwells determine of the biases of a profile, for each of k hypotheses.

    There is one bias for each gyro, set point and position, m in all: the mean of its dwells.
    """

    profile: Profile
    whole: tuple[DwellRow, ...]  #: The dwells of the profile, as if they were measured next.
    rivals: tuple[Rival, ...]  #: The k hypotheses.
    variances: FloatArray  #: Shape (k, m), (deg/h)^2.
    #: Shape (k, m). If the whole procedure had been measured in place of these dwells.
    reference: FloatArray

    @property
    def ratio(self) -> float:
        """Largest ratio, of the gyros, of the rms standard uncertainty to that by the whole procedure."""
        return float(self._precision(self.variances) ** -0.5)

    def missing_h(self, variances: FloatArray) -> float:
        """Hours of the procedure that are missing with some variances of the biases.

        Precision grows with the hours; none is wanted beyond that by the whole procedure.
        """
        return self.profile.duration_h * max(1.0 - self._precision(variances), 0.0)

    def _precision(self, variances: FloatArray) -> float:
        """Precision of the biases of the least certain gyro, over that by the whole procedure."""
        probabilities = np.array([each.probability for each in self.rivals])
        own, whole = (
            (probabilities @ each).reshape(3, -1).mean(axis=1) for each in (variances, self.reference)
        )
        return float(np.min(whole / own))
