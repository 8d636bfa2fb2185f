"""Steps that a dwell is made of: alignment, navigation and turns."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, Self

from pydantic import ConfigDict, Field, field_validator, model_validator
from typing_extensions import override

from gyrobench.bench.bias.dwell import MIN_DURATION
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.procedure.estimate import BenchEstimate
from gyrobench.bench.procedure.step import Duration, DurationOrZero, Step, TableRate, span

#: Shortest navigation that gives a bias, s: the shortest window, and what its commands cost.
MIN_NAVIGATION_S = MIN_DURATION + 5.0

_FINE_ALIGNMENT_S = 300.0


class Align(Step):
    """Let the INS align itself: for a time, or until it reports fine alignment, or both."""

    model_config = ConfigDict(
        json_schema_extra={
            "anyOf": [{"required": ["duration_s"]}, {"required": ["until_fine"]}],
            "dependentRequired": {"at_most_s": ["until_fine"]},
        }
    )
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


class Until(StrictModel):
    """What ends a navigation before its longest time."""

    bias_sigma_below_dph: float = Field(
        ge=1e-5, le=10.0, description="standard uncertainty of all three gyro biases is below this, deg/h"
    )


class Navigate(Step):
    """Let the INS navigate at rest: for a time, or until its gyro biases are known well enough."""

    model_config = ConfigDict(
        json_schema_extra={
            "oneOf": [{"required": ["duration_s"]}, {"required": ["until"]}],
            "dependentRequired": {"until": ["at_most_s"]},
        }
    )
    name = "navigate"
    at_position = True
    duration_s: Duration | None = Field(default=None, description="navigation time, s")
    until: Until | None = Field(
        default=None, description="end as soon as the biases are known so well; only after a turn"
    )
    at_least_s: Duration = Field(
        default=MIN_NAVIGATION_S, description="with until: navigate this long in any case, s"
    )
    at_most_s: Duration | None = Field(
        default=None, description="with until: go on after this time in any case, s"
    )
    purpose: Literal["calibration", "verification"] = Field(
        default="calibration",
        description="verification: one navigation straight from the alignment, without a turn",
    )

    @model_validator(mode="after")
    def _ends(self) -> Self:
        if (self.duration_s is None) == (self.until is None):
            raise ValueError("give either duration_s, or until with at_most_s")
        if self.until is None and {"at_least_s", "at_most_s"} & self.model_fields_set:
            raise ValueError("at_least_s and at_most_s go with until, not with duration_s")
        if self.until and self.at_most_s is None:
            raise ValueError("until needs at_most_s, the longest time to navigate")
        if self.at_most_s and self.at_most_s < self.at_least_s:
            raise ValueError(f"at_most_s ({self.at_most_s:g}) is below at_least_s ({self.at_least_s:g})")
        return self

    @property
    def longest_s(self) -> float:
        """Time after which the navigation is over in any case."""
        return self.duration_s or self.at_most_s or 0.0

    def is_satisfied(self, elapsed_s: float, bias_sigma_dph: float) -> bool:
        """Whether to end now, before the longest time.

        Parameters
        ----------
        elapsed_s : float
            How long the navigation has gone on.
        bias_sigma_dph : float
            Largest standard uncertainty of the three gyro biases by the estimate so far.
        """
        if self.until is None:
            return False
        return elapsed_s >= self.at_least_s and bias_sigma_dph < self.until.bias_sigma_below_dph

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        """Tell the longest time: how soon the biases are known depends on the unit."""
        return self.longest_s

    @override
    def describe(self) -> str:
        time = f"navigate {span(self.longest_s)}"
        if self.until:
            sigma = f"{self.until.bias_sigma_below_dph:g} deg/h"
            time = f"navigate until bias sigma below {sigma}, {span(self.longest_s)} at most"
        return time if self.purpose == "calibration" else f"{time} for {self.purpose}"


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
