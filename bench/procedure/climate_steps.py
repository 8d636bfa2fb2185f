"""Steps that change or await the temperature."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Self

from pydantic import ConfigDict, Field, model_validator
from typing_extensions import override

from gyrobench.bench.procedure.estimate import BenchEstimate
from gyrobench.bench.procedure.step import Celsius, Duration, DurationOrZero, Step, span

_CHAMBER_MARGIN_S = 1800.0
_LONGEST_SOAK_S = 14_400.0


class Chamber(Step):
    """Bring the chamber to a temperature at a rate and wait until its air is there."""

    name = "chamber"
    temperature_c: Celsius = Field(description="set point, degC")
    ramp_c_per_min: float = Field(ge=0.001, le=100.0, description="how fast the set point moves, degC/min")
    within_c: float = Field(
        default=1.0, ge=0.05, le=50.0, description="the step ends when the air is this near to it, degC"
    )

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        ramp_s = self._commanded(bench).ramp_left_s()
        air_lag_s = bench.thermal.air_lag_s
        behind_c = self.ramp_c_per_min / 60.0 * min(ramp_s, air_lag_s)
        if self.within_c > behind_c:  # near enough while the set point still moves
            return max(0.0, ramp_s - (self.within_c - behind_c) / self.ramp_c_per_min * 60.0)
        return ramp_s + air_lag_s * math.log(behind_c / self.within_c)

    @override
    def after(self, bench: BenchEstimate, elapsed_s: float) -> BenchEstimate:
        return self._commanded(bench).passed(elapsed_s)

    @override
    def usual_time_limit_s(self, expected_s: float) -> float:
        return 2.0 * expected_s + _CHAMBER_MARGIN_S

    @override
    def describe(self) -> str:
        return f"chamber to {self.temperature_c:g} degC at {self.ramp_c_per_min:g} degC/min"

    def _commanded(self, bench: BenchEstimate) -> BenchEstimate:
        return replace(bench, set_point_c=self.temperature_c, ramp_c_per_s=self.ramp_c_per_min / 60.0)


class ChamberOff(Step):
    """Switch the chamber off; it goes back to room temperature by itself."""

    name = "chamber_off"

    @override
    def after(self, bench: BenchEstimate, elapsed_s: float) -> BenchEstimate:
        # How slowly an idle chamber goes back does not matter to a plan.
        idle = replace(bench, set_point_c=None, ramp_c_per_s=0.0, chamber_c=bench.thermal.room_c)
        return idle.passed(elapsed_s)


class Soak(Step):
    """Wait for a fixed time, or until the gyros' temperature hardly changes any more."""

    model_config = ConfigDict(
        json_schema_extra={
            "oneOf": [{"required": ["for_s"]}, {"required": ["until_gyro_rate_below_c_per_h"]}]
        }
    )
    name = "soak"
    for_s: Duration | None = Field(default=None, description="a fixed time, s")
    until_gyro_rate_below_c_per_h: float | None = Field(
        default=None, ge=0.01, le=1000.0, description="soak until every gyro changes by less, degC/h"
    )
    at_least_s: DurationOrZero = Field(default=0.0, description="soak this long in any case, s")
    at_most_s: Duration = Field(default=_LONGEST_SOAK_S, description="go on after this time in any case, s")

    @model_validator(mode="after")
    def _one_kind_of_soak(self) -> Self:
        if (self.for_s is None) == (self.until_gyro_rate_below_c_per_h is None):
            raise ValueError("give either for_s or until_gyro_rate_below_c_per_h")
        if self.for_s is not None and {"at_least_s", "at_most_s"} & self.model_fields_set:
            raise ValueError("at_least_s and at_most_s go with until_gyro_rate_below_c_per_h, not with for_s")
        if self.at_most_s < self.at_least_s:
            raise ValueError(f"at_most_s ({self.at_most_s:g}) is below at_least_s ({self.at_least_s:g})")
        return self

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        if self.until_gyro_rate_below_c_per_h is None:
            return self.for_s or 0.0
        settling_s = bench.time_until_gyro_rate_s(self.until_gyro_rate_below_c_per_h)
        return min(max(settling_s, self.at_least_s), self.at_most_s)

    @override
    def usual_time_limit_s(self, expected_s: float) -> float:
        return super().usual_time_limit_s(self.at_most_s if self.for_s is None else expected_s)

    @override
    def describe(self) -> str:
        if self.for_s is not None:
            return f"soak {span(self.for_s)}"
        return (
            f"soak until below {self.until_gyro_rate_below_c_per_h:g} degC/h, "
            f"{span(self.at_least_s)} to {span(self.at_most_s)}"
        )
