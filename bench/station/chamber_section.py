"""The station file's section `chamber`."""

from __future__ import annotations

from typing import ClassVar, Self

from pydantic import Field, model_validator

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.entry_points import CHAMBERS
from gyrobench.bench.station.dialect_section import Dialect, DialectSection
from gyrobench.bench.station.field_types import Positive
from gyrobench.drivers.chamber import ChamberDialect


class ChamberLimits(StrictModel):
    """What the chamber may do."""

    low_c: float = Field(description="lowest set point, degC")
    high_c: float = Field(description="highest set point, degC")
    ramp_c_per_min: Positive = Field(description="fastest ramp, degC/min")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.low_c >= self.high_c:
            raise ValueError(f"low_c ({self.low_c:g}) must be below high_c ({self.high_c:g})")
        return self


class ChamberSection(DialectSection):
    """The thermal chamber."""

    group: ClassVar[str] = CHAMBERS
    kind: ClassVar[type[Dialect]] = ChamberDialect

    limits: ChamberLimits = Field(description="what the chamber may do")
