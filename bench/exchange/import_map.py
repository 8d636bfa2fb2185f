"""The import map: a YAML file with the meaning of each column of a foreign log, and how it is averaged.

With a section ``calibration`` the log can also be used for a calibration, which accepts increments too.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple, Self, cast, get_args

from pydantic import BeforeValidator, Field, model_validator

from gyrobench.bench.foundations.csv_tables import COLDEST_C, HOTTEST_C
from gyrobench.bench.foundations.documents import StrictModel, read_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.location import Location
from gyrobench.bench.navigation.positions import AXES, PositionName
from gyrobench.drivers import ins
from gyrobench.drivers.ins.units import usual_spelling

_SHIPPED_DBC = Path(ins.__file__).parent

#: Name of a column, or its number from 1.
Column = Annotated[str, Field(min_length=1)] | Annotated[int, Field(ge=1)]
#: Column of a quantity, and the scale and offset that convert it.
ScaledColumn = tuple[Column, float, float]
#: The limit is within the range of a dwell table, and beyond the values of any log.
Positive = Annotated[float, Field(gt=0.0, le=1e12)]
Factor = Annotated[float, Field(ge=-1e12, le=1e12)]
NotNegative = Annotated[float, Field(ge=0.0, le=1e12)]
#: A spreadsheet that opens the table must not interpret it as a formula.
Name = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^=+@\t\r\n-]")]


def _from_plain_value(key: str, plain_type: Any, model: type[StrictModel]) -> BeforeValidator:
    """Validator that accepts a plain text or number, of type ``plain_type``, as the value of one key."""
    return BeforeValidator(
        lambda data: {key: data} if isinstance(data, str | int) else data,
        json_schema_input_type=plain_type | model,
    )


def _require_one(model: Any, *names: str) -> None:
    """Raise ValueError unless exactly one of the named fields has a value."""
    given = [name for name in names if getattr(model, name) is not None]
    if len(given) != 1:
        quoted = ", ".join(f"'{name}'" for name in names)
        given_text = " and ".join(f"'{name}'" for name in given) or "none of them"
        raise ValueError(f"give exactly one of {quoted}; there is {given_text}")


# fmt: off
_GyroUnit = Literal[
    "rad/s", "mrad/s", "urad/s", "deg/s", "mdeg/s", "dps", "mdps", "deg/h", "mdeg/h", "arcsec/s",
    "rad", "mrad", "urad", "deg", "mdeg", "arcsec",
]
_ForceUnit = Literal["m/s2", "g", "mg", "ug", "m/s", "mm/s"]
_AnySpelling = BeforeValidator(lambda unit: usual_spelling(unit) if isinstance(unit, str) else unit)
GyroUnit = Annotated[_GyroUnit, _AnySpelling]
ForceUnit = Annotated[_ForceUnit, _AnySpelling]

#: Unit in brackets at the end of the name of a column, as in "gx [deg/s]", and one after an underscore.
_UNIT_IN_BRACKETS = re.compile(r"[\[(]\s*([^\[\]()]+?)\s*[\])]\s*$")
_UNIT_SUFFIX = re.compile(r"_(m?dps|radps|dph|(deg|rad)_(per_)?[sh]|mps2|m_s2|(?<=time_)(s|ms|us|ns))$")
# fmt: on
_KELVIN_OR_FAHRENHEIT = ("k", "kelvin", "f", "degf", "fahrenheit")


def _unit_in_name(column: Column) -> str:
    """Unit at the end of a column's name, in the spelling of the maps' units; empty if there is none."""
    name = str(column).lower()
    bracketed, suffix = _UNIT_IN_BRACKETS.search(name), _UNIT_SUFFIX.search(name)
    unit = bracketed[1] if bracketed else suffix[1].replace("_per_", "/").replace("_", "/") if suffix else ""
    return usual_spelling(unit)


def _check_named_unit(column: Column, unit: str, known: Sequence[str]) -> None:
    """Raise ValueError if the name of a column states another of the ``known`` units."""
    named = _unit_in_name(column)
    if named in known and named != unit:
        raise ValueError(
            f"column '{column}' is in {named} by the log, and in {unit} by the map. Correct 'unit', or map "
            "a column whose unit is wrong in the log by its number"
        )


class TextFormat(StrictModel):
    """A text file, one sample a line."""

    separator: Literal["auto", "comma", "semicolon", "tab", "whitespace"] = Field(
        default="auto", description="separator of the cells"
    )
    header: bool = Field(default=True, description="whether the first line names the columns")
    skip_lines: int = Field(default=0, ge=0, description="lines before the header or the first sample")
    comment: str | None = Field(default=None, min_length=1, description="first characters of a comment line")
    decimal: Literal[".", ","] = Field(default=".", description="decimal point")


class RecordFormat(StrictModel):
    """A binary file of records of equal length."""

    fields: list[Annotated[str, Field(min_length=1)]] = Field(
        min_length=1, description="names of the numbers of a record, in their order"
    )
    type: str = Field(
        default="<f8",
        pattern=r"^[<>](f[48]|[iu][1248])$",
        description="type of all of them as numpy writes it: '<f8' is float64, least byte first",
    )
    header_bytes: int = Field(default=0, ge=0, description="bytes before the first record")

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        duplicates = sorted({name for name in self.fields if self.fields.count(name) > 1})
        if duplicates:
            raise ValueError(f"fields are named twice: {', '.join(duplicates)}")
        return self


class SignalFormat(StrictModel):
    """A log of named signals; its columns are MESSAGE.SIGNAL, or as the log names them, and time_s."""

    format: Literal["parquet", "blf", "mf4", "ardupilot", "px4"] = Field(
        description="parquet, blf (needs dbc), mf4 (with dbc: its CAN frames), ardupilot (.bin), px4 (.ulg)"
    )
    dbc: str | None = Field(default=None, min_length=1, description="DBC file beside the map, or shipped")

    @model_validator(mode="after")
    def _check_dbc(self) -> Self:
        if (self.format == "blf" and self.dbc is None) or (self.dbc and self.format not in ("blf", "mf4")):
            raise ValueError("'dbc' decodes CAN frames: give it for blf, not for other formats than mf4")
        return self


class TimeRule(StrictModel):
    """When a sample was taken."""

    column: Column | None = Field(default=None, description="column with the time")
    unit: Annotated[Literal["s", "ms", "us", "ns", "min", "h", "iso8601"], _AnySpelling] = Field(
        default="s", description="unit of that column; iso8601: 2026-03-01T12:00:00.5Z"
    )
    format: str | None = Field(
        default=None, min_length=1, description="of other calendar times, such as %d.%m.%Y %H:%M:%S"
    )
    sample_rate_hz: Positive | None = Field(default=None, description="instead of a column: evenly sampled")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        _require_one(self, "column", "sample_rate_hz")
        if self.column is not None:
            _check_named_unit(self.column, self.unit, ("s", "ms", "us", "ns", "min", "h"))
        return self


class TemperatureColumn(StrictModel):
    """A column of temperatures with a separate conversion."""

    column: Column = Field(description="name of the column, or its number from 1")
    scale: Factor | None = Field(default=None, description="degC per unit; default: that of the section")
    offset_c: float | None = Field(
        default=None, description="added after scale; default: that of the section, degC"
    )


class SignedColumn(StrictModel):
    """A column, and which way it counts."""

    column: Column = Field(description="name of the column, or its number from 1")
    sign: Literal[1, -1] = Field(default=1, description="-1 where it counts against the body axis")
    scale: Factor = Field(default=1.0, description="factor on the column")


#: A plain column has the sign of the axis.
AxisColumn = Annotated[SignedColumn, _from_plain_value("column", Column, SignedColumn)]


#: Suffixes of units of rate; other units are those of increments.
_PER_TIME = ("/s", "/h")


class AxisColumns(StrictModel):
    """Columns of three sensors along the body axes."""

    x: AxisColumn = Field(description="column of the x sensor, with its sign")
    y: AxisColumn = Field(description="column of the y sensor, with its sign")
    z: AxisColumn = Field(description="column of the z sensor, with its sign")

    @model_validator(mode="after")
    def _check_named_units(self) -> Self:
        self.check_units({})
        return self

    def check_units(self, units: Mapping[Column, str]) -> None:
        """Raise ValueError if the name or the log gives a column without scale another unit than the map.

        ``units``: those that the log states by column.
        """
        for axis in (self.x, self.y, self.z):
            if (unit := getattr(self, "unit", None)) and axis.scale == 1.0:
                stated = f"{axis.column} [{units[axis.column]}]" if units.get(axis.column) else axis.column
                _check_named_unit(stated, unit, (*get_args(_GyroUnit), *get_args(_ForceUnit)))

    def by_quantity(self, names: Sequence[str], unit: float = 1.0) -> dict[str, ScaledColumn]:
        """Column, scale and offset of each sensor by name; ``unit``: factor on the scales."""
        axes = zip(names, (self.x, self.y, self.z), strict=True)
        return {name: (axis.column, axis.sign * axis.scale * unit, 0.0) for name, axis in axes}


class GyroColumns(AxisColumns):
    """Which column measures the rate about which body axis."""

    unit: GyroUnit = Field(
        description="unit of the rates; an angle: increments since the sample before, to calibrate"
    )
    full_scale: Positive | None = Field(
        default=None, description="measuring range of the gyros, in the unit above"
    )


#: A plain column is converted as its section states.
Temperature = Annotated[Column | TemperatureColumn, Field()]


class TemperatureColumns(StrictModel):
    """Columns of temperatures; each value times ``scale`` plus ``offset_c`` is degC."""

    renamed_keys = MappingProxyType({"least_swing_c": "min_swing_c"})

    gyros: Temperature | None = Field(default=None, description="one temperature for all three gyros")
    gyro_x: Temperature | None = Field(default=None, description="temperature of the x gyro")
    gyro_y: Temperature | None = Field(default=None, description="temperature of the y gyro")
    gyro_z: Temperature | None = Field(default=None, description="temperature of the z gyro")
    constant_c: float | None = Field(
        default=None,
        ge=COLDEST_C,
        le=HOTTEST_C,
        description="for a log without temperatures: the noted temperature, degC",
    )
    boards: Temperature | None = Field(default=None, description="one temperature for all gyros' electronics")
    board_x: Temperature | None = Field(default=None, description="temperature of the x gyro's electronics")
    board_y: Temperature | None = Field(default=None, description="temperature of the y gyro's electronics")
    board_z: Temperature | None = Field(default=None, description="temperature of the z gyro's electronics")
    chamber_set: Temperature | None = Field(default=None, description="set point of the chamber")
    chamber: Temperature | None = Field(default=None, description="air of the chamber")
    case: Temperature | None = Field(default=None, description="case of the unit")
    scale: float = Field(default=1.0, description="degC per unit of the columns")
    offset_c: float = Field(default=0.0, description="added after scale, degC")
    min_swing_c: NotNegative = Field(
        default=10.0, description="reject a table whose temperatures span less, K"
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        single = [name for name in ("gyro_x", "gyro_y", "gyro_z") if getattr(self, name) is not None]
        given = (self.gyros is not None) + (self.constant_c is not None) + bool(single)
        if given != 1 or len(single) not in (0, 3):
            raise ValueError("give either 'gyros', or all of 'gyro_x', 'gyro_y', 'gyro_z', or 'constant_c'")
        boards = [name for name in ("board_x", "board_y", "board_z") if getattr(self, name) is not None]
        if len(boards) not in (0, 3) or (boards and self.boards is not None):
            raise ValueError("give either 'boards' or all of 'board_x', 'board_y', 'board_z', or none")
        return self

    def by_quantity(self) -> dict[str, ScaledColumn]:
        """Column, scale and offset by quantity: ``gyro_x_c``, ``chamber_c``, ..."""
        columns = {f"{name}_c": getattr(self, name) for name in ("chamber_set", "chamber", "case")}
        for axis in AXES:
            for sensor, common in (("gyro", self.gyros), ("board", self.boards)):
                single = getattr(self, f"{sensor}_{axis}")
                columns[f"{sensor}_{axis}_c"] = single if single is not None else common
        return {name: self._converted(column) for name, column in columns.items() if column is not None}

    @model_validator(mode="after")
    def _check_named_units(self) -> Self:
        for column, scale, offset_c in self.by_quantity().values():
            if (unit := _unit_in_name(column)) in _KELVIN_OR_FAHRENHEIT and (scale, offset_c) == (1.0, 0.0):
                example = "offset_c: -273.15" if unit[0] == "k" else "scale: 0.55556, offset_c: -17.7778"
                raise ValueError(
                    f"column '{column}' is not in degC by its name. Convert it, as '{example}', or map it by "
                    "its number if the name is wrong"
                )
        return self

    def _converted(self, source: Column | TemperatureColumn) -> ScaledColumn:
        if not isinstance(source, TemperatureColumn):
            return source, self.scale, self.offset_c
        scale = self.scale if source.scale is None else source.scale
        return source.column, scale, self.offset_c if source.offset_c is None else source.offset_c


class StatusRule(StrictModel):
    """Which samples are valid."""

    column: Column = Field(description="column with the status")
    good: list[str | int] = Field(min_length=1, description="values of a valid sample")


class Accelerometers(AxisColumns):
    """Accelerometers that indicate the position; their unit does not matter."""

    tolerance_deg: float = Field(
        default=10.0, gt=0.0, le=45.0, description="windows tilted more are left out"
    )


class PositionRule(StrictModel):
    """In which of the six positions the unit is."""

    constant: PositionName | None = Field(default=None, description="the same in the whole log")
    column: Column | None = Field(default=None, description="column with the position")
    values: dict[str, PositionName] = Field(
        default={name: name for name in get_args(PositionName)},
        description="position for each value of that column",
    )
    accelerometers: Accelerometers | None = Field(
        default=None, description="the position nearest to what the accelerometers read"
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        _require_one(self, "constant", "column", "accelerometers")
        return self


class CycleRule(StrictModel):
    """Cycle of the temperature profile that a window belongs to."""

    constant: int | None = Field(default=None, ge=0, le=10**9, description="the same for all windows")
    column: Column | None = Field(default=None, description="column with whole numbers")
    block_s: Positive | None = Field(default=None, description="blocks of this length are numbered from 1")
    alternate: int | None = Field(
        default=None, ge=2, description="with 'block_s': deal the blocks in turn to this many cycles"
    )
    turning_point_c: Positive | None = Field(
        default=None,
        description="each leg of the temperature is a cycle; it turned when it came back by this much, K",
    )
    each_log: Literal[True] | None = Field(default=None, description="each log is one cycle")

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        _require_one(self, "constant", "column", "block_s", "turning_point_c", "each_log")
        if self.alternate is not None and self.block_s is None:
            raise ValueError("'alternate' deals out blocks; give 'block_s' too")
        return self


class EarthRate(StrictModel):
    """Place and azimuth for subtracting the Earth's rotation from the rates."""

    latitude_deg: float = Field(ge=-90.0, le=90.0, description="geodetic latitude, deg")
    azimuth_deg: float | None = Field(
        default=None,
        ge=-360.0,
        le=360.0,
        description="turn about Up from the position's azimuth 0, see docs/howto/write_a_procedure.md; "
        "without it only the vertical axis is freed",
    )


class CalibrationAccelerometers(AxisColumns):
    """Specific force or its increments; positive up at rest."""

    unit: ForceUnit = Field(description="unit; a velocity: increments since the sample before")


class CalibrationNoise(StrictModel):
    """Noise known from a data sheet or a long record."""

    angle_random_walk_deg_per_sqrt_h: Positive = Field(description="of each gyro, deg/sqrt(h)")
    velocity_random_walk_ug_per_sqrt_hz: Positive = Field(description="of each accelerometer, ug/sqrt(Hz)")


class CalibrationLog(Location):
    """What ``gyrobench calibrate`` needs beside the gyros; it ignores temperatures, position and windows."""

    accelerometers: CalibrationAccelerometers = Field(description="columns of the accelerometers")
    clock_sigma_ppm: float = Field(
        default=29.0,
        ge=0.0,
        le=1e4,
        description="standard uncertainty of the clock of the samples; default: a crystal within 50 ppm",
    )
    noise: CalibrationNoise | None = Field(
        default=None, description="random walks, where rests are too short to show them; default: measured"
    )
    whole_turns_arcsec: Positive | None = Field(
        default=None,
        description="standard uncertainty with which the table returns after whole turns; without it spins "
        "count as any other rotation",
    )


class Averages(NamedTuple):
    """Settings by which the samples of a log are averaged to dwells."""

    temperatures: TemperatureColumns
    position: PositionRule
    window_s: float


class LogMap(StrictModel):
    """The columns of a log and how they are averaged."""

    description: str = Field(default="", description="purpose, free text")
    unit: Name = Field(description="serial number of the unit")
    run: Name = Field(default="1", description="name of the power-on")
    each_log_is_a_run: bool = Field(
        default=False, description="each log is a separate power-on; else all share one power-on and clock"
    )
    since_power_on_s: NotNegative = Field(default=0.0, description="from power-on to the log's first sample")
    text: TextFormat | None = Field(default=None, description="the log is text")
    records: RecordFormat | None = Field(default=None, description="the log is binary records")
    signals: SignalFormat | None = Field(default=None, description="the log holds named signals")
    time: TimeRule = Field(description="how the samples are timed")
    gyro: GyroColumns = Field(description="which columns are the rates")
    temperatures: TemperatureColumns | None = Field(
        default=None, description="which columns are temperatures; required without 'calibration'"
    )
    status: StatusRule | None = Field(default=None, description="which samples are valid")
    position: Annotated[PositionRule, _from_plain_value("constant", PositionName, PositionRule)] | None = (
        Field(default=None, description="position of the unit; required without 'calibration'")
    )
    cycle: Annotated[CycleRule, _from_plain_value("constant", int, CycleRule)] = Field(
        default=CycleRule(constant=1), description="cycle of each window; a cycle can be held out"
    )
    earth_rate: EarthRate | None = Field(
        default=None, description="without it the Earth's rotation remains in the biases"
    )
    window_s: float | None = Field(
        default=None,
        ge=1e-3,
        le=1e12,
        description="length of the windows that are averaged; required without 'calibration'",
    )
    skip_s: NotNegative = Field(default=0.0, description="left out at the beginning of each log")
    max_gap_s: Positive | None = Field(
        default=None,
        description="longest time between samples; by default 5 sample intervals or 1 % of a window; "
        "gyrobench calibrate divides a log at each missing sample",
    )
    calibration: CalibrationLog | None = Field(
        default=None, description="for gyrobench calibrate: accelerometers and place"
    )

    @property
    def averages(self) -> Averages:
        """Settings that an import requires and a calibration ignores; DocumentError if one is missing."""
        required = self.temperatures, self.position, self.window_s
        missing = [name for name, each in zip(Averages._fields, required, strict=True) if each is None]
        if missing:
            raise DocumentError(f"the import map lacks {', '.join(map(repr, missing))}")
        if not self.gyro.unit.endswith(_PER_TIME):
            raise DocumentError(f"'gyro.unit: {self.gyro.unit}' is no rate")
        return Averages(*cast(Any, required))

    @property
    def calibrated(self) -> CalibrationLog:
        """Settings that a calibration requires; DocumentError if they are missing."""
        if self.calibration is None:
            raise DocumentError(
                "the import map has no section 'calibration' with the accelerometers and the latitude. Add it"
            )
        return self.calibration

    @model_validator(mode="after")
    def _check_consistency(self) -> Self:
        _require_one(self, "text", "records", "signals")
        if self.calibration is None:
            try:
                _ = self.averages
            except DocumentError as error:
                raise ValueError(f"{error}; only a map with 'calibration' may") from error
        if self.cycle.block_s is not None and self.window_s and self.cycle.block_s < self.window_s:
            raise ValueError(f"'cycle.block_s' is shorter than 'window_s' ({self.window_s:g} s)")
        return self


def load_log_map(path: Path, for_calibration: bool = False) -> LogMap:
    """Read an import map, which must have the settings for a calibration or for an import.

    Raises DocumentError, which lists everything that is wrong with it, each with its place.
    """
    log_map = validate(read_document(path), LogMap)
    try:
        _ = log_map.calibrated if for_calibration else log_map.averages
    except DocumentError as error:
        raise DocumentError(f"{path}: {error}") from error
    if log_map.signals is None or log_map.signals.dbc is None:
        return log_map
    name = log_map.signals.dbc
    dbc = next((folder / name for folder in (path.parent, _SHIPPED_DBC) if (folder / name).is_file()), None)
    if dbc is None:
        raise DocumentError(
            f"{path}: DBC file {name!r}: neither beside the import map nor shipped. Copy it there, or "
            "correct its name."
        )
    return log_map.model_copy(update={"signals": log_map.signals.model_copy(update={"dbc": str(dbc)})})
