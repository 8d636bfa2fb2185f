"""Emulator of a Watlow F4 chamber controller.

Registers: Watlow F4P user's manual 0600-0032-0013. Temperatures and ramp rates are 16-bit numbers
with an implied decimal point.
"""

from __future__ import annotations

from functools import partial
from typing import Literal, NamedTuple

from gyrobench.drivers.emulators.dialect import ChamberEmulation, OnEvent
from gyrobench.drivers.emulators.modbus_rtu import HoldingRegister, ModbusRtuDevice, exception_frame
from gyrobench.drivers.emulators.world.chamber_air import ChamberAir

MODEL_NUMBER = 5270

#: The event output that switches the chamber's machinery.
CHAMBER_EVENT = 1
_EVENT_OUTPUTS = 8
_ALARM_1_LOW, _ALARM_1_HIGH = 302, 303
_SET_POINT_LOW, _SET_POINT_HIGH = 602, 603
_NO_ALARM, _LOW_ALARM, _HIGH_ALARM = 0, 1, 2
_ALARM_MARGIN_C = 5.0
_RAMP_OFF, _RAMP_AT_START, _RAMP_AT_EVERY_CHANGE = 0, 1, 2
_DEFAULT_RAMP, _FASTEST_RAMP = 100.0, 999.0
_MOST_DECIMALS = 3
_CELSIUS = 1
_INT16_MIN, _INT16_MAX = -32768, 32767


class _Settings(NamedTuple):
    """What the controller keeps without power."""

    set_point_c: float
    decimals: int
    limits_c: dict[int, float]
    ramp: tuple[int, float, bool]


class WatlowF4Emulator:
    """A Watlow F4 that controls the air of an emulated chamber.

    Parameters
    ----------
    air : ChamberAir
        The air; event output 1 switches its control.
    on_event : callable, optional
        Called with number and state of each event output that changes.
    address : int
        Modbus address, 1 to 247.
    model : {"F4P", "F4S"}
        Only the F4P ramps to its set point.
    decimals : int
        Places after the implied decimal point, 0 to 3.

    Attributes
    ----------
    latency_s : float
        Time that the controller takes to answer.
    sensor_error : int
        Error of input 1; zero while the sensor is well.
    alarm_1, alarm_2 : int
        Latched state of the alarms, zero for none. Alarm 1 looks at the air at each exchange.
    """

    latency_s = 0.02

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
        self._sensor_fault = self._sensor_latched = 0
        self._alarm_causes = {1: _NO_ALARM, 2: _NO_ALARM}
        self.sensor_error = 0
        self.alarm_1 = _NO_ALARM
        self.alarm_2 = _NO_ALARM
        self._decimals = decimals
        self._on_event = on_event
        self._events = [air.running] + [False] * (_EVENT_OUTPUTS - 1)
        self._ramp_mode = _RAMP_OFF
        self._ramp_rate = _DEFAULT_RAMP
        self._ramp_per_hour = False
        low_c, high_c = air.parameters.low_c, air.parameters.high_c
        self._limits_c = {
            _ALARM_1_LOW: low_c - _ALARM_MARGIN_C,
            _ALARM_1_HIGH: high_c + _ALARM_MARGIN_C,
            _SET_POINT_LOW: low_c,
            _SET_POINT_HIGH: high_c,
        }
        registers = self._measurements() | self._settings() | self._commands() | self._event_outputs()
        if model == "F4P":
            registers |= self._ramp()
        self._device = ModbusRtuDevice(registers, address)
        self._memory = self._kept_settings()

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Take bytes from the line at time ``now_s`` and return the reply, if one is complete."""
        self._watch_air()
        return self._device.feed(data, now_s)

    def refusal(self, function: int, code: int) -> bytes:
        """Frame with an exception code in reply to that function."""
        return exception_frame(self._address, function, code)

    def power_off(self, now_s: float) -> None:  # noqa: ARG002
        """Lose power: every event output drops."""
        for number in range(1, _EVENT_OUTPUTS + 1):
            self._set_event(number, 0)

    def power_on(self, now_s: float) -> None:  # noqa: ARG002
        """Come back with the settings last saved by register 25, alarms clear and outputs off."""
        self.alarm_1 = self.alarm_2 = _NO_ALARM
        self._sensor_latched = self._sensor_fault
        self.sensor_error = self._sensor_fault
        self.air.faults.blind = bool(self._sensor_fault)
        kept = self._memory
        self.air.set_point_c = kept.set_point_c
        self._decimals = kept.decimals
        self._limits_c = dict(kept.limits_c)
        self._ramp_mode, self._ramp_rate, self._ramp_per_hour = kept.ramp
        self._apply_ramp()

    def break_sensor(self, error: int) -> None:
        """Let input 1 fail: the outputs stop. The error stays until register 311 clears it."""
        self._sensor_fault = self._sensor_latched = self.sensor_error = error
        self.air.faults.blind = True

    def mend_sensor(self) -> None:
        """Let input 1 be well again; its error stays until it is cleared."""
        self._sensor_fault = 0

    def raise_alarm(self, number: int, high: bool) -> None:
        """Give alarm 1 or 2 a cause; the alarm stays until register 312 clears it."""
        self._alarm_causes[number] = _HIGH_ALARM if high else _LOW_ALARM
        self._watch_air()

    def end_alarm(self, number: int) -> None:
        """Take the cause away; the alarm stays until it is cleared."""
        self._alarm_causes[number] = _NO_ALARM

    def _measurements(self) -> dict[int, HoldingRegister]:
        return {
            0: HoldingRegister(lambda: MODEL_NUMBER),
            100: HoldingRegister(lambda: self._number(self.air.air_c)),
            101: HoldingRegister(lambda: self.sensor_error),
            102: HoldingRegister(lambda: self.alarm_1),
            103: HoldingRegister(lambda: _hundredths_of_percent(self.air.power)),
            106: HoldingRegister(lambda: self.alarm_2),
            107: HoldingRegister(lambda: _hundredths_of_percent(-self.air.power)),
            200: HoldingRegister(lambda: 0),
        }

    def _settings(self) -> dict[int, HoldingRegister]:
        limits = {
            register: HoldingRegister(partial(self._limit, register), partial(self._set_limit, register))
            for register in self._limits_c
        }
        return limits | {
            300: HoldingRegister(lambda: self._number(self.air.set_point_c), self._set_set_point),
            606: HoldingRegister(lambda: self._decimals, self._set_decimals),
            608: HoldingRegister(lambda: 0),
            901: HoldingRegister(lambda: _CELSIUS, lambda unit: unit == _CELSIUS),
        }

    def _commands(self) -> dict[int, HoldingRegister]:
        save = HoldingRegister(lambda: 0, self._save)
        clear_input_error = HoldingRegister(lambda: 0, self._clear_input_error)
        clear_alarms = HoldingRegister(lambda: 0, self._clear_alarms)
        silence = HoldingRegister(lambda: 0, lambda value: value in (0, 1))
        return {25: save, 311: clear_input_error, 312: clear_alarms, 313: silence}

    def _event_outputs(self) -> dict[int, HoldingRegister]:
        return {
            1990 + 10 * number: HoldingRegister(
                partial(self._event, number), partial(self._set_event, number)
            )
            for number in range(1, _EVENT_OUTPUTS + 1)
        }

    def _ramp(self) -> dict[int, HoldingRegister]:
        return {
            1100: HoldingRegister(lambda: self._ramp_mode, self._set_ramp_mode),
            1101: HoldingRegister(lambda: self._number(self._ramp_rate), self._set_ramp_rate),
            1102: HoldingRegister(lambda: int(self._ramp_per_hour), self._set_ramp_scale),
        }

    def _number(self, value: float) -> int:
        return min(max(round(value * 10.0**self._decimals), _INT16_MIN), _INT16_MAX)

    def _value(self, number: int) -> float:
        return number / 10.0**self._decimals

    def _limit(self, register: int) -> int:
        return self._number(self._limits_c[register])

    def _set_limit(self, register: int, number: int) -> bool:
        self._limits_c[register] = self._value(number)
        return True

    def _set_set_point(self, number: int) -> bool:
        allowed = self._limit(_SET_POINT_LOW) <= number <= self._limit(_SET_POINT_HIGH)
        if allowed:
            self.air.set_point_c = self._value(number)
            if self._ramp_mode == _RAMP_AT_START and self.air.running:
                self.air.ramp_rate_c_per_min = None
        return allowed

    def _set_decimals(self, number: int) -> bool:
        allowed = 0 <= number <= _MOST_DECIMALS
        if allowed:
            self._decimals = number
        return allowed

    def _kept_settings(self) -> _Settings:
        ramp = (self._ramp_mode, self._ramp_rate, self._ramp_per_hour)
        return _Settings(self.air.set_point_c, self._decimals, dict(self._limits_c), ramp)

    def _save(self, number: int) -> bool:
        if number == 0:
            self._memory = self._kept_settings()
        return number == 0

    def _clear_input_error(self, number: int) -> bool:
        if number == 1 and self._sensor_latched and not self._sensor_fault:
            self._sensor_latched = self.sensor_error = 0
            self.air.faults.blind = False
        return number in (0, 1)

    def _clear_alarms(self, number: int) -> bool:
        if number == 1:
            self.alarm_1 = self.alarm_2 = _NO_ALARM
        return number in (0, 1)

    def _event(self, number: int) -> int:
        return int(self._events[number - 1])

    def _set_event(self, number: int, state: int) -> bool:
        on = bool(state)
        if state in (0, 1) and on != self._events[number - 1]:
            self._events[number - 1] = on
            if number == CHAMBER_EVENT:
                self._switch_air(on)
            if self._on_event:
                self._on_event(number, on)
        return state in (0, 1)

    def _switch_air(self, on: bool) -> None:
        self.air.running = on
        if on and self._ramp_mode == _RAMP_AT_START:
            self.air.ramp_rate_c_per_min = self._ramp_rate_c_per_min()

    def _set_ramp_mode(self, number: int) -> bool:
        allowed = _RAMP_OFF <= number <= _RAMP_AT_EVERY_CHANGE
        if allowed:
            self._ramp_mode = number
            self._apply_ramp()
        return allowed

    def _set_ramp_rate(self, number: int) -> bool:
        allowed = 0.0 < self._value(number) <= _FASTEST_RAMP
        if allowed:
            self._ramp_rate = self._value(number)
            self._apply_ramp()
        return allowed

    def _set_ramp_scale(self, number: int) -> bool:
        if number in (0, 1):
            self._ramp_per_hour = bool(number)
            self._apply_ramp()
        return number in (0, 1)

    def _apply_ramp(self) -> None:
        every_change = self._ramp_mode == _RAMP_AT_EVERY_CHANGE
        self.air.ramp_rate_c_per_min = self._ramp_rate_c_per_min() if every_change else None

    def _ramp_rate_c_per_min(self) -> float:
        return self._ramp_rate / 60.0 if self._ramp_per_hour else self._ramp_rate

    def _watch_air(self) -> None:
        self.alarm_1 = self._alarm_causes[1] or self.alarm_1
        self.alarm_2 = self._alarm_causes[2] or self.alarm_2
        if self.air.air_c < self._limits_c[_ALARM_1_LOW]:
            self.alarm_1 = _LOW_ALARM
        elif self.air.air_c > self._limits_c[_ALARM_1_HIGH]:
            self.alarm_1 = _HIGH_ALARM


def _hundredths_of_percent(share: float) -> int:
    return round(max(share, 0.0) * 10_000)


DIALECT = ChamberEmulation(WatlowF4Emulator)
