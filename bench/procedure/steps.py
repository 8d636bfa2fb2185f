"""The kinds of step that a procedure is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Literal, Self

from pydantic import Field, field_validator, model_validator
from typing_extensions import override

from bench.procedure.climate_steps import Chamber, ChamberOff, Soak
from bench.procedure.estimate import BenchEstimate
from bench.procedure.step import Duration, DurationOrZero, PositionName, Step, TableRate, span

__all__ = [
    "STEP_KINDS",
    "Align",
    "AskOperator",
    "Chamber",
    "ChamberOff",
    "GoTo",
    "Navigate",
    "PowerOff",
    "PowerOn",
    "Soak",
    "Step",
    "Turn",
    "Wait",
]

_BOOT_S = 300.0
_FINE_ALIGNMENT_S = 300.0
_ANSWER_S = 60.0
_LONGEST_ANSWER_S = 3600.0
_LONGEST_WAY_DEG = 180.0


class PowerOn(Step):
    """Switch the INS on and wait until it sends data."""

    name = "power_on"
    settle_s: DurationOrZero = Field(default=0.0, description="wait after the first data, s")

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        return self.settle_s

    @override
    def after(self, bench: BenchEstimate, elapsed_s: float) -> BenchEstimate:
        return replace(bench, powered=True, aligned=False).passed(elapsed_s)

    @override
    def usual_time_limit_s(self, expected_s: float) -> float:
        return expected_s + _BOOT_S

    @override
    def describe(self) -> str:
        return f"power on, settle {span(self.settle_s)}"


class PowerOff(Step):
    """Switch the INS off."""

    name = "power_off"

    @override
    def after(self, bench: BenchEstimate, elapsed_s: float) -> BenchEstimate:
        return replace(bench, powered=False, aligned=False).passed(elapsed_s)


class GoTo(Step):
    """Turn the table to a position."""

    name = "go_to"
    at_position = True
    position: PositionName = Field(description="one of the six positions")
    azimuth_deg: float = Field(default=0.0, ge=-360.0, le=360.0, description="turn about the vertical, deg")
    rate_dps: TableRate = Field(default=10.0, description="rate of the table's axes, deg/s")
    settle_s: DurationOrZero = Field(default=5.0, description="wait in the position, s")

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        return _LONGEST_WAY_DEG / self.rate_dps + self.settle_s

    @override
    def after(self, bench: BenchEstimate, elapsed_s: float) -> BenchEstimate:
        there = replace(bench, aligned=False, position=self.position, azimuth_deg=self.azimuth_deg)
        return there.passed(elapsed_s)

    @override
    def describe(self) -> str:
        return f"go to {self.position}, azimuth {self.azimuth_deg:g} deg"


class Align(Step):
    """Let the INS align itself: for a time, or until it reports fine alignment, or both."""

    name = "align"
    at_position = True
    duration_s: Duration | None = Field(
        default=None, description="alignment time, s; the shortest one together with until_fine"
    )
    until_fine: bool = Field(default=False, description="wait until the INS reports fine alignment")
    at_most_s: Duration | None = Field(
        default=None, description="with until_fine: the step fails if the INS is not fine by then, s"
    )
    euler_sequence: Literal["automatic", "rpy_321", "pry_231"] = Field(
        default="automatic",
        description="Euler angles that give the heading; automatic takes those regular in the position",
    )

    @model_validator(mode="after")
    def _ends(self) -> Self:
        if self.duration_s is None and not self.until_fine:
            raise ValueError("give duration_s, or until_fine: true with at_most_s")
        if self.until_fine != (self.at_most_s is not None):
            raise ValueError("until_fine: true and at_most_s go together")
        if self.duration_s and self.at_most_s and self.at_most_s < self.duration_s:
            raise ValueError(f"at_most_s ({self.at_most_s:g}) is below duration_s ({self.duration_s:g})")
        return self

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        if self.at_most_s is None:
            return self.duration_s or 0.0
        return min(max(self.duration_s or 0.0, _FINE_ALIGNMENT_S), self.at_most_s)

    @override
    def after(self, bench: BenchEstimate, elapsed_s: float) -> BenchEstimate:
        return replace(bench, aligned=bench.powered).passed(elapsed_s)

    @override
    def usual_time_limit_s(self, expected_s: float) -> float:
        return self.at_most_s or super().usual_time_limit_s(expected_s)

    @override
    def describe(self) -> str:
        time = f"align {span(self.duration_s)}" if self.duration_s else "align"
        return f"{time} until fine, {span(self.at_most_s)} at most" if self.at_most_s else time


class Navigate(Step):
    """Let the INS navigate at rest."""

    name = "navigate"
    at_position = True
    duration_s: Duration = Field(description="navigation time, s")

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        return self.duration_s

    @override
    def describe(self) -> str:
        return f"navigate {span(self.duration_s)}"


class Turn(Step):
    """Turn about the vertical while the INS navigates."""

    name = "turn"
    at_position = True
    angle_deg: float = Field(ge=-360.0, le=360.0, description="turn about Up, deg; not zero")
    rate_dps: TableRate = Field(default=10.0, description="rate of the table's axes, deg/s")
    settle_s: DurationOrZero = Field(default=5.0, description="wait after the turn, s")

    @field_validator("angle_deg")
    @classmethod
    def _turns(cls, angle_deg: float) -> float:
        if angle_deg == 0.0:
            raise ValueError("a turn by zero turns nothing")
        return angle_deg

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        return abs(self.angle_deg) / self.rate_dps + self.settle_s

    @override
    def after(self, bench: BenchEstimate, elapsed_s: float) -> BenchEstimate:
        azimuth_deg = (bench.azimuth_deg + self.angle_deg) % 360.0
        return replace(bench, azimuth_deg=azimuth_deg).passed(elapsed_s)

    @override
    def describe(self) -> str:
        return f"turn {self.angle_deg:g} deg"


class Wait(Step):
    """Wait."""

    name = "wait"
    duration_s: Duration = Field(description="how long, s")

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        return self.duration_s

    @override
    def describe(self) -> str:
        return f"wait {span(self.duration_s)}"


class AskOperator(Step):
    """Ask the person at the bench; the first answer goes on, every other one stops the run."""

    name = "ask_operator"
    question: str = Field(min_length=1, max_length=500, description="what to ask")
    answers: list[str] = Field(
        default=["continue", "stop"],
        min_length=1,
        description="answers to choose from; the first one goes on",
    )

    @field_validator("answers")
    @classmethod
    def _different(cls, answers: list[str]) -> list[str]:
        if len(set(answers)) < len(answers):
            raise ValueError("the answers must differ")
        return answers

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        return min(_ANSWER_S, self.timeout_s or _ANSWER_S)

    @override
    def usual_time_limit_s(self, expected_s: float) -> float:
        return _LONGEST_ANSWER_S

    @override
    def describe(self) -> str:
        return f"ask: {self.question}"


#: Every kind of step by its name in procedure files.
STEP_KINDS: Mapping[str, type[Step]] = MappingProxyType(
    {
        kind.name: kind
        for kind in (
            PowerOn, PowerOff, Chamber, ChamberOff, Soak, GoTo, Align, Navigate, Turn, Wait, AskOperator,
        )
    }
)  # fmt: skip
