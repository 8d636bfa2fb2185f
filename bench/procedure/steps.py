"""The kinds of step of a procedure, with their expected durations, effects on the bench and descriptions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, ConfigDict, Field, field_validator, model_validator
from typing_extensions import override

from gyrobench.bench.bias.dwell import MIN_DURATION
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.text import did_you_mean
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.estimate import BenchEstimate

#: A step of more than a week counts as a mistake.
_MAX_STEP_S = 604_800.0

_TIMEOUT_FACTOR = 1.5
_TIMEOUT_MARGIN_S = 60.0


def _checked_position(name: str) -> str:
    if name in POSITIONS:
        return name
    raise ValueError(
        f"no such position{did_you_mean(name, POSITIONS)}; the positions are {', '.join(POSITIONS)}"
    )


def _checked_angle(angle_deg: float) -> float:
    if angle_deg == 0.0:
        raise ValueError("a turn by zero has no effect")
    return angle_deg


Duration = Annotated[float, Field(gt=0.0, le=_MAX_STEP_S)]
DurationOrZero = Annotated[float, Field(ge=0.0, le=_MAX_STEP_S)]
Celsius = Annotated[float, Field(gt=-273.15, le=1000.0)]
TurnAngle = Annotated[float, Field(ge=-360.0, le=360.0), AfterValidator(_checked_angle)]
TableRate = Annotated[float, Field(ge=0.001, le=10_000.0)]
KnownPosition = Annotated[
    str, Field(json_schema_extra={"enum": [*POSITIONS]}), AfterValidator(_checked_position)
]


class Step(StrictModel):
    """Base of the kinds of step."""

    #: Name of the kind in procedure files.
    name: ClassVar[str]
    #: Whether the step belongs to one position rather than to the whole plateau.
    at_position: ClassVar[bool] = False

    timeout_s: Duration | None = Field(
        default=None, description="time after which the step has failed, s; by default from its duration"
    )
    retries: int = Field(
        default=3, ge=0, le=100, description="how often a failed exchange with an instrument is repeated"
    )

    def expected_s(self, bench: BenchEstimate) -> float:  # noqa: ARG002
        """Expected duration, s, starting in the state ``bench``."""
        return 0.0

    def after(self, bench: BenchEstimate, elapsed_s: float) -> BenchEstimate:
        """Expected state of the bench ``elapsed_s`` after the step began in the state ``bench``."""
        return self.commanded(bench).passed(elapsed_s)

    def commanded(self, bench: BenchEstimate) -> BenchEstimate:
        """State ``bench`` with what the step commands; a motion counts as complete at once."""
        return bench

    def time_limit_s(self, expected_s: float) -> float:
        """Time after which the step has failed, s, given its expected duration."""
        return self.timeout_s or self.usual_time_limit_s(expected_s)

    def usual_time_limit_s(self, expected_s: float) -> float:
        """Time limit, s, if the procedure gives none."""
        return _TIMEOUT_FACTOR * expected_s + _TIMEOUT_MARGIN_S

    def describe(self) -> str:
        """Describe the step in one line."""
        return self.name.replace("_", " ")


def span(duration_s: float) -> str:
    """Format a duration: "45 s", "10 min", "2.5 h"."""
    if duration_s < 120.0:
        return f"{duration_s:.4g} s"
    if duration_s < 7200.0:
        return f"{duration_s / 60.0:.3g} min"
    return f"{duration_s / 3600.0:.3g} h"


_CHAMBER_MARGIN_S = 1800.0
_MAX_SOAK_S = 14_400.0


class SetChamber(Step):
    """Ramp the chamber to a temperature and wait until the air reaches it."""

    name = "chamber"
    temperature_c: Celsius = Field(description="set point, degC")
    ramp_c_per_min: float = Field(ge=0.001, le=100.0, description="how fast the set point moves, degC/min")
    within_c: float = Field(
        default=1.0, ge=0.05, le=50.0, description="the step ends when the air is within this of it, degC"
    )

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        ramp_s = self.commanded(bench).ramp_left_s()
        air_lag_s = bench.thermal.air_lag_s
        lag_c = self.ramp_c_per_min / 60.0 * min(ramp_s, air_lag_s)
        if self.within_c > lag_c:  # near enough while the set point still moves
            return max(0.0, ramp_s - (self.within_c - lag_c) / self.ramp_c_per_min * 60.0)
        return ramp_s + air_lag_s * math.log(lag_c / self.within_c)

    @override
    def commanded(self, bench: BenchEstimate) -> BenchEstimate:
        return replace(bench, set_point_c=self.temperature_c, ramp_c_per_s=self.ramp_c_per_min / 60.0)

    @override
    def usual_time_limit_s(self, expected_s: float) -> float:
        return 2.0 * expected_s + _CHAMBER_MARGIN_S

    @override
    def describe(self) -> str:
        return f"chamber to {self.temperature_c:g} degC at {self.ramp_c_per_min:g} degC/min"


class ChamberOff(Step):
    """Switch the chamber off; it returns to room temperature by itself."""

    name = "chamber_off"

    @override
    def commanded(self, bench: BenchEstimate) -> BenchEstimate:
        # The slow return of an idle chamber does not matter to a plan.
        return replace(bench, set_point_c=None, ramp_c_per_s=0.0, chamber_c=bench.thermal.room_c)


#: Time span over which a soak fits the rate of the gyros' temperatures; the first fit has nine tenths of it.
RATE_SPAN_S = 600.0


class Soak(Step):
    """Wait for a fixed time, or until the gyros' temperature is nearly constant."""

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
    at_most_s: Duration = Field(default=_MAX_SOAK_S, description="continue after this time in any case, s")

    @model_validator(mode="after")
    def _check_keys(self) -> Self:
        if (self.for_s is None) == (self.until_gyro_rate_below_c_per_h is None):
            raise ValueError("give either for_s or until_gyro_rate_below_c_per_h")
        if self.for_s is not None and {"at_least_s", "at_most_s"} & self.model_fields_set:
            raise ValueError("at_least_s and at_most_s go with until_gyro_rate_below_c_per_h, not with for_s")
        if self.at_most_s < self.at_least_s:
            raise ValueError(f"at_most_s ({self.at_most_s:g}) is below at_least_s ({self.at_least_s:g})")
        return self

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        if self.for_s is not None:
            return self.for_s
        settling_s = bench.time_until_gyro_rate_s(self.until_gyro_rate_below_c_per_h or math.inf)
        # The fitted rate is that in the middle of the fit, which grows with the soak up to its span.
        settled_s = max(0.9 * RATE_SPAN_S, min(2.0 * settling_s, settling_s + 0.5 * RATE_SPAN_S))
        return min(max(settled_s, self.at_least_s), self.at_most_s)

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


#: Shortest navigation that gives a bias, s: the shortest window plus the time of its commands.
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
        default=None, description="alignment time, s; with until_fine the minimum"
    )
    until_fine: bool = Field(default=False, description="wait until the INS reports fine alignment")
    at_most_s: Duration | None = Field(
        default=None, description="with until_fine: the step fails if the INS is not fine by then, s"
    )
    euler_sequence: Literal["automatic", "rpy_321", "pry_231"] = Field(
        default="automatic",
        description="Euler angles that give the heading; automatic: those regular in the position",
    )

    @model_validator(mode="after")
    def _check_end(self) -> Self:
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
    def commanded(self, bench: BenchEstimate) -> BenchEstimate:
        return replace(bench, aligned=bench.powered)

    @override
    def usual_time_limit_s(self, expected_s: float) -> float:
        return self.at_most_s or super().usual_time_limit_s(expected_s)

    @override
    def describe(self) -> str:
        time = f"align {span(self.duration_s)}" if self.duration_s else "align"
        return f"{time} until fine, {span(self.at_most_s)} at most" if self.at_most_s else time


class Until(StrictModel):
    """Condition that ends a navigation before at_most_s."""

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
    renamed_values: ClassVar[Mapping[str, Mapping[str, str]]] = {
        "purpose": {"verification": "calibration_check"}
    }
    name = "navigate"
    at_position = True
    duration_s: Duration | None = Field(default=None, description="navigation time, s")
    until: Until | None = Field(
        default=None,
        description="end as soon as the standard uncertainties are this small; only after a turn",
    )
    at_least_s: Duration = Field(
        default=MIN_NAVIGATION_S, description="with until: navigate this long in any case, s"
    )
    at_most_s: Duration | None = Field(
        default=None, description="with until: continue after this time in any case, s"
    )
    purpose: Literal["calibration", "calibration_check", "noise"] = Field(
        default="calibration",
        description="calibration_check, noise: one navigation straight from the alignment, without a turn; "
        "noise: gives no bias, but the gyros' Allan variance",
    )

    @model_validator(mode="after")
    def _check_end(self) -> Self:
        if (self.duration_s is None) == (self.until is None):
            raise ValueError("give either duration_s, or until with at_most_s")
        if self.until is None and {"at_least_s", "at_most_s"} & self.model_fields_set:
            raise ValueError("at_least_s and at_most_s go with until, not with duration_s")
        if self.until and self.at_most_s is None:
            raise ValueError("until needs at_most_s, the maximum navigation time")
        if self.at_most_s and self.at_most_s < self.at_least_s:
            raise ValueError(f"at_most_s ({self.at_most_s:g}) is below at_least_s ({self.at_least_s:g})")
        return self

    @property
    def max_duration_s(self) -> float:
        """Time after which the navigation ends in any case."""
        return self.duration_s or self.at_most_s or 0.0

    def is_satisfied(self, elapsed_s: float, bias_sigma_dph: float) -> bool:
        """Whether to end now, given the elapsed time and the largest standard uncertainty of the biases."""
        if self.until is None:
            return False
        return elapsed_s >= self.at_least_s and bias_sigma_dph < self.until.bias_sigma_below_dph

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        """The maximum: the actual time depends on the unit."""
        return self.max_duration_s

    @override
    def describe(self) -> str:
        time = f"navigate {span(self.max_duration_s)}"
        if self.until:
            sigma = f"{self.until.bias_sigma_below_dph:g} deg/h"
            time = f"navigate until bias sigma below {sigma}, {span(self.max_duration_s)} at most"
        purposes = {"calibration": "", "calibration_check": " for a calibration check", "noise": " for noise"}
        return f"{time}{purposes[self.purpose]}"


class Turn(Step):
    """Turn about the vertical while the INS navigates."""

    name = "turn"
    at_position = True
    angle_deg: TurnAngle = Field(description="turn about Up, deg; not zero")
    rate_dps: TableRate = Field(default=10.0, description="rate of the table's axes, deg/s")
    settle_s: DurationOrZero = Field(default=5.0, description="wait after the turn, s")

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        moving_s = bench.motion_s(self.commanded(bench).angles_deg, self.rate_dps, abs(self.angle_deg))
        return moving_s + bench.wait_s(self.settle_s)

    @override
    def commanded(self, bench: BenchEstimate) -> BenchEstimate:
        azimuth_deg = (bench.azimuth_deg + self.angle_deg) % 360.0
        return replace(bench, azimuth_deg=azimuth_deg, angles_deg=bench.angles_turned(self.angle_deg))

    @override
    def describe(self) -> str:
        return f"turn {self.angle_deg:g} deg"


_MAX_BOOT_S = 300.0
_ANSWER_S = 60.0
_MAX_ANSWER_S = 3600.0
_USUAL_TRAVEL_DEG = 180.0
#: Turns in one sense leave an axis up to two circles from the next position.
_MAX_TRAVEL_DEG = 720.0


class PowerOn(Step):
    """Switch the INS on and wait until it sends data."""

    name = "power_on"
    settle_s: DurationOrZero = Field(default=0.0, description="wait after the first data, s")

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        return self.settle_s

    @override
    def commanded(self, bench: BenchEstimate) -> BenchEstimate:
        return replace(bench, powered=True, aligned=False)

    @override
    def usual_time_limit_s(self, expected_s: float) -> float:
        return expected_s + _MAX_BOOT_S

    @override
    def describe(self) -> str:
        return f"power on, settle {span(self.settle_s)}"


class PowerOff(Step):
    """Switch the INS off."""

    name = "power_off"

    @override
    def commanded(self, bench: BenchEstimate) -> BenchEstimate:
        return replace(bench, powered=False, aligned=False)


class GoTo(Step):
    """Turn the table to a position."""

    name = "go_to"
    at_position = True
    position: KnownPosition = Field(description="one of the six positions")
    azimuth_deg: float = Field(
        default=0.0, ge=-360.0, le=360.0, description="turn about Up from the position's azimuth 0, deg"
    )
    rate_dps: TableRate = Field(default=10.0, description="rate of the table's axes, deg/s")
    settle_s: DurationOrZero = Field(default=5.0, description="wait in the position, s")

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        moving_s = bench.motion_s(self.commanded(bench).angles_deg, self.rate_dps, _USUAL_TRAVEL_DEG)
        return moving_s + bench.wait_s(self.settle_s)

    @override
    def commanded(self, bench: BenchEstimate) -> BenchEstimate:
        position, azimuth_deg = self.position, self.azimuth_deg
        angles_deg = bench.angles_at(position, azimuth_deg)
        return replace(
            bench, aligned=False, position=position, azimuth_deg=azimuth_deg, angles_deg=angles_deg
        )

    @override
    def usual_time_limit_s(self, expected_s: float) -> float:
        return super().usual_time_limit_s(_MAX_TRAVEL_DEG / self.rate_dps + self.settle_s)

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
    """Ask the operator; the first answer continues, every other one stops the run."""

    name = "ask_operator"
    question: str = Field(min_length=1, max_length=500, description="what to ask")
    answers: list[str] = Field(
        default=["continue", "stop"],
        min_length=1,
        description="answers to choose from; the first one continues",
    )

    @field_validator("answers")
    @classmethod
    def _check_answers(cls, answers: list[str]) -> list[str]:
        if len(set(answers)) < len(answers):
            raise ValueError("the answers must differ")
        return answers

    @override
    def expected_s(self, bench: BenchEstimate) -> float:
        return min(_ANSWER_S, self.timeout_s or _ANSWER_S)

    @override
    def usual_time_limit_s(self, expected_s: float) -> float:
        return _MAX_ANSWER_S

    @override
    def describe(self) -> str:
        return f"ask: {self.question}"
