"""Limits of manual control: the narrower ones of station and controllers."""

from __future__ import annotations

from dataclasses import dataclass

from gyrobench.bench.foundations.errors import RefusedError
from gyrobench.bench.jog.terminal import CommandError
from gyrobench.bench.station.station import Station
from gyrobench.drivers.chamber import Chamber
from gyrobench.drivers.rate_table import RateTable

#: The axes of the table, in the order of their angles.
TABLE_AXES = ("outer", "inner")
#: Time until a stop takes effect, for ticks and exchanges.
_STOP_DELAY_S = 1.0


@dataclass(frozen=True)
class AxisRange:
    """Range of an axis's angle, and its maximum rate."""

    low_deg: float
    high_deg: float
    rate_dps: float


@dataclass(frozen=True)
class ManualLimits:
    """Limits of manual control: the narrower ones of station and controllers."""

    axes: dict[str, AxisRange]  #: Range of each axis by its name.
    acceleration_dps2: float  #: Deceleration of a stop.
    #: low_c, high_c: Range of the chamber's set point.
    low_c: float
    high_c: float
    ramp_c_per_min: float  #: Maximum ramp, up or down.

    def check_angle(self, axis: str, angle_deg: float) -> None:
        """Raise CommandError if an angle is out of range."""
        limit = self._axis_range(axis)
        if not limit.low_deg <= angle_deg <= limit.high_deg:
            raise CommandError(
                f"{axis} {angle_deg:g} deg is outside its limits of {limit.low_deg:g} to "
                f"{limit.high_deg:g} deg. Nothing was moved."
            )

    def check_rate(self, axis: str, rate_dps: float) -> None:
        """Raise CommandError if a rate is too high."""
        limit = self._axis_range(axis)
        if not abs(rate_dps) <= limit.rate_dps:
            raise CommandError(
                f"{rate_dps:g} deg/s exceeds the limit of {limit.rate_dps:g} deg/s of the {axis} axis. "
                "Nothing was moved."
            )

    def check_chamber(self, temperature_c: float, ramp_c_per_min: float) -> None:
        """Raise CommandError if a set point is out of range, or a ramp is too high."""
        if not self.low_c <= temperature_c <= self.high_c:
            raise CommandError(
                f"{temperature_c:g} degC is outside the chamber's limits of {self.low_c:g} to "
                f"{self.high_c:g} degC. Nothing was set."
            )
        if not 0.0 < ramp_c_per_min <= self.ramp_c_per_min:
            raise CommandError(
                f"a ramp must be above 0 and at most {self.ramp_c_per_min:g} degC/min, not "
                f"{ramp_c_per_min:g} degC/min. Nothing was set."
            )

    def room_deg(self, axis: str, angle_deg: float, rate_dps: float) -> float:
        """Angle that an axis may still turn at a rate before it must stop; negative if it is too late."""
        limit = self._axis_range(axis)
        distance_deg = limit.high_deg - angle_deg if rate_dps > 0.0 else angle_deg - limit.low_deg
        speed_dps = abs(rate_dps)
        return distance_deg - speed_dps * _STOP_DELAY_S - speed_dps**2 / self.acceleration_dps2

    def _axis_range(self, axis: str) -> AxisRange:
        if axis not in self.axes:
            raise CommandError(f"this table has no {axis} axis. Nothing was moved.")
        return self.axes[axis]


def manual_limits(station: Station, table: RateTable, chamber: Chamber) -> ManualLimits:
    """Query the controllers' limits and combine them with the station's.

    Raises InstrumentError if a controller does not reply. A controller without such a query leaves the
    station's limits.
    """
    section, air = station.file.rate_table, station.file.chamber.limits
    limits = section.limits
    ranges = {"outer": section.outer_limits_deg, "inner": section.inner_limits_deg}
    names = TABLE_AXES[1:] if section.is_single_axis else TABLE_AXES
    axes = {name: AxisRange(*ranges[name], limits.rate_dps) for name in names}
    acceleration_dps2 = limits.acceleration_dps2
    try:
        controller_limits = dict(zip(section.axis_numbers, table.limits(), strict=True))
    except RefusedError:
        controller_limits = {}
    for name in names:
        number = section.outer_axis_number if name == "outer" else section.inner_axis_number
        if number in controller_limits:
            allowed, limit = controller_limits[number], axes[name]
            axes[name] = AxisRange(
                max(limit.low_deg, allowed.low_deg),
                min(limit.high_deg, allowed.high_deg),
                min(limit.rate_dps, allowed.rate_dps, allowed.trip_dps),
            )
            acceleration_dps2 = min(acceleration_dps2, allowed.acceleration_dps2)
    try:
        low_c, high_c = chamber.limits_c()
    except RefusedError:
        low_c, high_c = air.low_c, air.high_c
    return ManualLimits(
        axes, acceleration_dps2, max(air.low_c, low_c), min(air.high_c, high_c), air.ramp_c_per_min
    )
