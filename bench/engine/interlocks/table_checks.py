"""Interlocks of the rate table."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gyrobench.bench.engine.interlocks.expected import Expected
from gyrobench.bench.engine.interlocks.findings import CHECK_LINE, Finding, outside, silent
from gyrobench.bench.engine.readings import Readings
from gyrobench.bench.station.station import Station

#: Readings closer than this tell no acceleration: the moment of each is not known well enough.
_LEAST_SPAN_S = 0.4
_CHECK_SERVO = "Check the controller's limits and its servo."


class TableChecks:
    """Angles, rates, accelerations, faults and silence of the table.

    Parameters
    ----------
    station : Station
        The limits; the interlocks' own, or else those of the table with some margin.
    """

    def __init__(self, station: Station) -> None:
        rules, section = station.file.interlocks, station.file.rate_table
        limits = section.limits
        self._station = station
        self._rate_dps = rules.table_rate.limit_or_default_dps(limits.rate_dps)
        self._acceleration_dps2 = rules.table_acceleration.limit_or_default_dps2(limits.acceleration_dps2)
        self._angles_deg = {
            "outer": rules.outer_angle.range_deg(section.outer_limits_deg),
            "inner": rules.inner_angle.range_deg(section.inner_limits_deg),
        }
        self._silence_s = rules.table_silence.limit_or_default_s(station.instruments_period_s)
        self._rates: tuple[float, tuple[float, float]] = (-math.inf, (0.0, 0.0))
        self._accelerations_dps2 = (0.0, 0.0)
        self._prepared = False
        self._prepared_s = -math.inf

    def observe(self, readings: Readings) -> None:
        """Take a reading; one that was taken before changes nothing."""
        before_s, before_dps = self._rates
        span_s = readings.table_s - before_s
        if span_s < _LEAST_SPAN_S:
            return
        rates_dps = self._station.table_axes_of(readings.table.rate_dps)
        self._accelerations_dps2 = (
            (rates_dps[0] - before_dps[0]) / span_s,
            (rates_dps[1] - before_dps[1]) / span_s,
        )
        self._rates = (readings.table_s, rates_dps)

    def findings(self, readings: Readings, expected: Expected, now_s: float) -> Iterator[Finding]:
        """Tell what is wrong now."""
        if expected.table_prepared and not self._prepared:
            self._prepared_s = now_s
        self._prepared = expected.table_prepared
        if problem := silent("rate table", now_s - readings.table_s, self._silence_s):
            yield Finding("table_silence", problem, CHECK_LINE)
        yield from self._motion(readings)
        if self._prepared and readings.table_s > self._prepared_s:
            yield from self._faults(readings)

    def _motion(self, readings: Readings) -> Iterator[Finding]:
        angles_deg = self._station.table_axes_of(readings.table.position_deg)
        rates_dps = self._station.table_axes_of(readings.table.rate_dps)
        rate_dps, acceleration_dps2 = self._rate_dps, self._acceleration_dps2
        for (axis, range_deg), angle_deg, turns_dps, changes_dps2 in zip(
            self._angles_deg.items(), angles_deg, rates_dps, self._accelerations_dps2, strict=True
        ):
            if problem := outside(f"the angle of the {axis} axis", angle_deg, *range_deg, "deg"):
                yield Finding(f"{axis}_angle", problem, "Check cables and stops before it moves again.")
            if problem := outside(f"the rate of the {axis} axis", turns_dps, -rate_dps, rate_dps, "deg/s"):
                yield Finding("table_rate", problem, _CHECK_SERVO)
            if problem := outside(
                f"the acceleration of the {axis} axis",
                changes_dps2,
                -acceleration_dps2,
                acceleration_dps2,
                "deg/s2",
            ):
                yield Finding("table_acceleration", problem, _CHECK_SERVO)

    def _faults(self, readings: Readings) -> Iterator[Finding]:
        for fault in readings.table_faults:
            yield Finding(
                "table_fault", f"the rate table reports {fault}", "Find the cause before it moves again."
            )
        if not readings.table.is_servoed and not readings.table_faults:
            yield Finding(
                "table_fault",
                "an axis of the rate table is not under servo control although the bench closed its servos",
                "Was its controller restarted, or are they opened at its panel?",
            )
