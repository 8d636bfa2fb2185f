"""A station: its file, and what follows from it: kinematics, limits, measurement set-up."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from gyrobench.bench.bias.noise_model import NoiseModel
from gyrobench.bench.bias.parameters import PriorKnowledge
from gyrobench.bench.foundations.arrays import FloatArray
from gyrobench.bench.foundations.clock import Clock, VirtualClock, WallClock
from gyrobench.bench.foundations.documents import Document, Problem
from gyrobench.bench.foundations.errors import DocumentError
from gyrobench.bench.navigation.earth import NORMAL_GRAVITY_SIGMA
from gyrobench.bench.navigation.error_model import Site
from gyrobench.bench.navigation.positions import POSITIONS
from gyrobench.bench.navigation.table_axes import Angles, SingleAxisTable, TurnOrMove, TwoAxisTable
from gyrobench.bench.procedure.checks import StationLimits, check
from gyrobench.bench.procedure.estimate import BenchEstimate, ThermalEstimate
from gyrobench.bench.procedure.plan import Plan, expand
from gyrobench.bench.procedure.procedure_file import Procedure
from gyrobench.bench.station.instrument_sections import Direction
from gyrobench.bench.station.station_file import load_station_file
from gyrobench.drivers import ins
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
    """A bench as its file describes it."""

    def __init__(self, path: Path) -> None:
        self.path = path  #: Where it was read from; file names in it are relative to its folder.
        self._document, self.file = load_station_file(path)  #: The file's content.
        try:
            self.table = self._table()  #: Kinematics of the table with the unit on it.
        except DocumentError as error:
            raise self._document.error([Problem(("rate_table", "mounting"), str(error))]) from error

    @property
    def is_virtual(self) -> bool:
        """Whether it runs in virtual time, without an operator."""
        return self.file.clock == "virtual"

    def new_clock(self) -> Clock:
        """A new clock of the kind in the file, from zero."""
        return VirtualClock() if self.is_virtual else WallClock(speed=self.file.speed)

    @cached_property
    def site(self) -> Site:
        """Where the bench is."""
        place = self.file.location
        return Site(np.deg2rad(place.latitude_deg), place.height_m)

    @property
    def gravity(self) -> tuple[float | None, float]:
        """Local gravity, m/s^2, None where it is not known, and its standard uncertainty."""
        place = self.file.location
        sigma = place.gravity_uncertainty_mps2
        if sigma is None:
            sigma = NORMAL_GRAVITY_SIGMA if place.gravity_mps2 is None else 0.0
        return place.gravity_mps2, sigma

    @cached_property
    def dbc_path(self) -> Path:
        """The DBC file: beside the station file, or shipped with the INS driver.

        Raises DocumentError if there is no such file.
        """
        name = self.file.ins.dbc
        for folder in (self.path.parent, Path(ins.__file__).parent):
            if (folder / name).is_file():
                return folder / name
        raise DocumentError(
            f"DBC file {name!r}: neither beside the station file nor shipped. "
            "Copy it there, or correct its name."
        )

    def check_dbc(self) -> None:
        """Check signals and commands of the INS against the DBC file; a DocumentError lists all problems."""
        try:
            codec = DbcCodec(load_dbc(self.dbc_path))
        except DocumentError as error:
            raise self._document.error([Problem(("ins", "dbc"), str(error))]) from error
        problems = [
            *check_signals(self.file.ins.signals, codec, ("ins", "signals")),
            *check_commands(self.file.ins.commands, codec, ("ins", "commands")),
        ]
        if problems:
            raise self._document.error(problems)

    def noise(self, velocity_lsb_mps: float, heading_lsb_rad: float) -> NoiseModel | None:
        """Declared noise of the INS, with the output's resolution; None where it is to be estimated."""
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
        """Plan a checked procedure; a DocumentError lists all that this station can't run, with places.

        ``bench``: state at the start; by default at rest.
        """
        plan = expand(document, procedure, bench or self.bench_at_rest())
        check(document, plan, self.limits())
        return plan

    def bench_at_rest(self) -> BenchEstimate:
        """The bench before a run, for estimates of duration."""
        thermal = self.file.unit.thermal
        return BenchEstimate.at_rest(
            ThermalEstimate(
                time_constant_s=thermal.time_constant_s,
                self_heating_c=thermal.self_heating_c,
                room_c=thermal.room_c,
            )
        )

    def limits(self) -> StationLimits:
        """Limits that a plan must keep."""
        chamber, gyro = self.file.chamber.limits, self.file.interlocks.gyro_temperature
        return StationLimits(
            chamber_low_c=chamber.low_c,
            chamber_high_c=chamber.high_c,
            ramp_max_c_per_min=chamber.ramp_c_per_min,
            table_rate_max_dps=self.file.rate_table.limits.rate_dps,
            reachable=self._why_unreachable,
            gyro_low_c=gyro.low_c,
            gyro_high_c=gyro.high_c,
        )

    def by_axis_number(self, angles: Angles) -> dict[int, float]:
        """Angles by the controller's axis numbers."""
        section = self.file.rate_table
        if section.is_single_axis:
            return {section.inner_axis_number: angles[1]}
        return {section.outer_axis_number: angles[0], section.inner_axis_number: angles[1]}

    def table_axes_of(self, values: Sequence[float]) -> Angles:
        """Outer (0 with a single axis) and inner value, from values in the order of the axis numbers."""
        section = self.file.rate_table
        if section.is_single_axis:
            (inner,) = values
            return 0.0, inner
        first, second = values
        return (first, second) if section.outer_axis_number < section.inner_axis_number else (second, first)

    def _why_unreachable(
        self, position: str, azimuth_deg: float, turns_deg: tuple[TurnOrMove, ...]
    ) -> str | None:
        try:
            self.table.angles(POSITIONS[position].C_nb(np.deg2rad(azimuth_deg)), turns_deg)
        except DocumentError as error:
            return str(error)
        return None

    def _table(self) -> TwoAxisTable:
        section = self.file.rate_table
        mounting = section.mounting
        C_mount = np.stack([_vector(axis) for axis in (mounting.x, mounting.y, mounting.z)], axis=1)
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


def _vector(direction: Direction) -> FloatArray:
    return np.array(_DIRECTIONS[direction])
