"""What all kinds of step have in common."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import AfterValidator, Field

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.text import did_you_mean
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.procedure.estimate import BenchEstimate

#: A step of more than a week is taken for a slip of the pen.
MAX_STEP_S = 604_800.0

_TIMEOUT_FACTOR = 1.5
_TIMEOUT_MARGIN_S = 60.0


def _known_position(name: str) -> str:
    if name in POSITIONS:
        return name
    raise ValueError(
        f"no such position{did_you_mean(name, POSITIONS)}; the positions are {', '.join(POSITIONS)}"
    )


Duration = Annotated[float, Field(gt=0.0, le=MAX_STEP_S)]
DurationOrZero = Annotated[float, Field(ge=0.0, le=MAX_STEP_S)]
Celsius = Annotated[float, Field(gt=-273.15, le=1000.0)]
TableRate = Annotated[float, Field(ge=0.001, le=10_000.0)]
PositionName = Annotated[
    str, Field(json_schema_extra={"enum": [*POSITIONS]}), AfterValidator(_known_position)
]


class Step(StrictModel):
    """One thing that the bench does: data, and answers about itself without being run."""

    #: Name of the kind in procedure files.
    name: ClassVar[str]
    #: Whether the step belongs to one position rather than to the temperature as a whole.
    at_position: ClassVar[bool] = False

    timeout_s: Duration | None = Field(
        default=None,
        description="time after which the step has failed; follows from its duration if not given",
    )
    retries: int = Field(
        default=3, ge=0, le=100, description="how often a failed exchange with an instrument is tried again"
    )

    def expected_s(self, bench: BenchEstimate) -> float:  # noqa: ARG002
        """Tell how long the step is expected to take, starting from ``bench``."""
        return 0.0

    def after(self, bench: BenchEstimate, elapsed_s: float) -> BenchEstimate:
        """Predict the bench ``elapsed_s`` after the step began on ``bench``."""
        return bench.passed(elapsed_s)

    def time_limit_s(self, expected_s: float) -> float:
        """Time after which the step has failed, given its expected duration."""
        return self.timeout_s or self.usual_time_limit_s(expected_s)

    def usual_time_limit_s(self, expected_s: float) -> float:
        """Time limit where the procedure gives none."""
        return _TIMEOUT_FACTOR * expected_s + _TIMEOUT_MARGIN_S

    def describe(self) -> str:
        """One line for people."""
        return self.name.replace("_", " ")


def span(duration_s: float) -> str:
    """Write a duration for people: "45 s", "10 min", "2.5 h"."""
    if duration_s < 120.0:
        return f"{duration_s:.4g} s"
    if duration_s < 7200.0:
        return f"{duration_s / 60.0:.3g} min"
    return f"{duration_s / 3600.0:.3g} h"
