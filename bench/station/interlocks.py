"""The station file's section `interlocks`: trip limits, and how the run resumes after a trip.

Every interlock has defaults; a station file gives only values that differ.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import ClassVar, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.station.instrument_sections import NotNegative, Positive
from gyrobench.drivers.ins.ins_status import InsStatus
from gyrobench.drivers.ins.signal_map import SignalMap

#: Margins of the default trip limits beyond the limits of the station.
_AIR_MARGIN_C = 5.0
_ANGLE_MARGIN_DEG = 1.0
_TABLE_RATE_FACTOR, _TABLE_RATE_MARGIN_DPS = 1.1, 0.5
_ACCELERATION_FACTOR = 1.5
_RAMP_FACTOR, _RAMP_MARGIN_C_PER_MIN = 1.5, 2.0
_SILENCE_S, _SILENT_READINGS = 30.0, 4

#: Interlocks that trip if the chamber does not control its air: a safe set point is then not enough.
CHAMBER_OUT_OF_CONTROL = frozenset({"chamber_air", "chamber_sensor"})
#: Interlocks after whose trip the INS may have been off, regardless of what it reports.
INS_MAY_BE_OFF = frozenset({"ins_silence", "ins_fault"})
#: Interlocks that forbid manual motion, and those that forbid manual chamber commands, while tripped.
FORBID_MANUAL_MOTION = frozenset({"table_silence", "table_rate", "table_acceleration"})
FORBID_MANUAL_CHAMBER = frozenset({"chamber_silence", "chamber_alarm"})

_RESUME = "person: an operator has to confirm that the run may resume; automatic: it resumes by itself"
_RESUME_AFTER = "time without a violation after which the run may resume, s"
_MAX_RESUMES = "how often in a run it resumes by itself after this trip; then an operator is needed"


def _value_or_default(value: float | None, default: float) -> float:
    return default if value is None else value


class InterlockRule(StrictModel):
    """How the run resumes after a trip: when an operator confirms it."""

    renamed_keys: ClassVar[Mapping[str, str]] = {"needs": "resume", "most_resumes": "max_resumes"}
    renamed_values: ClassVar[Mapping[str, Mapping[str, str]]] = {"resume": {"nobody": "automatic"}}

    resume: Literal["person", "automatic"] = Field("person", description=_RESUME)
    resume_after_s: NotNegative = Field(60.0, description=_RESUME_AFTER)
    max_resumes: int = Field(5, ge=0, description=_MAX_RESUMES)

    @model_validator(mode="after")
    def _check_range(self) -> Self:
        for unit in ("c", "deg"):
            low, high = getattr(self, f"low_{unit}", None), getattr(self, f"high_{unit}", None)
            if low is not None and high is not None and low >= high:
                raise ValueError(f"low_{unit} ({low:g}) must be below high_{unit} ({high:g})")
        return self


class PassingRule(InterlockRule):
    """How the run resumes after a trip that may pass: by itself."""

    resume: Literal["person", "automatic"] = Field("automatic", description=_RESUME)
    resume_after_s: NotNegative = Field(300.0, description=_RESUME_AFTER)


class TemperatureInterlock(InterlockRule):
    """Range of a temperature of the unit."""

    low_c: float = Field(-60.0, description="lowest temperature, degC")
    high_c: float = Field(95.0, description="highest temperature, degC")


class ChamberAirInterlock(InterlockRule):
    """Range of the chamber's air."""

    low_c: float | None = Field(
        None, description="lowest air temperature, degC; by default 5 K below the chamber's limit"
    )
    high_c: float | None = Field(
        None, description="highest air temperature, degC; by default 5 K above the chamber's limit"
    )

    def range_c(self, limits_c: Sequence[float]) -> tuple[float, float]:
        """Allowed range for a chamber with these limits."""
        low_c = _value_or_default(self.low_c, limits_c[0] - _AIR_MARGIN_C)
        return low_c, _value_or_default(self.high_c, limits_c[1] + _AIR_MARGIN_C)


class TemperatureRateInterlock(PassingRule):
    """How fast a temperature may change, up or down."""

    limit_c_per_min: Positive | None = Field(
        None, description="fastest change, degC/min; by default 1.5 times the chamber's fastest ramp plus 2"
    )
    window_s: Positive = Field(60.0, description="time over which the change is taken, s")

    def limit_or_default_c_per_min(self, ramp_c_per_min: float) -> float:
        """Fastest change for a chamber whose fastest ramp is ``ramp_c_per_min``."""
        return _value_or_default(self.limit_c_per_min, ramp_c_per_min * _RAMP_FACTOR + _RAMP_MARGIN_C_PER_MIN)


class TableRateInterlock(InterlockRule):
    """How fast an axis of the table may turn."""

    limit_dps: Positive | None = Field(
        None, description="fastest rate, deg/s; by default 1.1 times the limit plus 0.5"
    )

    def limit_or_default_dps(self, rate_dps: float) -> float:
        """Fastest turn for a table with this limit."""
        return _value_or_default(self.limit_dps, rate_dps * _TABLE_RATE_FACTOR + _TABLE_RATE_MARGIN_DPS)


class TableAccelerationInterlock(InterlockRule):
    """How fast the rate of an axis may change between two readings."""

    limit_dps2: Positive | None = Field(
        None, description="largest acceleration, deg/s2; by default 1.5 times the limit"
    )

    def limit_or_default_dps2(self, acceleration_dps2: float) -> float:
        """Largest acceleration for a table with this limit."""
        return _value_or_default(self.limit_dps2, acceleration_dps2 * _ACCELERATION_FACTOR)


class AngleInterlock(InterlockRule):
    """Range of an axis of the table."""

    low_deg: float | None = Field(
        None, description="lowest angle, deg; by default 1 deg below the axis's limit"
    )
    high_deg: float | None = Field(
        None, description="highest angle, deg; by default 1 deg above the axis's limit"
    )

    def range_deg(self, limits_deg: Sequence[float]) -> tuple[float, float]:
        """Allowed range for an axis with these limits."""
        low_deg = _value_or_default(self.low_deg, limits_deg[0] - _ANGLE_MARGIN_DEG)
        return low_deg, _value_or_default(self.high_deg, limits_deg[1] + _ANGLE_MARGIN_DEG)


class SilenceInterlock(PassingRule):
    """How old the last reply of an instrument may be."""

    limit_s: Positive | None = Field(
        None, description="oldest reply, s; by default 30 s, or four reading periods if these are longer"
    )

    def limit_or_default_s(self, period_s: float) -> float:
        """Maximum age of a reply of an instrument that is read every ``period_s``."""
        return _value_or_default(self.limit_s, max(_SILENCE_S, _SILENT_READINGS * period_s))


class InsSilenceInterlock(PassingRule):
    """How long the INS may send nothing while it is on."""

    limit_s: Positive = Field(5.0, description="longest silence, s")


class ChamberDeviationInterlock(PassingRule):
    """Whether the chamber's air stays at a set point that it had reached."""

    tolerance_c: Positive = Field(5.0, description="allowed difference of the air, K")


class ChamberSensorInterlock(InterlockRule):
    """Whether the unit follows the air that the chamber reads."""

    margin_c: Positive = Field(
        10.0,
        description="allowed difference between unit and air, K, while the unit moves away from the air; "
        "above the air it is added to `unit.thermal.self_heating_c`",
    )


class ChamberCommandInterlock(InterlockRule):
    """Whether the chamber still has the commanded set point and state (on or off)."""

    tolerance_c: Positive = Field(
        0.6,
        description="allowed difference of the set point, K; a controller with whole degrees rounds by 0.5 K",
    )


class InsTemperature(NamedTuple):
    """A temperature that the INS sends, and its interlocks."""

    what: str
    read: Callable[[InsStatus], float]
    keys: tuple[str, str]  #: Of its interlocks.
    level: TemperatureInterlock
    rate: TemperatureRateInterlock


class Interlocks(StrictModel):
    """What is monitored at every tick, in every step."""

    renamed_keys: ClassVar[Mapping[str, str]] = {"longest_hold_s": "max_hold_s"}

    max_hold_s: Positive = Field(86_400.0, description="a hold longer than this ends the run, s")
    chamber_air: ChamberAirInterlock = Field(
        ChamberAirInterlock(), description="temperature of the chamber's air"
    )
    chamber_air_rate: TemperatureRateInterlock = Field(
        TemperatureRateInterlock(), description="its rate; an opened door shows here"
    )
    case_temperature: TemperatureInterlock = Field(
        TemperatureInterlock(), description="temperature of the unit's case"
    )
    case_rate: TemperatureRateInterlock = Field(TemperatureRateInterlock(), description="its rate")
    gyro_temperature: TemperatureInterlock = Field(
        TemperatureInterlock(), description="temperatures of the gyros, optics and electronics"
    )
    gyro_rate: TemperatureRateInterlock = Field(TemperatureRateInterlock(), description="their rates")
    table_rate: TableRateInterlock = Field(
        TableRateInterlock(), description="rate of either axis of the table"
    )
    table_acceleration: TableAccelerationInterlock = Field(
        TableAccelerationInterlock(), description="acceleration of either axis"
    )
    outer_angle: AngleInterlock = Field(AngleInterlock(), description="angle of the outer axis")
    inner_angle: AngleInterlock = Field(AngleInterlock(), description="angle of the inner axis")
    table_silence: SilenceInterlock = Field(SilenceInterlock(), description="the table does not answer")
    chamber_silence: SilenceInterlock = Field(SilenceInterlock(), description="the chamber does not answer")
    ins_silence: InsSilenceInterlock = Field(
        InsSilenceInterlock(), description="the INS is on and sends nothing"
    )
    chamber_command: ChamberCommandInterlock = Field(
        ChamberCommandInterlock(),
        description="the chamber differs from the command: another set point, or switched off at its panel",
    )
    chamber_deviation: ChamberDeviationInterlock = Field(
        ChamberDeviationInterlock(),
        description="the chamber has reached its set point, but its air does not stay there",
    )
    chamber_sensor: ChamberSensorInterlock = Field(
        ChamberSensorInterlock(),
        description="the unit's temperatures move away from the air that the chamber reads, as with a sensor "
        "that is stuck; the chamber is then switched off in the safe state",
    )
    table_fault: InterlockRule = Field(
        InterlockRule(), description="the table reports a fault, or an axis is not under servo control"
    )
    chamber_alarm: InterlockRule = Field(
        InterlockRule(), description="the chamber reports an alarm or a broken sensor"
    )
    ins_fault: InterlockRule = Field(InterlockRule(), description="the INS reports a fault")

    def rules(self) -> dict[str, InterlockRule]:
        """All interlocks by their keys."""
        fields = ((name, getattr(self, name)) for name in type(self).model_fields)
        return {name: rule for name, rule in fields if isinstance(rule, InterlockRule)}

    def ins_temperatures(self, signals: SignalMap) -> Iterator[InsTemperature]:
        """Yield the temperatures in a signal map."""
        if signals.case_temperature is not None:
            keys = "case_temperature", "case_rate"
            yield InsTemperature("case", lambda ins: ins.case_c, keys, self.case_temperature, self.case_rate)
        keys = "gyro_temperature", "gyro_rate"
        for part, mapped in (
            ("optics", signals.gyro_optics_temperature),
            ("electronics", signals.gyro_electronics_temperature),
        ):
            for index, axis in enumerate("xyz" if mapped is not None else ""):
                read = _gyro_temperature(f"{part}_c", index)
                name = f"{part} of gyro {axis}"
                yield InsTemperature(name, read, keys, self.gyro_temperature, self.gyro_rate)


def _gyro_temperature(attribute: str, index: int) -> Callable[[InsStatus], float]:
    return lambda ins: getattr(ins, attribute)[index]
