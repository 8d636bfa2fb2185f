"""Steps that rotate the unit about the table's axes while the INS navigates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic import Field
from typing_extensions import override

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.text import counted
from gyrobench.bench.procedure.estimate import BenchEstimate
from gyrobench.bench.procedure.steps import Duration, DurationOrZero, Step, TableRate, TurnAngle, span

#: A change of the angles of outer and inner axis, deg.
Move = tuple[float, float]

#: Maximum number of rotations in a step, and of whole turns in one direction.
_MAX_ROTATIONS, _MAX_TURNS = 500, 100
#: Time that accelerating, braking, the command and the reading add to a rotation, s.
_MOTION_S = 3.0


class Rotation(StrictModel):
    """One rotation about an axis of the table."""

    axis: Literal["outer", "inner"] = Field(description="axis of the table")
    angle_deg: TurnAngle = Field(description="by how much, deg; not zero")


class RotatingStep(Step):
    """Base of steps that rotate a navigating INS about the table's axes, with rests between."""

    at_position = True
    rest_s: Duration = Field(default=60.0, description="rest before the first and after each rotation, s")
    settle_s: DurationOrZero = Field(default=5.0, description="wait after each rotation before the rest, s")

    def moves(self) -> list[tuple[Move, float]]:
        """Each rotation as changes of the axes' angles, deg, with its rate, deg/s."""
        raise NotImplementedError

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        moves = self.moves()
        rest_s = (len(moves) + 1) * bench.wait_s(self.rest_s)
        if bench.table:
            turning_s = sum(bench.table.motion_s(*move) for move in moves)
            return turning_s + len(moves) * bench.wait_s(self.settle_s) + rest_s
        turning_s = sum(max(map(abs, move)) / rate_dps for move, rate_dps in moves)
        return turning_s + len(moves) * (_MOTION_S + self.settle_s) + rest_s

    @override
    def commanded(self, bench: BenchEstimate) -> BenchEstimate:
        if bench.angles_deg is None:
            return replace(bench, position=None)
        outer_deg, inner_deg = np.sum([bench.angles_deg, *(move for move, _ in self.moves())], axis=0)
        return replace(bench, position=None, angles_deg=(float(outer_deg), float(inner_deg)))


def counted_moves(steps: Sequence[Step]) -> str:
    """Describe how many rotations and whole turns the steps of a dwell make."""
    rotations = sum(len(step.moves()) for step in steps if isinstance(step, Rotate))
    turns = sum(step.turns * len(step.moves()) for step in steps if isinstance(step, Spin))
    counts = ((rotations, "rotation"), (turns, "whole turn"))
    return " and ".join(counted(number, noun) for number, noun in counts if number)


def _move(axis: Literal["outer", "inner"], angle_deg: float) -> Move:
    return (angle_deg, 0.0) if axis == "outer" else (0.0, angle_deg)


class Rotate(RotatingStep):
    """Rotate about the table's axes, one rotation after the other, while the INS navigates."""

    name = "rotate"
    rotations: list[Rotation] = Field(
        min_length=1, max_length=_MAX_ROTATIONS, description="rotations in order, from where the table stands"
    )
    rate_dps: TableRate = Field(default=10.0, description="rate of the rotations, deg/s")

    @override
    def moves(self) -> list[tuple[Move, float]]:
        return [(_move(each.axis, each.angle_deg), self.rate_dps) for each in self.rotations]

    @override
    def describe(self) -> str:
        return f"{counted(len(self.rotations), 'rotation')} with rests of {span(self.rest_s)}"


class Spin(RotatingStep):
    """Turn one axis by whole turns at each rate, back and forth, while the INS navigates."""

    name = "spin"
    axis: Literal["outer", "inner"] = Field(description="axis of the table")
    rates_dps: list[TableRate] = Field(min_length=1, max_length=50, description="rates in order, deg/s")
    turns: int = Field(default=10, ge=1, le=_MAX_TURNS, description="whole turns in each direction")

    @override
    def moves(self) -> list[tuple[Move, float]]:
        whole_deg = 360.0 * self.turns
        return [
            (_move(self.axis, angle_deg), rate_dps)
            for rate_dps in self.rates_dps
            for angle_deg in (whole_deg, -whole_deg)
        ]

    @override
    def describe(self) -> str:
        rates = ", ".join(f"{rate_dps:g}" for rate_dps in self.rates_dps)
        return f"spin the {self.axis} axis by {counted(self.turns, 'turn')} each way at {rates} deg/s"
