"""The kinds of step that a procedure is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from pydantic import Field, field_validator
from typing_extensions import override

from gyrobench.bench.procedure.climate_steps import Chamber, ChamberOff, Soak
from gyrobench.bench.procedure.estimate import BenchEstimate
from gyrobench.bench.procedure.navigation_steps import Align, Navigate, Turn
from gyrobench.bench.procedure.step import Duration, DurationOrZero, PositionName, Step, TableRate, span

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
_ANSWER_S = 60.0
_LONGEST_ANSWER_S = 3600.0
_USUAL_WAY_DEG = 180.0
#: Turns in one sense leave an axis up to two circles from where the next position begins.
_LONGEST_WAY_DEG = 720.0


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
        return _USUAL_WAY_DEG / self.rate_dps + self.settle_s

    @override
    def after(self, bench: BenchEstimate, elapsed_s: float) -> BenchEstimate:
        there = replace(bench, aligned=False, position=self.position, azimuth_deg=self.azimuth_deg)
        return there.passed(elapsed_s)

    @override
    def usual_time_limit_s(self, expected_s: float) -> float:
        return super().usual_time_limit_s(_LONGEST_WAY_DEG / self.rate_dps + self.settle_s)

    @override
    def describe(self) -> str:
        return f"go to {self.position}, azimuth {self.azimuth_deg:g} deg"


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
