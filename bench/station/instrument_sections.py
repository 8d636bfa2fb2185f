"""Sections of the station file: `rate_table`, `chamber` with the keys of their dialect, the laboratory."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import date
from functools import cache
from typing import Annotated, Any, ClassVar, Literal, Self, cast

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.packages import CHAMBERS, RATE_TABLES, installed, load
from gyrobench.bench.foundations.text import plain_name
from gyrobench.drivers.chamber import ChamberDialect
from gyrobench.drivers.rate_table import TableDialect

#: Range of the values of any quantity of a bench; squares of larger values could overflow.
_SMALLEST, _LARGEST = 1e-9, 1e9


def _checked_size(value: float) -> float:
    if 0.0 < value < _SMALLEST:
        raise ValueError(f"a number of at least {_SMALLEST:g} is expected")
    return value


Positive = Annotated[float, Field(gt=0.0, le=_LARGEST), AfterValidator(_checked_size)]
NotNegative = Annotated[float, Field(ge=0.0, le=_LARGEST), AfterValidator(_checked_size)]
Direction = Literal["east", "north", "up", "west", "south", "down"]

_USER_IN_ADDRESS = re.compile(r"://[^/?#]*@")


def _checked_range(ends: list[float]) -> list[float]:
    if ends[0] >= ends[1]:
        raise ValueError("the lower end comes first")
    return ends


def without_password(address: str) -> str:
    """Raise ValueError for ``scheme://user:password@host``: run folders have a copy of the station file."""
    if _USER_IN_ADDRESS.search(address):
        raise ValueError(
            "an address can't hold a user or password: every run folder has a copy of this file. "
            "Reach the port by a tunnel or a device server without password"
        )
    return address


Range = Annotated[list[float], Field(min_length=2, max_length=2), AfterValidator(_checked_range)]
SerialPort = Annotated[
    str, Field(min_length=1, description="serial device or pyserial URL"), AfterValidator(without_password)
]
Identity = Annotated[
    str,
    Field(
        max_length=200,
        description="text that the instrument's own identification must contain, for instance its "
        "serial number",
    ),
]


Dialect = TableDialect[Any] | ChamberDialect[Any]


class DialectSection(StrictModel):
    """An instrument on a serial port.

    A section read from a file is an instance of a subclass with the keys of its dialect: also an instance of
    the dialect's options.
    """

    #: Entry point group of the dialects, and their class.
    group: ClassVar[str]
    kind: ClassVar[type[Dialect]]

    dialect: str = Field(description="command language")
    identity: Identity = ""
    port: SerialPort
    baudrate: int | None = Field(
        None, gt=0, description="bit/s of a serial device; by default that of the dialect"
    )
    parity: Literal["N", "E", "O"] | None = Field(
        None, description="none, even or odd, of a serial device; by default that of the dialect"
    )

    @property
    def is_emulated(self) -> bool:
        """Whether the instrument is emulated inside this process."""
        return self.port.startswith("emulator://")

    @property
    def installed_dialect(self) -> Dialect:
        """The dialect itself."""
        return load(self.group, self.dialect, self.kind)

    @model_validator(mode="wrap")
    @classmethod
    def _with_dialect_keys(cls, data: Any, handler: Any) -> Self:
        is_complete = "dialect" in cls.model_fields and cls.model_fields["dialect"].annotation is not str
        if is_complete or not isinstance(data, dict):
            return cast(Self, handler(data))
        if "dialect" not in data:
            raise _dialect_error(
                cls, "missing", f"the key 'dialect' is missing; {_installed_text(cls)}", data
            )
        name = data["dialect"]
        if not isinstance(name, str):
            raise _dialect_error(cls, "dialect", f"a dialect is a name; {_installed_text(cls)}", name)
        try:
            complete = section_of(cls, name)
        except DocumentError as error:
            raise _dialect_error(cls, "dialect", str(error), name) from error
        return cast(Self, complete.model_validate(data))

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        if cls.model_fields["dialect"].annotation is not str:
            return handler(core_schema)
        complete = [section_of(cls, name) for name in _loadable(cls)]
        return {"oneOf": [handler(section.__pydantic_core_schema__) for section in complete]}


@cache
def section_of(section: type[DialectSection], name: str) -> type[DialectSection]:
    """Class of a section with the keys of a dialect added.

    Raises DocumentError if there is no such dialect, or its keys can't be added.
    """
    options: type[StrictModel] = load(section.group, name, section.kind).options
    conflicting = sorted(options.model_fields.keys() & section.model_fields.keys())
    if conflicting:
        raise DocumentError(
            f"the dialect {name!r} has keys that every such section has ({', '.join(conflicting)}). "
            "Report this to the package's author"
        )
    dialect: Any = (Literal[name], Field(description="command language"))
    bases: Any = (options, section)  # a message names the section's own keys first
    complete = create_model(f"{section.__name__}_{name}", __base__=bases, dialect=dialect)
    return cast(type[DialectSection], complete)


def _loadable(section: type[DialectSection]) -> list[str]:
    names = []
    for name in installed(section.group):
        try:
            section_of(section, name)
        except DocumentError:
            continue  # a broken package of another author
        names.append(name)
    return names


def _installed_text(section: type[DialectSection]) -> str:
    return f"installed: {', '.join(installed(section.group))}"


def _dialect_error(section: type[DialectSection], kind: str, message: str, value: Any) -> ValidationError:
    # The error would interpret braces in a message as placeholders.
    escaped = message.replace("{", "{{").replace("}", "}}")
    detail = InitErrorDetails(
        type=PydanticCustomError(cast(Any, kind), cast(Any, escaped)), loc=("dialect",), input=value
    )
    return ValidationError.from_exception_data(section.__name__, [detail])


#: Range of the outer axis of a single-axis table.
_NO_OUTER_DEG = (0.0, 0.0)


class Mounting(StrictModel):
    """Where each body axis of the unit points with the table's angles at zero."""

    x: Direction = Field(description="body axis x")
    y: Direction = Field(description="body axis y")
    z: Direction = Field(description="body axis z")


class TableLimits(StrictModel):
    """Limits of the table."""

    rate_dps: Positive = Field(description="fastest turn of either axis, deg/s")
    acceleration_dps2: Positive = Field(description="largest acceleration, deg/s2")
    jerk_dps3: Positive = Field(description="largest jerk, deg/s3")
    outer_deg: Range | None = Field(
        None, description="lowest and highest angle of the outer axis, deg; none with a single axis"
    )
    inner_deg: Range = Field(description="lowest and highest angle of the inner axis, deg")


class RateTableSection(DialectSection):
    """The rate table: two axes, or the inner one alone."""

    group: ClassVar[str] = RATE_TABLES
    kind: ClassVar[type[Dialect]] = TableDialect

    outer_axis_number: int = Field(1, ge=1, le=9, description="the controller's number of the outer axis")
    inner_axis_number: int = Field(2, ge=1, le=9, description="the controller's number of the inner axis")
    outer_axis: Direction | None = Field(
        None,
        description="direction of the outer axis, angles at zero; omitted for a table with a single axis",
    )
    inner_axis: Direction = Field(description="direction of the inner axis, angles at zero")
    mounting: Mounting = Field(description="directions of the unit's body axes, angles at zero")
    reference_mounting: Mounting | None = Field(
        None,
        description="mounting to which the positions in procedures refer, if another unit on the table "
        "defines them; by default `mounting`",
    )
    limits: TableLimits = Field(description="limits of the table")
    repeatability_arcsec: NotNegative = Field(
        1.0, description="standard uncertainty with which an axis returns to an angle, arcsec"
    )

    @model_validator(mode="after")
    def _check_axes(self) -> Self:
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
        """Range of the outer axis, deg; (0, 0) if there is none."""
        return _NO_OUTER_DEG if self.limits.outer_deg is None else _pair(self.limits.outer_deg)

    @property
    def inner_limits_deg(self) -> tuple[float, float]:
        """Range of the inner axis, deg."""
        return _pair(self.limits.inner_deg)


def _pair(ends: list[float]) -> tuple[float, float]:
    low, high = ends
    return low, high


class ChamberLimits(StrictModel):
    """Limits of the chamber."""

    low_c: float = Field(description="lowest set point, degC")
    high_c: float = Field(description="highest set point, degC")
    ramp_c_per_min: Positive = Field(description="fastest ramp, degC/min")

    @model_validator(mode="after")
    def _check_range(self) -> Self:
        if self.low_c >= self.high_c:
            raise ValueError(f"low_c ({self.low_c:g}) must be below high_c ({self.high_c:g})")
        return self


class ChamberSection(DialectSection):
    """The thermal chamber."""

    group: ClassVar[str] = CHAMBERS
    kind: ClassVar[type[Dialect]] = ChamberDialect

    limits: ChamberLimits = Field(description="limits of the chamber")


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
        """Names and calibrations of the instruments that have a calibration."""
        fields = ((name, getattr(self, name)) for name in type(self).model_fields)
        yield from ((name, each) for name, each in fields if each is not None)

    def past_due(self, today: date) -> dict[str, str]:
        """Instruments that are past due on a day: description by name."""
        return {
            name: f"calibration of the {plain_name(name)} {each.serial_number} was due on {each.due}, "
            f"{(today - each.due).days} days ago"
            for name, each in self.instruments()
            if today > each.due
        }
