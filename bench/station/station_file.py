"""The station file's model."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any, Literal, Self
from urllib.parse import urlsplit

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from gyrobench.bench.foundations.documents import (
    Document,
    DocumentProblem,
    StrictModel,
    read_document,
    validate,
)
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.location import Location
from gyrobench.bench.station.instrument_sections import (
    ChamberSection,
    Identity,
    LaboratorySection,
    Mounting,
    NotNegative,
    Positive,
    RateTableSection,
    Traceability,
    without_password,
)
from gyrobench.bench.station.interlocks import Interlocks
from gyrobench.bench.station.receivers import Receiver
from gyrobench.drivers import ins as ins_driver
from gyrobench.drivers.ins.command_map import CommandMap
from gyrobench.drivers.ins.signal_map import SignalMap

_LOOPBACK = ("127.0.0.1", "localhost", "::1")
_SERVED_INTERFACES = ("slcan", "socketcand", "emulator")
_LOCAL_SCHEMES = ("emulator", "replay")


def _fast_clock_problem(addresses: Iterable[str], interface: str, host: str) -> str:
    """Describe an address that is not of an emulated bench on this computer; empty if all are.

    ``addresses`` are the ports of table and chamber and the CAN channel, ``host`` that of the bus's options.
    """
    if interface not in _SERVED_INTERFACES:
        return f"ins.interface: {interface} reaches a real bus"
    if host and host not in _LOOPBACK:
        return f"{host} is another computer"
    for address in addresses:
        if address.startswith("/dev/") and not address.startswith("/dev/pts/"):
            return f"{address} is a real port"
        url = urlsplit(address)
        if url.scheme and url.scheme not in _LOCAL_SCHEMES and url.hostname not in _LOOPBACK:
            return f"{address} is not an address of this computer"
    return ""


def _option_key(key: str) -> str:
    if _SECRET.search(key):
        raise ValueError(f"'{key}' looks like a secret, and every run folder has a copy of this file")
    return key


_SECRET = re.compile(r"passw|secret|token|credential|api_?key", re.IGNORECASE)


class InsNoise(StrictModel):
    """Noise of the INS, from its data sheet or an Allan deviation."""

    angle_random_walk_deg_per_sqrt_h: Positive = Field(description="of each gyro, deg/sqrt(h)")
    velocity_random_walk_ug_per_sqrt_hz: NotNegative = Field(
        0.0, description="of each accelerometer, ug/sqrt(Hz)"
    )
    velocity_output_mps: NotNegative = Field(
        0.0, description="noise of the velocity output beyond its resolution, m/s"
    )
    heading_output_deg: NotNegative = Field(
        0.0, description="noise of the heading output beyond its resolution, deg"
    )


_ESTIMATED = "estimated"
_WRITE_NOISE = "write `estimated` (from the output of the INS in each dwell), or give " + ", ".join(
    InsNoise.model_fields
)


def _noise_tag(value: Any) -> str | None:
    if isinstance(value, dict | InsNoise):
        return "declared"
    return _ESTIMATED if value == _ESTIMATED else None


#: Discriminated union, so that a mistake in one kind is not reported for the other.
Noise = Annotated[
    Annotated[InsNoise, Tag("declared")] | Annotated[Literal["estimated"], Tag(_ESTIMATED)],
    Discriminator(_noise_tag, custom_error_type="no_such_noise", custom_error_message=_WRITE_NOISE),
]


class InsUncertainty(StrictModel):
    """Standard uncertainties of the INS's errors other than bias and noise, from its last calibration."""

    accelerometer_bias_ug: NotNegative = Field(
        1000.0, description="bias of each accelerometer, ug; a large value leaves it to the data"
    )
    accelerometer_drift_ug_per_h: NotNegative = Field(
        20.0, description="change of each accelerometer's bias in a dwell, ug/h"
    )
    accelerometer_slope_ug_per_c: NotNegative = Field(
        0.0, description="change of each accelerometer's bias with the temperature of the case, ug/K"
    )
    accelerometer_transient_ug: NotNegative = Field(
        20.0, description="transient of each accelerometer's bias after a turn, ug"
    )
    accelerometer_misalignment_arcsec: NotNegative = Field(
        5.0, description="misalignment of each accelerometer, arcsec; for dwells solved together"
    )
    gyro_scale_factor_ppm: NotNegative = Field(5.0, description="scale factor of each gyro, ppm")
    gyro_misalignment_arcsec: NotNegative = Field(2.0, description="of each gyro, arcsec")
    tilt_step_arcsec: NotNegative = Field(
        1.0, description="tilt of the sensors on their mount from a turn, arcsec"
    )
    bias_slope_dph_per_c: NotNegative = Field(
        0.001, description="change of a gyro's bias with its temperature, deg/h/K"
    )
    gyro_temperature_c: NotNegative | None = Field(
        None, description="the gyros' temperature sensors, K; for the uncertainty budget"
    )


Channel = Annotated[str, Field(min_length=1), AfterValidator(without_password)]
BusOptions = dict[Annotated[str, AfterValidator(_option_key)], str | int | float | bool]
_IDENTIFIER_OFFSET = (
    "added to the CAN identifier of every message of the DBC, so that several units can share one bus"
)


_DBC_PATTERN = r"^[^/\\\x00]{1,100}\.[dD][bB][cC]$"


class InsSection(StrictModel):
    """The INS and its CAN bus."""

    interface: str = Field(
        min_length=1, description="python-can interface: socketcan, slcan, socketcand, ..."
    )
    channel: Channel = Field(description="python-can channel")
    bitrate: int | None = Field(None, gt=0, description="bit/s, if the interface sets it")
    options: BusOptions = Field({}, description="further options of the python-can interface")
    dbc: str = Field(
        pattern=_DBC_PATTERN,
        description="name of a DBC file, NAME.dbc, next to the station file, or of a shipped one",
    )
    identifier_offset: int = Field(0, description=_IDENTIFIER_OFFSET)
    identity: Identity = ""
    signals: SignalMap = Field(description="signals of the quantities")
    commands: CommandMap = Field(CommandMap(), description="messages of the commands")
    noise: Noise = Field(description=_WRITE_NOISE)
    uncertainty: InsUncertainty = Field(
        InsUncertainty(), description="uncertainty of the INS's errors other than bias and noise"
    )

    @property
    def is_emulated(self) -> bool:
        """Whether the INS is emulated inside this process."""
        return self.interface == "emulator"


class ThermalEstimateSection(StrictModel):
    """How the gyros follow the chamber; for estimates of duration only."""

    time_constant_s: Positive = Field(2400.0, description="of the gyros behind the air, s")
    self_heating_c: float = Field(15.0, description="gyros above the air in the steady state, K")
    room_c: float = Field(23.0, description="temperature of the room, degC")


class UnitSection(StrictModel):
    """The unit under test on this bench."""

    power: Literal["chamber_event", "operator", "always_on"] = Field(description="what switches its supply")
    power_event: int = Field(2, ge=1, le=8, description="event output of the chamber's controller")
    thermal: ThermalEstimateSection = Field(
        ThermalEstimateSection(), description="how the gyros follow the chamber; for estimates of duration"
    )


def _off_to_none(value: Any) -> Any:
    return None if value == "off" else value


class SafeState(StrictModel):
    """State of the bench at any end."""

    chamber_c: Annotated[
        float | None, BeforeValidator(_off_to_none, json_schema_input_type=float | Literal["off"] | None)
    ] = Field(description="safe set point, degC, or off")
    unit: Literal["keep", "off"] = Field(description="leave the INS powered as it is, or switch it off")
    on_pause: Literal["keep", "safe"] = Field(
        "keep", description="while a run is paused: keep the present state, or the safe state"
    )


class GuardSection(StrictModel):
    """The process that brings the bench to its safe state when the engine can't."""

    silence_s: float = Field(
        60.0,
        ge=5.0,
        le=600.0,
        description="the engine is killed and the bench made safe after this time without a sign of life, s; "
        "normal operation causes up to 20 s of silence",
    )


def _text_of_number(value: Any) -> Any:
    return str(value) if type(value) is int else value


class UnitEntry(StrictModel):
    """One of several units on the bench, and what differs from the sections that all of them share."""

    number: Annotated[str, BeforeValidator(_text_of_number, json_schema_input_type=str | int)] = Field(
        pattern="^[A-Za-z0-9][A-Za-z0-9_-]{0,39}$",
        description="serial number; names its folder `units/NUMBER` in a run folder",
    )
    interface: str | None = Field(None, min_length=1, description="as in `ins`")
    channel: Channel | None = Field(None, description="as in `ins`")
    bitrate: int | None = Field(None, gt=0, description="as in `ins`")
    options: BusOptions | None = Field(None, description="as in `ins`")
    identifier_offset: int | None = Field(None, description=_IDENTIFIER_OFFSET)
    identity: Identity | None = Field(None, description="as in `ins`")
    noise: Noise | None = Field(None, description="as in `ins`")
    uncertainty: InsUncertainty | None = Field(None, description="as in `ins`")
    mounting: Mounting | None = Field(None, description="as in `rate_table`")
    power_event: int | None = Field(None, ge=1, le=8, description="as in `unit`")


#: Keys of a unit, by the section whose keys they replace.
UNIT_KEYS = {
    "ins": (
        "interface", "channel", "bitrate", "options", "identifier_offset", "identity", "noise", "uncertainty"
    ),
    "rate_table": ("mounting",),
    "unit": ("power_event",),
}  # fmt: skip


class StationFile(StrictModel):
    """A station file."""

    station: str = Field(pattern="^[A-Za-z0-9_-]{1,80}$", description="name of the bench")
    description: str = Field("", description="description of the bench")
    clock: Literal["wall", "virtual"] = Field(
        "wall", description="virtual: time passes as fast as the work allows; for emulated benches"
    )
    speed: float = Field(
        1.0,
        ge=1.0,
        le=100.0,
        description="seconds of the bench per second of this computer, as with `gyrobench emulate --speed`",
    )
    location: Location = Field(description="where the bench is")
    tick_s: Annotated[float, Field(ge=0.1, le=10.0)] = Field(1.0, description="period of the engine, s")
    poll_period_s: Annotated[float, Field(ge=0.01, le=10.0)] = Field(
        0.1, description="period at which the CAN bus is read, s; on virtual time with each reading"
    )
    instruments_period_s: Annotated[float, Field(ge=0.5, le=60.0)] = Field(
        5.0, description="period at which table, chamber and INS status are read, s"
    )
    rate_table: RateTableSection = Field(description="the rate table")
    chamber: ChamberSection = Field(description="the thermal chamber")
    ins: InsSection = Field(description="the INS and its CAN bus")
    unit: UnitSection = Field(description="the unit under test")
    units: Annotated[list[UnitEntry], Field(max_length=16)] = Field(
        [], description="several units that are measured at once; without it there is one"
    )
    drop_units: bool = Field(
        True,
        description="whether one of several units that fails is dropped for the rest of the run; otherwise "
        "the run holds for all",
    )
    safe_state: SafeState = Field(description="state of the bench at any end of a run")
    block_approval: Literal["ask", "auto"] = Field(
        "ask",
        description="auto: `gyrobench investigate --approve auto` may measure here what it proposes, without "
        "a person's approval",
    )
    guard: GuardSection = Field(
        GuardSection(), description="the process that makes the bench safe when the engine can't"
    )
    interlocks: Interlocks = Field(
        Interlocks(), description="what is monitored, and how the run resumes after a trip"
    )
    laboratory: LaboratorySection | None = Field(None, description="the laboratory, for certificates")
    traceability: Traceability = Field(
        Traceability(), description="calibrations of the instruments that results are traced to"
    )
    messages: Annotated[list[Receiver], Field(max_length=20)] = Field(
        [], description="receivers of messages about a run, also of an emulated one"
    )

    @model_validator(mode="after")
    def _check_safe_state(self) -> Self:
        limits, safe_c = self.chamber.limits, self.safe_state.chamber_c
        if safe_c is not None and not limits.low_c <= safe_c <= limits.high_c:
            raise ValueError(
                f"safe_state.chamber_c ({safe_c:g}) is outside the chamber's limits "
                f"({limits.low_c:g} to {limits.high_c:g})"
            )
        if self.safe_state.unit == "off" and self.unit.power != "chamber_event":
            raise ValueError(
                f"safe_state.unit: off is not possible with unit.power: {self.unit.power}; use keep"
            )
        return self

    @model_validator(mode="after")
    def _check_interlocks(self) -> Self:
        """Interlocks must not trip within the limits, against which procedures are checked."""
        rules, chamber, table = self.interlocks, self.chamber.limits, self.rate_table
        chamber_c = (chamber.low_c, chamber.high_c)
        outer_deg, inner_deg = table.outer_limits_deg, table.inner_limits_deg
        ranges = (
            ("chamber_air", rules.chamber_air.range_c(chamber_c), chamber_c, "degC"),
            ("outer_angle", rules.outer_angle.range_deg(outer_deg), outer_deg, "deg"),
            ("inner_angle", rules.inner_angle.range_deg(inner_deg), inner_deg, "deg"),
        )
        upper_limits = (
            ("chamber_air_rate", rules.chamber_air_rate.limit_c_per_min, chamber.ramp_c_per_min, "degC/min"),
            ("table_rate", rules.table_rate.limit_dps, table.limits.rate_dps, "deg/s"),
        )
        problems = [
            f"interlocks.{name} trips outside {low:g} to {high:g} {unit}, within the limits of "
            f"{limits[0]:g} to {limits[1]:g} {unit}"
            for name, (low, high), limits, unit in ranges
            if low > limits[0] or high < limits[1]
        ] + [
            f"interlocks.{name} trips above {trip:g} {unit}, within the limit of {limit:g} {unit}"
            for name, trip, limit, unit in upper_limits
            if trip is not None and trip < limit
        ]
        if problems:
            raise ValueError(
                "; ".join(f"{each}. Widen the interlock or narrow the limits" for each in problems)
            )
        return self

    @model_validator(mode="after")
    def _check_virtual_clock(self) -> Self:
        if self.clock == "virtual" and not self.is_emulated():
            raise ValueError("clock: virtual requires emulated instruments only; real ones need clock: wall")
        return self

    @model_validator(mode="after")
    def _check_speed(self) -> Self:
        ports = (self.rate_table.port, self.chamber.port)
        reasons = [
            _fast_clock_problem((*ports, ins.channel), ins.interface, str(ins.options.get("host", "")))
            for ins in self.ins_sections
        ]
        problem = next(filter(None, reasons), "") if self.speed != 1.0 else ""
        if self.speed != 1.0 and self.clock == "virtual":
            problem = "clock: virtual is as fast as possible; use clock: wall"
        if problem:
            raise ValueError(f"speed: {self.speed:g} is for an emulated bench on this computer; {problem}")
        return self

    @model_validator(mode="after")
    def _check_units(self) -> Self:
        numbers = [unit.number for unit in self.units]
        if len(set(numbers)) < len(numbers):
            raise ValueError(f"units: two have the same number; found {', '.join(numbers)}")
        bus_addresses: dict[str, str] = {}
        for unit, ins in zip(self.units, self.ins_sections, strict=False):
            bus_address = f"{ins.interface} {ins.channel}, identifier_offset {ins.identifier_offset}"
            if (
                other_number := bus_addresses.setdefault(f"{bus_address} {ins.options}", unit.number)
            ) != unit.number:
                raise ValueError(
                    f"units: {other_number} and {unit.number} are at the same place of one bus "
                    f"({bus_address}); give each its channel, or its identifier_offset"
                )
            if unit.power_event is not None and self.unit.power != "chamber_event":
                raise ValueError(f"units: power_event is not possible with unit.power: {self.unit.power}")
        return self

    @property
    def ins_sections(self) -> list[InsSection]:
        """The section ``ins`` of each unit, with the unit's keys; for a single unit the file's section."""
        return [
            self.ins.model_copy(
                update={key: value for key in UNIT_KEYS["ins"] if (value := getattr(unit, key)) is not None}
            )
            for unit in self.units
        ] or [self.ins]

    def emulated_instruments(self) -> list[bool]:
        """Whether each instrument is emulated inside this process: table, chamber, bus of each unit."""
        buses = (ins.is_emulated for ins in self.ins_sections)
        return [self.rate_table.is_emulated, self.chamber.is_emulated, *buses]

    def is_emulated(self) -> bool:
        """Whether every instrument is emulated inside this process."""
        return all(self.emulated_instruments())


def load_station_file(path: Path) -> tuple[Document, StationFile]:
    """Read and check a station file; a DocumentError lists all problems with their places."""
    document = read_document(path)
    return document, validate(document, StationFile, _missing_dbc(document))


def find_dbc(station: Path, name: str) -> Path:
    """Path of the DBC file with this name: next to the station file, or shipped with the INS driver.

    Raises DocumentError if there is no such file.
    """
    for folder in (station.parent, Path(ins_driver.__file__).parent):
        if (folder / name).is_file():
            return folder / name
    raise DocumentError(
        f"DBC file {name!r}: neither beside the station file nor shipped. Copy it there, or correct its name."
    )


def _missing_dbc(document: Document) -> list[DocumentProblem]:
    section = document.data.get("ins") if isinstance(document.data, dict) else None
    name = section.get("dbc") if isinstance(section, dict) else None
    if not isinstance(name, str) or not re.fullmatch(_DBC_PATTERN, name):
        return []
    try:
        find_dbc(document.path, name)
    except DocumentError as error:
        return [DocumentProblem(("ins", "dbc"), str(error))]
    return []
