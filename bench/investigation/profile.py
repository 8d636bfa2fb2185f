"""Temperatures and positions of a procedure at which an adaptive campaign must also determine the biases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import groupby

import numpy as np

from gyrobench.bench.bias.dwell_table import DwellRow
from gyrobench.bench.closure.planned_campaign import UnitProperties, planned_campaign
from gyrobench.bench.foundations.arrays import S_PER_H, FloatArray
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.investigation.blocks import BlockKind, BlockStart, Timeline
from gyrobench.bench.investigation.choice import Rival
from gyrobench.bench.investigation.external_bench import BlockPlan
from gyrobench.bench.procedure.plan import Plan

#: Length of long dwells relative to those of the table.
_LONG = 2.0


@dataclass(frozen=True)
class Visit:
    """The dwells of a procedure at one set point, in order."""

    set_c: float  #: Set point of the chamber.
    positions: tuple[str, ...]  #: Positions of the dwells.
    wait_h: float  #: Time from the previous dwell, or from the start, to the first dwell: ramp and soak.


@dataclass(frozen=True)
class Profile:
    """Temperatures, positions and times of a procedure's dwells."""

    visits: tuple[Visit, ...]  #: In the order of time.
    ramp_c_per_h: float  #: Its fastest ramp.
    duration_h: float  #: Duration of the whole procedure.
    pause_h: float  #: Time from the end of a dwell to the start of the next one at the same set point.

    @classmethod
    def of(cls, plan: Plan) -> Profile:
        """Profile of a plan.

        Raises DocumentError if it has fewer than two temperatures, and MeasurementError without dwells.
        """
        campaign = planned_campaign(plan, UnitProperties())
        waits_h = (campaign.start_s - np.append(0.0, campaign.end_s[:-1])) / S_PER_H
        visits = []
        dwell_keys = zip(campaign.cycle.tolist(), campaign.set_c.tolist(), range(len(campaign)), strict=True)
        for (_, set_c), members in groupby(dwell_keys, key=lambda each: each[:2]):
            indices = [index for *_, index in members]
            visits.append(
                Visit(set_c, tuple(campaign.position[each] for each in indices), waits_h[indices[0]])
            )
        if len({each.set_c for each in visits if np.isfinite(each.set_c)}) < 2:
            raise DocumentError(
                f"{plan.procedure.procedure}: has fewer than two temperatures. Leave --adaptive out"
            )
        ramps = [each.after.ramp_c_per_s for each in plan.steps]
        return cls(tuple(visits), max(ramps) * S_PER_H, plan.duration_s / S_PER_H, float(np.median(waits_h)))

    @property
    def set_points_c(self) -> list[float]:
        """Distinct set points, highest first."""
        return sorted({each.set_c for each in self.visits}, reverse=True)

    @property
    def positions(self) -> list[str]:
        """Distinct positions in the order of the procedure."""
        return list(dict.fromkeys(position for each in self.visits for position in each.positions))

    @property
    def opening(self) -> tuple[tuple[float, ...], ...]:
        """Set points of the cycles of the first campaign: extremes and middle, then the lowest again.

        At the lowest temperature the effects of gravity and temperature are largest; the next block can
        continue there.
        """
        points = self.set_points_c
        middle = points[1:-1][len(points) // 2 - 1 : len(points) // 2]
        return (points[-1], points[0], *middle), (points[-1],)

    @cached_property
    def averaging_matrix(self) -> FloatArray:
        """Matrix (3 m, 3 n) that averages n dwells to biases at m set points and positions, gyro by gyro."""
        keys = [(each.set_c, position) for each in self.visits for position in each.positions]
        is_dwell_of = np.array(
            [[key == dwell_key for dwell_key in keys] for key in dict.fromkeys(keys)], dtype=float
        )
        return np.kron(np.eye(3), is_dwell_of / is_dwell_of.sum(axis=1, keepdims=True))

    def kinds(self) -> list[BlockKind]:
        """Blocks of dwells at each temperature that begin when the ramp ends, without a soak."""
        return [
            BlockKind(
                f"{words} at {to_c:g} degC",
                f"measure all positions at {to_c:g} degC{more}",
                partial(self._ramp_and_measure, to_c=to_c, length=length),
            )
            for to_c in self.set_points_c
            for words, more, length in (
                ("dwells", " without a soak", 1.0),
                ("long dwells", " in long dwells", _LONG),
            )
        ]

    def _ramp_and_measure(self, timeline: Timeline, to_c: float, length: float) -> None:
        timeline.ramp(to_c, self.ramp_c_per_h / timeline.times.ramp_c_per_h)
        timeline.measure_dwells(self.positions[:: -1 if timeline.next_cycle % 2 else 1], length=length)

    def whole_plan(self, rows: Sequence[DwellRow], start: BlockStart | None) -> BlockPlan:
        """Plan of the whole procedure after these dwells, from a power-on."""
        timeline = Timeline(rows, start=start)
        timeline.power_cycle()
        for visit in self.visits:
            begin_s = timeline.now_s
            timeline.ramp(visit.set_c, self.ramp_c_per_h / timeline.times.ramp_c_per_h)
            spent_h = (timeline.now_s - begin_s) / S_PER_H
            timeline.soak(max(visit.wait_h - spent_h, self.pause_h))
            for position in visit.positions:
                timeline.measure_dwells([position])
                timeline.soak(self.pause_h)
        return timeline.plan()


@dataclass(frozen=True)
class ProfileCalibration:
    """Uncertainty of the biases of a profile with the dwells measured so far, for each of k hypotheses.

    There are m biases, one for each gyro, set point and position: the mean of its dwells.
    """

    profile: Profile
    profile_rows: tuple[DwellRow, ...]  #: The dwells of the profile, forecast as if measured next.
    rivals: tuple[Rival, ...]  #: The k hypotheses.
    variances: FloatArray  #: Shape (k, m), (deg/h)^2. Variances of the biases.
    #: Shape (k, m), (deg/h)^2. Variances if only the whole procedure had been measured.
    reference: FloatArray

    @property
    def ratio(self) -> float:
        """Rms standard uncertainty relative to that of the whole procedure, for the least certain gyro."""
        return float(self._relative_precision(self.variances) ** -0.5)

    def missing_h(self, variances: FloatArray) -> float:
        """Hours of the procedure that are missing, given variances of the biases (k, m).

        Assumes that precision is proportional to time; precision beyond that of the whole procedure does not
        count.
        """
        return self.profile.duration_h * max(1.0 - self._relative_precision(variances), 0.0)

    def _relative_precision(self, variances: FloatArray) -> float:
        """Precision of the biases of the least certain gyro, relative to that of the whole procedure."""
        probabilities = np.array([each.probability for each in self.rivals])
        variance, reference = (
            (probabilities @ each).reshape(3, -1).mean(axis=1) for each in (variances, self.reference)
        )
        return float(np.min(reference / variance))
