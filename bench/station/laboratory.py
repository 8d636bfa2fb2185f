"""Sections of the station file for certificates: laboratory, and calibrations of the instruments."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import date
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.text import plain_name
from gyrobench.bench.station.instrument_sections import Positive


def _day(value: Any) -> Any:
    if isinstance(value, str):
        try:
            return date.fromisoformat(value)
        except ValueError:
            raise ValueError(f"{value!r} is not a date; write it as 2026-01-31") from None
    return value


Day = Annotated[date, BeforeValidator(_day, json_schema_input_type=str)]
_Text = Annotated[str, Field(min_length=1, max_length=200)]


class LaboratorySection(StrictModel):
    """The laboratory, as its certificates name it."""

    name: _Text = Field(description="name of the laboratory")
    street: str = Field("", max_length=200, description="street and number")
    post_code: str = Field("", max_length=20, description="post code")
    city: _Text = Field(description="city")
    country: str = Field(pattern="^[A-Z]{2}$", description="country by ISO 3166-1, two letters")
    email: str = Field("", max_length=200, description="e-mail address")
    accreditation: str = Field("", max_length=100, description="accreditation mark, as D-K-12345-01-00")
    procedure: str = Field("", max_length=200, description="number of the calibration procedure")

    @property
    def address(self) -> str:
        """Street, post code, city and country in one line."""
        parts = [self.street, f"{self.post_code} {self.city}".strip(), self.country]
        return ", ".join(part for part in parts if part)


class CalibrationUncertainty(StrictModel):
    """Expanded uncertainty in the certificate of an instrument."""

    value: Positive = Field(description="expanded uncertainty")
    unit: Literal["arcsec", "deg", "deg/s", "K", "s", "Hz", "ppm"] = Field(description="its unit")
    coverage_factor: float = Field(2.0, ge=1.0, le=10.0, description="k of the expanded uncertainty")

    @property
    def text(self) -> str:
        """Value, unit and coverage factor."""
        return f"{self.value:g} {self.unit} (k = {self.coverage_factor:g})"


class CalibratedInstrument(StrictModel):
    """Calibration of one instrument."""

    serial_number: _Text = Field(description="serial number of the instrument")
    certificate: _Text = Field(description="number of its certificate")
    issuer: str = Field("", max_length=200, description="laboratory that issued the certificate")
    calibrated: Day = Field(description="date of the calibration")
    due: Day = Field(description="date until which it is valid")
    uncertainty: CalibrationUncertainty = Field(description="its expanded uncertainty")


class Traceability(StrictModel):
    """Calibrations of the instruments that results are traced to."""

    rate_table: CalibratedInstrument | None = Field(None, description="angles of the rate table")
    chamber_sensors: CalibratedInstrument | None = Field(
        None, description="temperature sensors of the chamber"
    )
    reference_clock: CalibratedInstrument | None = Field(None, description="clock of the measurement")

    def instruments(self) -> Iterator[tuple[str, CalibratedInstrument]]:
        """Names and calibrations of the instruments that have one."""
        found = ((name, getattr(self, name)) for name in type(self).model_fields)
        yield from ((name, each) for name, each in found if each is not None)

    def past_due(self, today: date) -> dict[str, str]:
        """What is past due on a day: name of each instrument, and since when."""
        return {
            name: f"calibration of the {plain_name(name)} {each.serial_number} was due on {each.due}, "
            f"{(today - each.due).days} days ago"
            for name, each in self.instruments()
            if today > each.due
        }
