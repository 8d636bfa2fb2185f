"""Interlocks of the unit under test."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from gyrobench.bench.engine.interlocks.expected import Expected
from gyrobench.bench.engine.interlocks.findings import CHECK_LINE, Finding, outside, silent, too_fast
from gyrobench.bench.engine.interlocks.rate_window import RateWindow
from gyrobench.bench.engine.readings import Readings
from gyrobench.bench.station.interlocks import TemperatureInterlock, TemperatureRateInterlock
from gyrobench.bench.station.station import Station
from gyrobench.drivers.ins.ins_status import InsStatus
from gyrobench.drivers.ins.readout import InsMode

_CHECK_SENSOR = "Check the sensor and the signal map"
_COOL_DOWN = f"{_CHECK_SENSOR}; let the unit come back to room temperature."


@dataclass
class _Temperature:
    """One temperature that the INS sends."""

    what: str
    read: Callable[[InsStatus], float]
    kind: str
    level: TemperatureInterlock
    rate_c_per_min: float
    rate: RateWindow
    value_c: float = math.nan
    known_s: float = field(default=-math.inf)


class InsChecks:
    """Temperatures, fault and silence of the INS; nothing trips while it is off.

    Temperatures that the station's signal map does not have are not looked at.

    Parameters
    ----------
    station : Station
        The limits.
    """

    def __init__(self, station: Station) -> None:
        self._silence_s = station.file.interlocks.ins_silence.limit_s
        self._period_s = station.instruments_period_s + 2.0 * station.tick_s
        self._temperatures = list(_temperatures(station))
        self._observed_s = -math.inf
        self._on = False
        self._on_s = -math.inf

    def observe(self, readings: Readings, now_s: float) -> None:
        """Take what the INS said by now."""
        self._observed_s = now_s
        for temperature in self._temperatures:
            temperature.value_c = temperature.read(readings.ins)
            temperature.rate.add(now_s, temperature.value_c)
            if math.isfinite(temperature.value_c):
                temperature.known_s = now_s

    def findings(self, readings: Readings, expected: Expected, now_s: float) -> Iterator[Finding]:
        """Tell what is wrong now."""
        if expected.ins_on and not self._on:
            self._on_s = now_s
        self._on = expected.ins_on
        if not self._on:
            return
        if problem := silent("INS", self._age_s(readings, now_s), self._silence_s):
            yield Finding("ins_silence", problem, CHECK_LINE)
            return
        if readings.ins.mode is InsMode.FAULT and self._observed_s >= self._on_s:
            yield Finding("ins_fault", "the INS reports a fault", "Read its own diagnostics.")
        for temperature in self._temperatures:
            # By what has been looked at: the first look may come before the first temperatures.
            unknown_s = self._observed_s - max(temperature.known_s, self._on_s)
            if math.isfinite(temperature.value_c) or unknown_s > self._silence_s:
                yield from _level(temperature)
            if problem := too_fast(temperature.what, temperature.rate.per_s(), temperature.rate_c_per_min):
                yield Finding(f"{temperature.kind}_rate", problem, f"{_CHECK_SENSOR}.")

    def _age_s(self, readings: Readings, now_s: float) -> float:
        """Silence of the INS since it was switched on, as far as it was looked at in time."""
        silent_s = min(readings.ins.age_s, max(0.0, self._observed_s - self._on_s))
        overdue_s = now_s - max(self._observed_s, self._on_s)
        return silent_s + (overdue_s if overdue_s > self._period_s else 0.0)


def _level(temperature: _Temperature) -> Iterator[Finding]:
    level = temperature.level
    if problem := outside(temperature.what, temperature.value_c, level.low_c, level.high_c, "degC"):
        yield Finding(f"{temperature.kind}_temperature", problem, _COOL_DOWN)


def _temperatures(station: Station) -> Iterator[_Temperature]:
    signals, rules = station.file.ins.signals, station.file.interlocks
    if signals.case_temperature is not None:
        yield _temperature(
            station, "the case", lambda ins: ins.case_c, "case", rules.case_temperature, rules.case_rate
        )
    for part, mapped in (
        ("optics", signals.gyro_optics_temperature),
        ("electronics", signals.gyro_electronics_temperature),
    ):
        if mapped is None:
            continue
        for index, axis in enumerate("xyz"):
            yield _temperature(
                station,
                f"the {part} of gyro {axis}",
                _of_axis(f"{part}_c", index),
                "gyro",
                rules.gyro_temperature,
                rules.gyro_rate,
            )


def _temperature(
    station: Station,
    what: str,
    read: Callable[[InsStatus], float],
    kind: str,
    level: TemperatureInterlock,
    rate: TemperatureRateInterlock,
) -> _Temperature:
    limit_c_per_min = rate.limit_or_default_c_per_min(station.file.chamber.limits.ramp_c_per_min)
    window = RateWindow.for_readings(rate.window_s, station.instruments_period_s)
    return _Temperature(f"the temperature of {what}", read, kind, level, limit_c_per_min, window)


def _of_axis(attribute: str, index: int) -> Callable[[InsStatus], float]:
    return lambda ins: float(getattr(ins, attribute)[index])
