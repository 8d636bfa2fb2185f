"""A station: its file, and the kinematics, limits and measurement set-up derived from it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np
from cantools.database import Database

from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.clock import Clock, VirtualClock, WallClock
from gyrobench.bench.foundations.documents import FILL_IN, Document, DocumentProblem, parse_document, validate
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.foundations.yaml_nodes import KeyPath
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import POSITIONS, PositionName
from gyrobench.bench.navigation.table_axes import Angles, SingleAxisTable, TurnOrMove, TwoAxisTable
from gyrobench.bench.procedure.checks import StationLimits, check_plan
from gyrobench.bench.procedure.estimate import BenchEstimate, TableEstimate, ThermalEstimate
from gyrobench.bench.procedure.plan import Plan, expand
from gyrobench.bench.procedure.procedure_file import Procedure, checked_procedure
from gyrobench.bench.procedure.steps import GoTo, Step
from gyrobench.bench.station.instrument_sections import Direction, Mounting
from gyrobench.bench.station.station_file import UNIT_KEYS, StationFile, find_dbc, load_station_file
from gyrobench.drivers.ins.can_bus import INSTRUMENT
from gyrobench.drivers.ins.command_map import check_commands
from gyrobench.drivers.ins.dbc_codec import DbcCodec, load_dbc
from gyrobench.drivers.ins.signal_map import check_signals

_DIRECTIONS: dict[Direction, tuple[float, float, float]] = {
    "east": (1.0, 0.0, 0.0),
    "north": (0.0, 1.0, 0.0),
    "up": (0.0, 0.0, 1.0),
    "west": (-1.0, 0.0, 0.0),
    "south": (0.0, -1.0, 0.0),
    "down": (0.0, 0.0, -1.0),
}


class Station:
    """A bench as described by its station file."""

    def __init__(self, path: Path, number: str = "") -> None:
        self.path = path  #: Path of the file; file names in it are relative to its folder.
        self.number = number  #: Serial number of its only unit, if the bench has several; otherwise empty.
        self._document, self.file = load_station_file(path)  #: The file's content.
        if number:
            self._document = _document_of_unit(self._document, number)
            self.file = validate(self._document, StationFile)
        port = self.file.rate_table.port
        if port == self.file.chamber.port and not port.startswith(FILL_IN):
            problem = f"the rate table has the port {port} too. Give each instrument the port that it is on"
            raise self._document.error([DocumentProblem(("chamber", "port"), problem)])
        for key in ("chamber_event", "chamber_output"):
            if not self.file.units and getattr(self.file.chamber, key, None) in self.power_events:
                problem = f"output {self.file.unit.power_event} switches the chamber itself, by chamber.{key}"
                raise self._document.error([DocumentProblem(("unit", "power_event"), problem)])
        outer, inner = self.file.rate_table.outer_axis, self.file.rate_table.inner_axis
        if outer is not None and _vector(outer) @ _vector(inner):
            problem = f"the inner axis must be perpendicular to the outer axis ({outer}); found {inner}"
            raise self._document.error([DocumentProblem(("rate_table", "inner_axis"), problem)])
        try:
            self.table = self._table()  #: Kinematics of the table with the unit on it.
        except DocumentError as error:
            raise self._document.error([DocumentProblem(("rate_table", "mounting"), str(error))]) from error

    @property
    def not_filled_in(self) -> list[str]:
        """Keys whose value is still a placeholder, such as ``chamber.port``."""
        return [".".join(map(str, keys)) for keys in _placeholders(self._document.data, ())]

    @cached_property
    def units(self) -> tuple[Station, ...]:
        """One station for each unit of the bench; the station itself if there is a single unit."""
        return tuple(Station(self.path, unit.number) for unit in self.file.units) or (self,)

    @property
    def instrument(self) -> str:
        """Name of the INS in messages."""
        return f"{INSTRUMENT} {self.number}" if self.number else INSTRUMENT

    @property
    def text(self) -> str:
        """Text of the station file."""
        return self._document.text

    @property
    def power_events(self) -> tuple[int, ...]:
        """Event outputs of the chamber that supply the units; empty if the chamber does not switch them."""
        if self.file.unit.power != "chamber_event":
            return ()
        return tuple(sorted({station.file.unit.power_event for station in self.units}))

    def shares_bus(self, unit: Station) -> bool:
        """Whether another unit is on the same bus as ``unit``."""
        return sum(each.bus == unit.bus for each in self.units) > 1

    @property
    def bus(self) -> tuple[str, ...]:
        """Identification of the CAN bus of its unit."""
        ins = self.file.ins
        return ins.interface, ins.channel, *(str(ins.options.get(key, "")) for key in ("host", "port"))

    def position_of_unit(self, position: str, azimuth_deg: float) -> tuple[PositionName, float]:
        """Position and azimuth, deg, of its unit for those in a procedure: mountings may differ."""
        reference = self.file.rate_table.reference_mounting
        C_nb = POSITIONS[position].C_nb()
        if reference is not None:
            C_nb = C_nb @ _mounting_attitude(reference).T @ self.table.C_mount
        for name, each in POSITIONS.items():
            C_rotation = C_nb @ each.C_nb().T
            if np.isclose(C_rotation[2, 2], 1.0):
                offset_deg = round(np.rad2deg(np.arctan2(C_rotation[1, 0], C_rotation[0, 0])).item(), 9)
                return cast(PositionName, name), (azimuth_deg + offset_deg) % 360.0
        raise AssertionError("mountings have axes along directions")

    @property
    def is_virtual(self) -> bool:
        """Whether the bench runs on virtual time, without an operator."""
        return self.file.clock == "virtual"

    def new_clock(self) -> Clock:
        """Create a clock of the kind in the file, starting at zero."""
        return VirtualClock() if self.is_virtual else WallClock(speed=self.file.speed)

    @cached_property
    def site(self) -> Site:
        """Location of the bench."""
        return self.file.location.site

    @property
    def gravity_and_sigma(self) -> tuple[float | None, float]:
        """Local gravity, m/s^2, None if it is not known, and its standard uncertainty."""
        location = self.file.location
        return location.gravity_mps2, location.gravity_sigma

    @property
    def gravity_caution(self) -> str:
        """Warning about the gravity of a real bench; see :class:`Location`."""
        return "" if self.file.is_emulated() else self.file.location.gravity_caution

    @cached_property
    def dbc_path(self) -> Path:
        """Path of the DBC file: next to the station file, or shipped with the INS driver.

        Raises DocumentError if there is no such file.
        """
        return find_dbc(self.path, self.file.ins.dbc)

    def check_dbc(self) -> None:
        """Check signals and commands of the INS against the DBC file.

        Raises DocumentError with all problems; a problem at several places is listed once.
        """
        try:
            codecs = [DbcCodec(unit.database()) for unit in self.units]
        except DocumentError as error:
            raise self._document.error([DocumentProblem(("ins", "dbc"), str(error))]) from error
        codec = codecs[0]
        identifiers: dict[tuple[object, ...], Station] = {}
        for unit, unit_codec in zip(self.units, codecs, strict=True):
            for identifier in unit_codec.arbitration_ids().tolist():
                other = identifiers.setdefault((*unit.bus, identifier), unit)
                if other is not unit:
                    message = (
                        f"{other.instrument} and {unit.instrument} share a bus and both use the identifier "
                        f"{identifier}. Choose identifier_offset further apart"
                    )
                    raise self._document.error([DocumentProblem(("units",), message)])
        signals = [quantity.source.signal for quantity in self.file.ins.signals.quantities().values()]
        if not any(signal.partition(".")[0] in codec for signal in signals):
            message = (
                f"DBC file '{self.file.ins.dbc}' has none of the messages in ins.signals. Name the DBC file "
                "of this INS, or correct ins.signals"
            )
            raise self._document.error([DocumentProblem(("ins", "dbc"), message)])
        problems = [
            *check_signals(self.file.ins.signals, codec, ("ins", "signals")),
            *check_commands(self.file.ins.commands, codec, ("ins", "commands")),
        ]
        if problems:
            raise self._document.error({each.message: each for each in reversed(problems)}.values())

    def database(self) -> Database:
        """Read the DBC file, with the identifier offset of the unit.

        Raises DocumentError if the file is missing or wrong.
        """
        return load_dbc(self.dbc_path, self.file.ins.identifier_offset)

    def noise(self, velocity_lsb_mps: float, heading_lsb_rad: float) -> NoiseModel | None:
        """Declared noise of the INS, with the output's resolution; None if it is to be estimated."""
        declared = self.file.ins.noise
        if declared == "estimated":
            return None
        return NoiseModel.from_datasheet(
            declared.angle_random_walk_deg_per_sqrt_h,
            declared.velocity_random_walk_ug_per_sqrt_hz,
            velocity_lsb_mps,
            heading_lsb_rad,
            declared.velocity_output_mps,
            np.deg2rad(declared.heading_output_deg),
        )

    def prior(self) -> PriorKnowledge:
        """Prior knowledge of the INS and the site."""
        return PriorKnowledge.from_datasheet(
            latitude_arcmin=self.file.location.latitude_uncertainty_arcmin,
            **self.file.ins.uncertainty.model_dump(exclude={"gyro_temperature_c"}),
        )

    def plan(self, document: Document, procedure: Procedure, bench: BenchEstimate | None = None) -> Plan:
        """Plan a checked procedure; raises DocumentError with all that this station can't run, and places.

        ``bench``: state at the start; by default at rest.
        """
        has_reference = self.file.rate_table.reference_mounting is not None
        adapt = self._adapted_to_unit if has_reference else None
        plan = expand(document, procedure, bench or self.bench_at_rest(), adapt)
        check_plan(document, plan, self.limits())
        return plan

    def plan_document(self, document: Document) -> Plan:
        """Check and plan a procedure; raises DocumentError with all its problems."""
        return self.plan(document, checked_procedure(document))

    def _adapted_to_unit(self, step: Step) -> Step:
        if not isinstance(step, GoTo):
            return step
        position, azimuth_deg = self.position_of_unit(step.position, step.azimuth_deg)
        return step.model_copy(update={"position": position, "azimuth_deg": azimuth_deg})

    def bench_at_rest(self) -> BenchEstimate:
        """State of the bench before a run, for estimates of duration."""
        thermal, limits = self.file.unit.thermal, self.file.rate_table.limits
        bench = BenchEstimate.at_rest(ThermalEstimate(**thermal.model_dump()))
        table = TableEstimate(self.table, limits.acceleration_dps2, limits.jerk_dps3, self.file.tick_s)
        return replace(bench, table=table, angles_deg=(0.0, 0.0))

    def limits(self) -> StationLimits:
        """Limits that a plan must keep."""
        chamber, gyro = self.file.chamber.limits, self.file.interlocks.gyro_temperature
        return StationLimits(
            chamber_low_c=chamber.low_c,
            chamber_high_c=chamber.high_c,
            ramp_max_c_per_min=chamber.ramp_c_per_min,
            table_rate_max_dps=self.file.rate_table.limits.rate_dps,
            unreachable_reason=self._unreachable_reason,
            gyro_low_c=gyro.low_c,
            gyro_high_c=gyro.high_c,
            ins_commands=frozenset(name for name, command in self.file.ins.commands if command is not None),
            has_gyro_temperatures=self.file.ins.signals.gyro_optics_temperature is not None,
            is_always_on=self.file.unit.power == "always_on",
        )

    def by_axis_number(self, angles: Angles) -> dict[int, float]:
        """Outer and inner angle by the controller's axis numbers."""
        section = self.file.rate_table
        if section.is_single_axis:
            return {section.inner_axis_number: angles[1]}
        return {section.outer_axis_number: angles[0], section.inner_axis_number: angles[1]}

    def table_axes_of(self, values: Sequence[float]) -> Angles:
        """Outer and inner value from those in the order of axis numbers; outer is 0 with a single axis."""
        section = self.file.rate_table
        if section.is_single_axis:
            (inner,) = values
            return 0.0, inner
        first, second = values
        return (first, second) if section.outer_axis_number < section.inner_axis_number else (second, first)

    def _unreachable_reason(
        self, position: str, azimuth_deg: float, turns_deg: tuple[TurnOrMove, ...]
    ) -> str | None:
        try:
            self.table.angles(POSITIONS[position].C_nb(np.deg2rad(azimuth_deg)), turns_deg)
        except DocumentError as error:
            return str(error)
        return None

    def _table(self) -> TwoAxisTable:
        section = self.file.rate_table
        C_mount = _mounting_attitude(section.mounting)
        inner_axis = _vector(section.inner_axis)
        if section.outer_axis is None:
            return SingleAxisTable.about(inner_axis, C_mount, section.inner_limits_deg)
        return TwoAxisTable(
            outer_axis_enu=_vector(section.outer_axis),
            inner_axis_enu=inner_axis,
            C_mount=C_mount,
            outer_limits_deg=section.outer_limits_deg,
            inner_limits_deg=section.inner_limits_deg,
        )


def _placeholders(value: Any, path: KeyPath) -> Iterator[KeyPath]:
    if isinstance(value, str) and value.startswith(FILL_IN):
        yield path
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, each in items:
        yield from _placeholders(each, (*path, key))


def _mounting_attitude(mounting: Mounting) -> FloatArray:
    """Attitude ``C_nb``, shape (3, 3), of a unit with this mounting with the table's angles at zero."""
    return np.stack([_vector(axis) for axis in (mounting.x, mounting.y, mounting.z)], axis=1)


def _document_of_unit(document: Document, number: str) -> Document:
    """Station file reduced to one of the units."""
    data = {key: value for key, value in document.data.items() if key not in ("units", "drop_units")}
    (entry,) = (entry for entry in document.data["units"] if str(entry["number"]) == number)
    for section, keys in UNIT_KEYS.items():
        data[section] = data[section] | {key: entry[key] for key in keys if key in entry}
    shared = document.data["rate_table"]["mounting"]
    if data["rate_table"]["mounting"] != shared:
        data["rate_table"] |= {"reference_mounting": shared}
    return parse_document(json.dumps(data, indent=1, ensure_ascii=False), document.path)


def _vector(direction: Direction) -> FloatArray:
    return np.array(_DIRECTIONS[direction])
