"""The interlocks' checks of rate table, chamber and INS, and their findings.

Findings change only if a reading or a command changes, or the time ``untripped_until_s`` of a check is
reached: a check that depends on the time must include that in its ``untripped_until_s``.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from gyrobench.bench.engine.bench_state import ExpectedState, Readings
from gyrobench.bench.station.interlocks import InsTemperature
from gyrobench.bench.station.station import Station
from gyrobench.drivers.chamber import ChamberReading
from gyrobench.drivers.ins.ins_status import InsStatus
from gyrobench.drivers.ins.readout import InsMode
from gyrobench.drivers.rate_table import MAX_STOP_S, TableReading

_CHECK_LINE = "Check its power, cable and port."
_CHECK_SERVO = "Check the controller's limits and its servo."
_CHECK_PANEL = "Check whether it was changed at its panel or its controller was restarted."
_CHECK_CONTROL = (
    "Check the chamber's sensor, heater and compressor, and whether the unit heats itself by more than "
    "unit.thermal.self_heating_c of the station."
)
_CHECK_SENSOR = "Check the sensor and the signal map"
_COOL_DOWN = f"{_CHECK_SENSOR}; let the unit return to room temperature."
#: Minimum time between readings for an acceleration: their times are uncertain.
_MIN_SPAN_S = 0.4
#: Maximum change of the air between two readings, unless a door is opened.
_JUMP_C = 2.0
#: Maximum rate reading of a table at rest, with noise.
_REST_DPS = 0.05
#: Time for which a unit may continue its drift from before a ramp: fraction of its time constant for the
#: inside, and seconds for the case. Period at which its temperatures are sampled.
_LAG_FRACTION, _CASE_LAG_S, _UNIT_PERIOD_S = 0.25, 60.0, 15.0
#: The temperature of a unit that changes by less counts as constant.
_MIN_CHANGE_C_PER_MIN = 0.1
#: Minimum window of a rate in periods between readings: two, and a margin for late readings.
_MIN_PERIODS = 2.5


class InterlockFinding(NamedTuple):
    """A violation; ``interlock`` is its key in the station file.

    ``problem`` is a sentence without full stop, ``advice`` complete sentences or empty.
    """

    interlock: str
    problem: str
    advice: str


Findings = Iterator[InterlockFinding]


def text_of_findings(findings: Iterable[InterlockFinding]) -> str:
    """Return all findings as text, each advice once."""
    problems: dict[str, list[str]] = {}
    for finding in findings:
        problems.setdefault(finding.advice, []).append(finding.problem)
    return " ".join(
        "; ".join(texts) + (f". {advice}" if advice else "") for advice, texts in problems.items()
    )


def _out_of_range(quantity: str, value: float, low: float, high: float, unit: str) -> str:
    """Describe how a value is outside its range; empty if it is inside."""
    if low <= value <= high:
        return ""
    if math.isnan(value):
        return f"{quantity} is unknown; the limits are {low:g} and {high:g} {unit}"
    side, limit = ("below", low) if value < low else ("above", high)
    return f"{quantity} is {value:.1f} {unit}, {side} the limit of {limit:g} {unit}"


def _too_fast(quantity: str, rate_per_s: float | None, limit_per_min: float) -> str:
    """Describe that a temperature changes too fast; empty if it does not, or the rate is unknown."""
    if rate_per_s is None or abs(rate_per_s) * 60.0 <= limit_per_min:
        return ""
    return f"{quantity} changes by {rate_per_s * 60.0:.1f} degC/min; the limit is {limit_per_min:g} degC/min"


def _too_old(instrument: str, age_s: float, limit_s: float) -> str:
    """Describe that an instrument's last answer is too old; empty if it is not."""
    if age_s <= limit_s:
        return ""
    if math.isinf(age_s):
        return f"the {instrument} has not sent anything yet; the limit is {limit_s:g} s"
    return f"the {instrument} has been silent for {age_s:.0f} s; the limit is {limit_s:g} s"


class RateWindow:
    """The newest values of a quantity, for its rate of change over ``window_s``.

    The window is wide enough for three readings at intervals of ``period_s``.
    """

    def __init__(self, window_s: float, period_s: float) -> None:
        self._window_s = max(window_s, _MIN_PERIODS * period_s)
        self._values: deque[tuple[float, float]] = deque()

    def add(self, time_s: float, value: float) -> None:
        """Add a value; one that is not finite, or not newer than the last, is ignored.

        A gap longer than the window discards the values before it.
        """
        values = self._values
        if not math.isfinite(value) or (values and time_s <= values[-1][0]):
            return
        if values and time_s - values[-1][0] > self._window_s:
            values.clear()
        values.append((time_s, value))
        while time_s - values[0][0] > self._window_s:
            values.popleft()

    def per_s(self) -> float | None:
        """Return the change from oldest to newest value, per s; None until half the window is filled."""
        if not self._values:
            return None
        (first_s, first), (last_s, last) = self._values[0], self._values[-1]
        duration_s = last_s - first_s
        return (last - first) / duration_s if duration_s > 0.0 and duration_s >= self._window_s / 2 else None


class TableChecks:
    """Angles, rates, accelerations, faults and silence of the rate table."""

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
        self._silence_s = rules.table_silence.limit_or_default_s(station.file.instruments_period_s)
        self._rates: tuple[float, tuple[float, float]] = (-math.inf, (0.0, 0.0))
        self._accelerations_dps2 = (0.0, 0.0)
        self._prepared = self._stopped = False
        self._prepared_s = self._stopped_s = -math.inf
        self._has_rested = False  #: The table has been at rest since it was stopped.

    def observe(self, readings: Readings, now_s: float) -> None:  # noqa: ARG002 - signature of all checks
        """Process the newest reading; a repeated one has no effect."""
        previous_s, previous_dps = self._rates
        span_s = readings.table_s - previous_s
        if span_s < _MIN_SPAN_S:
            return
        rates_dps = self._station.table_axes_of(readings.table.rate_dps)
        self._accelerations_dps2 = (
            (rates_dps[0] - previous_dps[0]) / span_s,
            (rates_dps[1] - previous_dps[1]) / span_s,
        )
        self._rates = (readings.table_s, rates_dps)

    def findings(self, readings: Readings, expected: ExpectedState, now_s: float) -> Findings:
        """Yield the violations at ``now_s``."""
        if expected.table_prepared and not self._prepared:
            self._prepared_s = now_s
        self._prepared = expected.table_prepared
        if expected.table_stopped and not self._stopped:
            self._stopped_s, self._has_rested = now_s, False
        self._stopped = expected.table_stopped
        if problem := _too_old("rate table", now_s - readings.table_s, self._silence_s):
            yield InterlockFinding("table_silence", problem, _CHECK_LINE)
        yield from self._motion(readings)
        if self._prepared and readings.table_s > self._prepared_s:
            yield from self._faults(readings)
        if self._stopped and readings.table_s > self._stopped_s:
            problems = list(self._motion_although_stopped(readings))
            self._has_rested |= not problems
            is_rest_due = self._has_rested or readings.table_s > self._stopped_s + MAX_STOP_S
            if readings.table.is_servoed and is_rest_due:
                yield from problems

    def is_implausible(self, reading: TableReading, previous: Readings, expected: ExpectedState) -> bool:
        """Whether a new reading by itself would trip an interlock."""
        if reading.faults != previous.table.faults or (expected.table_prepared and not reading.is_servoed):
            return True
        in_table_axes = self._station.table_axes_of
        limit_dps = _REST_DPS if expected.table_stopped else self._rate_dps
        step_dps = self._acceleration_dps2 * _MIN_SPAN_S
        return not all(
            low_deg <= angle_deg <= high_deg
            and abs(rate_dps) <= limit_dps
            and abs(rate_dps - previous_dps) <= step_dps
            for (low_deg, high_deg), angle_deg, rate_dps, previous_dps in zip(
                self._angles_deg.values(),
                in_table_axes(reading.position_deg),
                in_table_axes(reading.rate_dps),
                in_table_axes(previous.table.rate_dps),
                strict=True,
            )
        )

    def untripped_until_s(self, readings: Readings) -> float:
        """Return the time until which nothing trips without a new reading or command, s."""
        return readings.table_s + self._silence_s

    def _motion(self, readings: Readings) -> Findings:
        angles_deg = self._station.table_axes_of(readings.table.position_deg)
        rates_dps = self._station.table_axes_of(readings.table.rate_dps)
        for (axis, range_deg), angle_deg, rate_dps, acceleration_dps2 in zip(
            self._angles_deg.items(), angles_deg, rates_dps, self._accelerations_dps2, strict=True
        ):
            low_deg, high_deg = range_deg
            if not low_deg <= angle_deg <= high_deg:
                yield InterlockFinding(
                    f"{axis}_angle",
                    _out_of_range(f"the angle of the {axis} axis", angle_deg, low_deg, high_deg, "deg"),
                    "Check cables and mechanical stops before the table moves again.",
                )
            for interlock, quantity, value, limit, unit in (
                ("table_rate", "rate", rate_dps, self._rate_dps, "deg/s"),
                ("table_acceleration", "acceleration", acceleration_dps2, self._acceleration_dps2, "deg/s2"),
            ):
                if not -limit <= value <= limit:
                    problem = _out_of_range(f"the {quantity} of the {axis} axis", value, -limit, limit, unit)
                    yield InterlockFinding(interlock, problem, _CHECK_SERVO)

    def _motion_although_stopped(self, readings: Readings) -> Findings:
        rates_dps = self._station.table_axes_of(readings.table.rate_dps)
        for axis, rate_dps in zip(self._angles_deg, rates_dps, strict=True):
            if not abs(rate_dps) <= _REST_DPS:
                problem = f"the {axis} axis turns at {rate_dps:.2f} deg/s although the table was stopped"
                yield InterlockFinding("table_fault", problem, "Use its emergency stop, and find the cause.")

    def _faults(self, readings: Readings) -> Findings:
        for fault in readings.table.faults:
            yield InterlockFinding(
                "table_fault",
                f"the rate table reports {fault}",
                "Find the cause before the table moves again.",
            )
        if not readings.table.is_servoed and not readings.table.faults:
            yield InterlockFinding(
                "table_fault",
                "an axis of the rate table is not under servo control although its servos were switched on",
                "Check whether its servos were switched off at its panel; if its controller was restarted, "
                "reference its axes before the run continues.",
            )


class _UnitAirCheck:
    """Check that the unit follows the chamber's air: its temperature must not move away far and long."""

    def __init__(self, station: Station) -> None:
        thermal = station.file.unit.thermal
        self._margin_c = station.file.interlocks.chamber_sensor.margin_c
        self._self_heating_c = max(0.0, thermal.self_heating_c)
        temperatures = list(station.file.interlocks.ins_temperatures(station.file.ins.signals))
        has_case = station.file.ins.signals.case_temperature is not None
        self._temperatures = [each.read for each in (temperatures[:1] if has_case else temperatures)]
        self._lag_s = _CASE_LAG_S if has_case else max(_CASE_LAG_S, _LAG_FRACTION * thermal.time_constant_s)
        self._rate = RateWindow(self._lag_s, station.file.instruments_period_s)
        self._observed_s, self._far_since_s = -math.inf, math.inf
        self.problem = ""  #: Empty if the unit follows the air.

    def observe(self, readings: Readings, now_s: float) -> None:
        """Sample the unit's temperatures if they are due."""
        if now_s - self._observed_s < _UNIT_PERIOD_S:
            return
        self._observed_s, self.problem, air_c = now_s, "", readings.chamber.temperature_c
        unit_c = [read(readings.ins) for read in self._temperatures]
        if not (unit_c and all(map(math.isfinite, unit_c))):
            self._far_since_s = math.inf
            return
        self._rate.add(now_s, sum(unit_c) / len(unit_c))
        is_above = min(unit_c) > air_c
        nearest_c = min(unit_c) if is_above else max(unit_c)
        limit_c = self._margin_c + self._self_heating_c * is_above
        is_far = abs(nearest_c - air_c) > limit_c and (is_above or nearest_c < air_c)
        self._far_since_s = min(self._far_since_s, now_s) if is_far else math.inf
        rate_per_s = self._rate.per_s()
        if rate_per_s is None or now_s - self._far_since_s < self._lag_s:
            return
        rate_c_per_min = 60.0 * rate_per_s
        if (rate_c_per_min if is_above else -rate_c_per_min) > _MIN_CHANGE_C_PER_MIN:
            self.problem = (
                f"the unit is at {nearest_c:.1f} degC and changes by {rate_c_per_min:+.1f} degC/min, away "
                f"from the chamber's air, which reads {air_c:.1f} degC; the limit is {limit_c:g} K"
            )
            if abs(air_c - (1.8 * nearest_c + 32.0)) < self._margin_c + self._self_heating_c:
                self.problem += "; if that is in degF, it is near the unit: check the unit of the controller"


class ChamberChecks:
    """Air, alarms and silence of the chamber, and its deviations from the command."""

    def __init__(self, station: Station) -> None:
        rules, limits = station.file.interlocks, station.file.chamber.limits
        self._range_c = rules.chamber_air.range_c((limits.low_c, limits.high_c))
        self._rate_c_per_min = rules.chamber_air_rate.limit_or_default_c_per_min(limits.ramp_c_per_min)
        self._rate = RateWindow(rules.chamber_air_rate.window_s, station.file.instruments_period_s)
        self._tolerance_c = rules.chamber_command.tolerance_c
        self._deviation_c = rules.chamber_deviation.tolerance_c
        self._silence_s = rules.chamber_silence.limit_or_default_s(station.file.instruments_period_s)
        self._unit = _UnitAirCheck(station)
        self._commanded: tuple[float | None, bool | None] = (None, None)
        self._commanded_s = -math.inf

    def observe(self, readings: Readings, now_s: float) -> None:
        """Process the newest reading; a repeated one has no effect."""
        self._rate.add(readings.chamber_s, readings.chamber.temperature_c)
        self._unit.observe(readings, now_s)

    def findings(self, readings: Readings, expected: ExpectedState, now_s: float) -> Findings:
        """Yield the violations at ``now_s``."""
        commanded = (expected.chamber_set_c, expected.chamber_on)
        if commanded != self._commanded:
            self._commanded, self._commanded_s = commanded, now_s
        # If the sensor is faulty, the last reading is repeated with an alarm: the chamber answers.
        problem = _too_old("chamber", now_s - readings.chamber_s, self._silence_s)
        if problem and not readings.chamber.alarms:
            yield InterlockFinding("chamber_silence", problem, _CHECK_LINE)
        air_c = readings.chamber.temperature_c
        if problem := _out_of_range("the chamber's air", air_c, *self._range_c, "degC"):
            yield InterlockFinding("chamber_air", problem, "Check controller, sensor and door.")
        if problem := _too_fast("the chamber's air", self._rate.per_s(), self._rate_c_per_min):
            yield InterlockFinding("chamber_air_rate", problem, "Check whether its door is open.")
        for alarm in readings.chamber.alarms:
            yield InterlockFinding(
                "chamber_alarm",
                f"the chamber reports {alarm}",
                "Find the cause and clear the alarm at its panel.",
            )
        if self._unit.problem:
            yield InterlockFinding("chamber_sensor", self._unit.problem, _CHECK_CONTROL)
        if readings.chamber_s > self._commanded_s:
            yield from self._deviations_from_command(readings.chamber, *self._commanded)
        if expected.chamber_reached and expected.chamber_set_c is not None:
            deviation_c = air_c - expected.chamber_set_c
            if not abs(deviation_c) <= self._deviation_c:
                yield InterlockFinding(
                    "chamber_deviation",
                    f"the chamber's air is at {air_c:.1f} degC, {deviation_c:+.1f} K from the set point that "
                    f"it had reached; the limit is {self._deviation_c:g} K",
                    "Check the chamber's machinery and door.",
                )

    def is_implausible(self, reading: ChamberReading, previous: Readings, expected: ExpectedState) -> bool:
        """Whether a new reading by itself would trip an interlock."""
        low_c, high_c = self._range_c
        air_c, set_c = reading.temperature_c, expected.chamber_set_c
        if reading.alarms != previous.chamber.alarms or not low_c <= air_c <= high_c:
            return True
        if not abs(air_c - previous.chamber.temperature_c) <= _JUMP_C:
            return True
        if expected.chamber_reached and set_c is not None and abs(air_c - set_c) > self._deviation_c:
            return True
        return any(self._deviations_from_command(reading, set_c, expected.chamber_on))

    def untripped_until_s(self, readings: Readings) -> float:
        """Return the time until which nothing trips without a new reading or command, s."""
        return readings.chamber_s + self._silence_s

    def _deviations_from_command(
        self, chamber: ChamberReading, set_c: float | None, on: bool | None
    ) -> Findings:
        if on is not None and chamber.is_on is not None and chamber.is_on != on:
            yield InterlockFinding(
                "chamber_command",
                f"the chamber is {_on_off(chamber.is_on)} although the bench switched it {_on_off(on)}",
                _CHECK_PANEL,
            )
        if set_c is not None and chamber.set_point_c is not None:
            deviation_c = abs(chamber.set_point_c - set_c)
            if not deviation_c <= self._tolerance_c:
                yield InterlockFinding(
                    "chamber_command",
                    f"the chamber's set point is {chamber.set_point_c:g} degC, {deviation_c:.1f} K from the "
                    f"commanded {set_c:g} degC; the limit is {self._tolerance_c:g} K",
                    _CHECK_PANEL,
                )


def _on_off(on: bool) -> str:
    return "on" if on else "off"


class _WatchedTemperature:
    """A temperature with its newest value and its rate of change."""

    def __init__(self, source: InsTemperature, station: Station) -> None:
        self._read, (self._level_key, self._rate_key) = source.read, source.keys
        self._description = f"the temperature of the {source.what}"
        self._low_c, self._high_c = source.level.low_c, source.level.high_c
        self._rate_c_per_min = source.rate.limit_or_default_c_per_min(
            station.file.chamber.limits.ramp_c_per_min
        )
        self._rate = RateWindow(source.rate.window_s, station.file.instruments_period_s)
        self.value_c = math.nan
        self.valid_s = -math.inf

    def observe(self, ins: InsStatus, now_s: float) -> None:
        self.value_c = self._read(ins)
        if math.isfinite(self.value_c):
            self._rate.add(now_s, self.value_c)
            self.valid_s = now_s

    def findings(self, is_checked: bool) -> Findings:
        """Yield the violations; ``is_checked``: the value is valid, or has been missing for long."""
        problem = _out_of_range(self._description, self.value_c, self._low_c, self._high_c, "degC")
        if problem and is_checked:
            yield InterlockFinding(self._level_key, problem, _COOL_DOWN)
        if problem := _too_fast(self._description, self._rate.per_s(), self._rate_c_per_min):
            yield InterlockFinding(self._rate_key, problem, f"{_CHECK_SENSOR}.")


class InsChecks:
    """Temperatures, fault and silence of the INS; nothing trips while it is off.

    Temperatures that the signal map lacks are not checked.
    """

    def __init__(self, station: Station) -> None:
        self._silence_s = station.file.interlocks.ins_silence.limit_s
        self._period_s = station.file.instruments_period_s + 2.0 * station.file.tick_s
        self._temperatures = [
            _WatchedTemperature(each, station)
            for each in station.file.interlocks.ins_temperatures(station.file.ins.signals)
        ]
        self._observed_s = -math.inf
        self._on = False
        self._on_s = -math.inf

    def observe(self, readings: Readings, now_s: float) -> None:
        """Process the status of the INS."""
        self._observed_s = now_s
        for temperature in self._temperatures:
            temperature.observe(readings.ins, now_s)

    def findings(self, readings: Readings, expected: ExpectedState, now_s: float) -> Findings:
        """Yield the violations at ``now_s``."""
        if expected.ins_on and not self._on:
            self._on_s = now_s
        self._on = expected.ins_on
        if not self._on:
            return
        if problem := _too_old("INS", self._age_s(readings, now_s), self._silence_s):
            yield InterlockFinding("ins_silence", problem, _CHECK_LINE)
            return
        if readings.ins.mode is InsMode.FAULT and self._observed_s >= self._on_s:
            yield InterlockFinding("ins_fault", "the INS reports a fault", "Read its built-in test results.")
        for temperature in self._temperatures:
            # Counted in observations: the first of them may come before the first temperatures.
            missing_s = self._observed_s - max(temperature.valid_s, self._on_s)
            is_checked = math.isfinite(temperature.value_c) or missing_s > self._silence_s
            yield from temperature.findings(is_checked)

    def untripped_until_s(self, readings: Readings) -> float:  # noqa: ARG002 - signature of all checks
        """Return the time until which nothing trips without a new reading or command, s."""
        return max(self._observed_s, self._on_s) + self._period_s if self._on else math.inf

    def _age_s(self, readings: Readings, now_s: float) -> float:
        """Age of the INS's last frame, at most the time since power-on; grows if observations are overdue."""
        silent_s = min(readings.ins.age_s, max(0.0, self._observed_s - self._on_s))
        overdue_s = now_s - max(self._observed_s, self._on_s)
        return silent_s + (overdue_s if overdue_s > self._period_s else 0.0)
