"""Interlocks of the thermal chamber."""

from __future__ import annotations

import math
from collections.abc import Iterator

from gyrobench.bench.engine.interlocks.expected import Expected
from gyrobench.bench.engine.interlocks.findings import CHECK_LINE, Finding, outside, silent, too_fast
from gyrobench.bench.engine.interlocks.rate_window import RateWindow
from gyrobench.bench.engine.readings import Readings
from gyrobench.bench.station.station import Station

_AT_THE_PANEL = "Somebody changed it at its panel, or its controller was restarted."


class ChamberChecks:
    """Air, alarms and silence of the chamber, and whether it does what it was told.

    Parameters
    ----------
    station : Station
        The limits; the interlocks' own, or else those of the chamber with some margin.
    """

    def __init__(self, station: Station) -> None:
        rules, limits = station.file.interlocks, station.file.chamber.limits
        self._range_c = rules.chamber_air.range_c((limits.low_c, limits.high_c))
        self._rate_c_per_min = rules.chamber_air_rate.limit_or_default_c_per_min(limits.ramp_c_per_min)
        self._rate = RateWindow.for_readings(rules.chamber_air_rate.window_s, station.instruments_period_s)
        self._tolerance_c = rules.chamber_command.tolerance_c
        self._deviation_c = rules.chamber_deviation.tolerance_c
        self._silence_s = rules.chamber_silence.limit_or_default_s(station.instruments_period_s)
        self._told: tuple[float | None, bool | None] = (None, None)
        self._told_s = -math.inf

    def observe(self, readings: Readings) -> None:
        """Take a reading; one that was taken before changes nothing."""
        self._rate.add(readings.chamber_s, readings.chamber.temperature_c)

    def findings(self, readings: Readings, expected: Expected, now_s: float) -> Iterator[Finding]:
        """Tell what is wrong now."""
        told = (expected.chamber_set_c, expected.chamber_on)
        if told != self._told:
            self._told, self._told_s = told, now_s
        if problem := silent("chamber", now_s - readings.chamber_s, self._silence_s):
            yield Finding("chamber_silence", problem, CHECK_LINE)
        air_c = readings.chamber.temperature_c
        if problem := outside("the chamber's air", air_c, *self._range_c, "degC"):
            yield Finding("chamber_air", problem, "Check controller, sensor and door.")
        if problem := too_fast("the chamber's air", self._rate.per_s(), self._rate_c_per_min):
            yield Finding("chamber_air_rate", problem, "Is its door open?")
        for alarm in readings.chamber_alarms:
            yield Finding(
                "chamber_alarm",
                f"the chamber reports {alarm}",
                "Find the cause and clear it at its panel.",
            )
        if readings.chamber_s > self._told_s:
            yield from self._not_as_told(readings)
        if expected.chamber_reached and expected.chamber_set_c is not None:
            off_c = air_c - expected.chamber_set_c
            if not abs(off_c) <= self._deviation_c:
                yield Finding(
                    "chamber_deviation",
                    f"the chamber's air is at {air_c:.1f} degC, {off_c:+.1f} K from the set point it had "
                    f"reached; the limit is {self._deviation_c:g} K",
                    "Check machinery and door.",
                )

    def _not_as_told(self, readings: Readings) -> Iterator[Finding]:
        chamber, (set_c, on) = readings.chamber, self._told
        if on is not None and chamber.is_on is not None and chamber.is_on != on:
            yield Finding(
                "chamber_command",
                f"the chamber is {_state(chamber.is_on)} although the bench switched it {_state(on)}",
                _AT_THE_PANEL,
            )
        if set_c is not None and chamber.set_point_c is not None:
            off_c = abs(chamber.set_point_c - set_c)
            if not off_c <= self._tolerance_c:
                yield Finding(
                    "chamber_command",
                    f"the chamber's set point is {chamber.set_point_c:g} degC, {off_c:.1f} K from the "
                    f"{set_c:g} degC that the bench commanded; the limit is {self._tolerance_c:g} K",
                    _AT_THE_PANEL,
                )


def _state(on: bool) -> str:
    return "on" if on else "off"
