"""Emulator of a Watlow F4 chamber controller.

Registers: Watlow F4P user's manual 0600-0032-0013. Temperatures and ramp rates are 16-bit numbers
with an implied decimal point.
"""

from __future__ import annotations

import contextlib
from datetime import datetime, timedelta
from functools import partial
from typing import Literal

from gyrobench.drivers.emulators.dialect import ChamberEmulation, OnEvent
from gyrobench.drivers.emulators.modbus_rtu import HoldingRegister, ModbusRtuDevice, exception_frame
from gyrobench.drivers.emulators.watlow_loop import MAX_RAMP, OUTPUTS, RampAction, WatlowLoop
from gyrobench.drivers.emulators.world.thermal import ChamberAir

_MODEL_NUMBER = 5270

_ALARM_1_LOW, _ALARM_1_HIGH = 302, 303
_SET_POINT_LOW, _SET_POINT_HIGH = 602, 603
_NO_ALARM, _LOW_ALARM, _HIGH_ALARM = 0, 1, 2
_ALARM_MARGIN_C = 5.0
_DEFAULT_RAMP = 100.0
_MAX_DECIMALS = 3
_FAHRENHEIT, _CELSIUS = 0, 1
_STATIC, _RUNNING, _HELD = 0, 2, 3
_RAMP_REGISTERS = (1100, 1101, 1102)
#: Levels of the digital inputs, which are high, and the level at which each is active: low.
_DIGITAL_INPUTS, _INPUT_CONDITIONS = (201, 213, 225, 237), (1061, 1063, 1065, 1067)
#: The clock: first of six registers, and what each holds.
_CLOCK, _CLOCK_FIELDS = 1916, ("hour", "minute", "second", "month", "day", "year")
_INT16_MIN, _INT16_MAX = -32768, 32767


class WatlowF4Emulator:
    """A Watlow F4 that controls the air of an emulated chamber.

    Event output 1 switches the control of the air. Only the model F4P ramps to its set point. Profiles can
    only be started at the panel and have one step.
    """

    latency_s = 0.02  #: Time that the controller takes to answer.

    def __init__(
        self,
        air: ChamberAir,
        on_event: OnEvent | None = None,
        *,
        address: int = 1,
        model: Literal["F4P", "F4S"] = "F4P",
        decimals: int = 1,
    ) -> None:
        self.air = air
        self._address = address
        self._sensor_fault = 0
        self._alarm_conditions = {1: _NO_ALARM, 2: _NO_ALARM}
        self.sensor_error = 0  #: Error of input 1; zero for none.
        #: alarm_1, alarm_2: Latched state of the alarms, zero for none. Alarm 1 monitors the air at each
        #: exchange.
        self.alarm_1 = self.alarm_2 = _NO_ALARM
        self.decimals = decimals  #: Places after the implied decimal point, 0 to 3.
        self._loop = WatlowLoop(air, on_event, _DEFAULT_RAMP)
        low_c, high_c = air.parameters.low_c, air.parameters.high_c
        self._limits_c = {
            _ALARM_1_LOW: low_c - _ALARM_MARGIN_C,
            _ALARM_1_HIGH: high_c + _ALARM_MARGIN_C,
            _SET_POINT_LOW: low_c,
            _SET_POINT_HIGH: high_c,
        }
        self._now_s = 0.0
        # Time at which the clock was last set, and the date to which it was set.
        self._set_s, self._set_date = 0.0, datetime(2026, 1, 1)
        self._holding = self._registers()
        if model != "F4P":
            self.remove_ramp()
        self._device = ModbusRtuDevice(self._holding, address)
        self._save(0)

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Receive bytes at time ``now_s``; returns the reply to the request that they complete."""
        self._check_alarms()
        self._now_s = now_s
        return self._device.feed(data, now_s)

    def refusal(self, function: int, code: int) -> bytes:
        """Return the reply frame that refuses a function with an exception code."""
        return exception_frame(self._address, function, code)

    def power_off(self, now_s: float) -> None:  # noqa: ARG002
        """Lose power: every event output drops."""
        self._loop.switch_all_off()

    def power_on(self, now_s: float) -> None:  # noqa: ARG002
        """Restart with the settings last saved by register 25, alarms clear and outputs off."""
        self.alarm_1 = self.alarm_2 = _NO_ALARM
        self.sensor_error = self._sensor_fault
        self.air.faults.blind = bool(self._sensor_fault)
        self._loop.end_profile()
        self.air.set_point_c, self.decimals, limits_c, ramp = self._saved
        self._limits_c = dict(limits_c)
        self._loop.set_ramp(*ramp)

    def break_sensor(self, error: int) -> None:
        """Make input 1 fail: the control outputs stop. The error stays until register 311 clears it."""
        self._sensor_fault = self.sensor_error = error
        self.air.faults.blind = True

    def repair_sensor(self) -> None:
        """Repair input 1; its error stays until it is cleared."""
        self._sensor_fault = 0

    def raise_alarm(self, number: int, high: bool) -> None:
        """Set the condition of alarm 1 or 2; the alarm stays until register 312 clears it."""
        self._alarm_conditions[number] = _HIGH_ALARM if high else _LOW_ALARM
        self._check_alarms()

    def end_alarm(self, number: int) -> None:
        """End the condition of the alarm; the alarm stays until it is cleared."""
        self._alarm_conditions[number] = _NO_ALARM

    def start_profile(self, to_c: float) -> None:
        """Start a profile at the panel."""
        self._loop.start_profile(to_c)

    def use_fahrenheit(self, fahrenheit: bool) -> None:
        """Change the unit at the panel; temperatures keep their value."""
        self._loop.is_fahrenheit = fahrenheit

    def remove_ramp(self) -> None:
        """Change the emulated model to one that ramps only in profiles."""
        self._loop.set_ramp(RampAction.OFF)
        for register in _RAMP_REGISTERS:
            self._holding.pop(register, None)

    def _registers(self) -> dict[int, HoldingRegister]:
        read_only = {
            0: lambda: _MODEL_NUMBER,
            100: lambda: self._temperature(self.air.read_c),
            101: lambda: self.sensor_error,
            102: lambda: self.alarm_1,
            103: lambda: _hundredths_of_percent(self.air.power),
            106: lambda: self.alarm_2,
            107: lambda: _hundredths_of_percent(-self.air.power),
            200: lambda: _STATIC if not self._loop.in_profile else _HELD if self._loop.is_held else _RUNNING,
            608: lambda: 0,
            **dict.fromkeys(_DIGITAL_INPUTS, lambda: 1),
            **dict.fromkeys(_INPUT_CONDITIONS, lambda: 0),
        }
        registers = {register: HoldingRegister(read) for register, read in read_only.items()}
        for register in self._limits_c:
            registers[register] = HoldingRegister(
                partial(self._limit, register), partial(self._set_limit, register)
            )
        for number in OUTPUTS:
            registers[1990 + 10 * number] = HoldingRegister(
                partial(self._loop.outputs.__getitem__, number), partial(self._loop.switch, number), _is_bit
            )
        for offset, name in enumerate(_CLOCK_FIELDS):
            registers[_CLOCK + offset] = HoldingRegister(
                partial(self._clock, name), partial(self._set_clock, name)
            )
        return registers | {
            25: HoldingRegister(lambda: 0, self._save, lambda value: value == 0),
            300: HoldingRegister(
                lambda: self._temperature(self._loop.set_point_c),
                lambda value: self._loop.set_set_point(self._celsius(value)),
                lambda value: self._limit(_SET_POINT_LOW) <= value <= self._limit(_SET_POINT_HIGH),
            ),
            311: HoldingRegister(lambda: 0, self._clear_input_error, _is_bit),
            312: HoldingRegister(lambda: 0, self._clear_alarms, _is_bit),
            313: HoldingRegister(lambda: 0, lambda _: None, _is_bit),
            606: HoldingRegister(
                lambda: self.decimals,
                partial(setattr, self, "decimals"),
                lambda value: 0 <= value <= _MAX_DECIMALS,
            ),
            901: HoldingRegister(
                lambda: _FAHRENHEIT if self._loop.is_fahrenheit else _CELSIUS,
                lambda value: self.use_fahrenheit(value == _FAHRENHEIT),
                _is_bit,
            ),
            1100: HoldingRegister(
                lambda: self._loop.action,
                lambda value: self._loop.set_ramp(action=RampAction(value)),
                lambda value: value in tuple(RampAction),
            ),
            1101: HoldingRegister(
                lambda: self._number(self._loop.ramp_rate),
                lambda value: self._loop.set_ramp(rate=self._value(value)),
                lambda value: 0.0 < self._value(value) <= MAX_RAMP,
            ),
            1102: HoldingRegister(
                lambda: int(self._loop.per_hour),
                lambda value: self._loop.set_ramp(per_hour=bool(value)),
                _is_bit,
            ),
            1209: HoldingRegister(lambda: 0, partial(self._hold_profile, False), _is_bit),
            1210: HoldingRegister(lambda: 0, partial(self._hold_profile, True), _is_bit),
            1217: HoldingRegister(lambda: 0, self._end_profile, _is_bit),
        }

    def _hold_profile(self, hold: bool, value: int) -> None:
        if value:
            self._loop.is_held = hold

    def _end_profile(self, end: int) -> None:
        if end:
            self._loop.end_profile()

    @property
    def _date(self) -> datetime:
        return self._set_date + timedelta(seconds=self._now_s - self._set_s)

    def _clock(self, name: str) -> int:
        return int(getattr(self._date, name))

    def _set_clock(self, name: str, value: int) -> None:
        # Registers are written one after the other, so the day may not exist in the month set before.
        date = self._date
        for day in (date.day, 1):
            with contextlib.suppress(ValueError):
                self._set_date = date.replace(**{"day": day, name: value})  # type: ignore[arg-type]
                self._set_s = self._now_s
                return

    def _number(self, value: float) -> int:
        return min(max(round(value * 10.0**self.decimals), _INT16_MIN), _INT16_MAX)

    def _value(self, number: int) -> float:
        return number / 10.0**self.decimals

    def _temperature(self, temperature_c: float) -> int:
        return self._number(self._loop.shown(temperature_c))

    def _celsius(self, number: int) -> float:
        return self._loop.celsius(self._value(number))

    def _limit(self, register: int) -> int:
        return self._temperature(self._limits_c[register])

    def _set_limit(self, register: int, number: int) -> None:
        self._limits_c[register] = self._celsius(number)

    def _save(self, _: int) -> None:
        """Copy the settings to the controller's non-volatile memory."""
        ramp = (self._loop.action, self._loop.ramp_rate, self._loop.per_hour)
        self._saved = self._loop.set_point_c, self.decimals, dict(self._limits_c), ramp

    def _clear_input_error(self, clear: int) -> None:
        if clear and not self._sensor_fault:
            self.sensor_error = 0
            self.air.faults.blind = False

    def _clear_alarms(self, clear: int) -> None:
        if clear:
            self.alarm_1 = self.alarm_2 = _NO_ALARM

    def _check_alarms(self) -> None:
        self.alarm_1 = self._alarm_conditions[1] or self.alarm_1
        self.alarm_2 = self._alarm_conditions[2] or self.alarm_2
        if self.air.read_c < self._limits_c[_ALARM_1_LOW]:
            self.alarm_1 = _LOW_ALARM
        elif self.air.read_c > self._limits_c[_ALARM_1_HIGH]:
            self.alarm_1 = _HIGH_ALARM


def _is_bit(value: int) -> bool:
    return value in (0, 1)


def _hundredths_of_percent(share: float) -> int:
    return round(max(share, 0.0) * 10_000)


DIALECT = ChamberEmulation(WatlowF4Emulator)
