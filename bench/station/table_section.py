"""The station file's section `rate_table`."""

from __future__ import annotations

from typing import ClassVar, Self

from pydantic import Field, model_validator

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.station.dialect_section import Dialect, DialectSection
from gyrobench.bench.station.field_types import Direction, Positive, Range
from gyrobench.drivers.dialects import RATE_TABLES
from gyrobench.drivers.rate_table import TableDialect

#: The angle of the outer axis that a single-axis table does not have.
_NO_OUTER_DEG = (0.0, 0.0)


class Mounting(StrictModel):
    """Where each body axis of the unit points with the table's angles at zero."""

    x: Direction = Field(description="body axis x")
    y: Direction = Field(description="body axis y")
    z: Direction = Field(description="body axis z")


class TableLimits(StrictModel):
    """What the table may do."""

    rate_dps: Positive = Field(description="fastest turn of either axis, deg/s")
    acceleration_dps2: Positive = Field(description="largest acceleration, deg/s2")
    jerk_dps3: Positive = Field(description="largest jerk, deg/s3")
    outer_deg: Range | None = Field(
        default=None, description="lowest and highest angle of the outer axis, deg; none with a single axis"
    )
    inner_deg: Range = Field(description="lowest and highest angle of the inner axis, deg")


class RateTableSection(DialectSection):
    """The rate table: two axes, or the inner one alone."""

    group: ClassVar[str] = RATE_TABLES
    kind: ClassVar[type[Dialect]] = TableDialect

    outer_axis_number: int = Field(
        default=1, ge=1, le=9, description="the controller's number of the outer axis"
    )
    inner_axis_number: int = Field(
        default=2, ge=1, le=9, description="the controller's number of the inner axis"
    )
    outer_axis: Direction | None = Field(
        default=None,
        description="where the outer axis points, angles at zero; left out for a table with a single axis",
    )
    inner_axis: Direction = Field(description="where the inner axis points, angles at zero")
    mounting: Mounting = Field(description="where the unit's body axes point, angles at zero")
    limits: TableLimits = Field(description="what the table may do")

    @model_validator(mode="after")
    def _one_or_two_axes(self) -> Self:
        if self.is_single_axis:
            if self.limits.outer_deg is not None or "outer_axis_number" in self.model_fields_set:
                raise ValueError(
                    "outer_axis is missing; a table with a single axis has neither outer_axis nor "
                    "outer_axis_number nor limits.outer_deg"
                )
            return self
        if self.limits.outer_deg is None:
            raise ValueError("limits.outer_deg is missing: the range of the outer axis")
        if self.outer_axis_number == self.inner_axis_number:
            raise ValueError("outer_axis_number and inner_axis_number must differ")
        if len(self.axis_numbers) > getattr(self.installed_dialect, "max_axes"):  # noqa: B009
            raise ValueError(
                f"a table of the dialect {self.dialect} has a single axis: leave out outer_axis, "
                "outer_axis_number and limits.outer_deg"
            )
        return self

    @property
    def is_single_axis(self) -> bool:
        """Whether the inner axis is the only one."""
        return self.outer_axis is None

    @property
    def axis_numbers(self) -> tuple[int, ...]:
        """The controller's numbers of the axes in use, in ascending order."""
        if self.is_single_axis:
            return (self.inner_axis_number,)
        return tuple(sorted((self.outer_axis_number, self.inner_axis_number)))

    @property
    def outer_limits_deg(self) -> tuple[float, float]:
        """Range of the outer axis; zero alone where there is none."""
        return _NO_OUTER_DEG if self.limits.outer_deg is None else _pair(self.limits.outer_deg)

    @property
    def inner_limits_deg(self) -> tuple[float, float]:
        """Range of the inner axis."""
        return _pair(self.limits.inner_deg)


def _pair(ends: list[float]) -> tuple[float, float]:
    low, high = ends
    return low, high
