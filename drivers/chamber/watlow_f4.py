"""Driver of the Watlow F4 (F4S, F4D, F4P) chamber controller over Modbus RTU.

Registers: Watlow F4P user's manual 0600-0032-0013. Temperatures and ramp rates are 16-bit numbers
with an implied decimal point. The driver reads its position and the unit from the controller when it is
opened, and again before each set point, since an operator can change them at the panel.
"""

from __future__ import annotations

from enum import IntEnum

from pydantic import Field

from gyrobench.bench.foundations.errors import FaultError, RefusedError, ReplyError
from gyrobench.drivers.chamber import (
    ChamberDialect,
    ChamberOptions,
    ChamberReading,
    require_no_profile,
    switch_output,
)
from gyrobench.drivers.modbus_rtu import ModbusRtu, UnknownRegisterError
from gyrobench.drivers.serial_line import SerialLine

_RAMP_OFF, _RAMP_AT_EVERY_CHANGE = 0, 2
_PER_MINUTE, _PER_HOUR = 0, 1
_MAX_RAMP = 999
_MAX_DECIMALS = 3
_FAHRENHEIT = 0
#: Lowest operation mode of a profile that runs or is held.
_MIN_PROFILE_MODE = 2
_INT16_MIN, _INT16_MAX = -32768, 32767


class _Register(IntEnum):
    """Holding registers; their names appear in error messages."""

    MODEL_NUMBER = 0
    PROCESS_VALUE_1 = 100
    INPUT_1_ERROR = 101
    ALARM_1 = 102
    ALARM_2 = 106
    OPERATION_MODE = 200
    SET_POINT_1 = 300
    CLEAR_INPUT_ERROR = 311
    CLEAR_ALARM = 312
    SET_POINT_LOW_LIMIT = 602
    INPUT_1_DECIMALS = 606
    TEMPERATURE_UNIT = 901
    RAMP_MODE = 1100
    RAMP_RATE = 1101
    RAMP_SCALE = 1102
    TERMINATE_PROFILE = 1217
    EVENT_1 = 2000
    EVENT_2 = 2010
    EVENT_3 = 2020
    EVENT_4 = 2030
    EVENT_5 = 2040
    EVENT_6 = 2050
    EVENT_7 = 2060
    EVENT_8 = 2070


_EVENTS = [register for register in _Register if register.name.startswith("EVENT_")]


def to_register(value: float, decimals: int) -> int | None:
    """Encode a value as a 16-bit number with implied decimals; None if it does not fit or is NaN."""
    scaled = value * 10.0**decimals
    return round(scaled) if _INT16_MIN - 0.5 <= scaled < _INT16_MAX + 0.5 else None


def from_register(number: int, decimals: int) -> float:
    """Decode a 16-bit number with implied decimals."""
    return number / 10.0**decimals


class WatlowF4:
    """A chamber with a Watlow F4; implements :class:`gyrobench.drivers.chamber.Chamber`.

    ``address`` is the Modbus address, ``chamber_event`` the event output that switches the chamber's
    machinery on; if ``end_profiles``, a running profile is ended rather than a set point refused. Raises
    InstrumentError if the controller can't be reached, RefusedError if it works in degrees Fahrenheit.
    """

    def __init__(
        self,
        line: SerialLine,
        address: int = 1,
        chamber_event: int = 1,
        reply_timeout_s: float = 1.0,
        end_profiles: bool = False,
    ) -> None:
        self._line = line
        self._address = address
        self._chamber_event = chamber_event
        self._end_profiles = end_profiles
        self._modbus = ModbusRtu(line, address, reply_timeout_s)
        self._decimals = self._read(_Register.INPUT_1_DECIMALS)
        if not 0 <= self._decimals <= _MAX_DECIMALS:
            raise ReplyError(
                line.instrument, f"register 606 reads {self._decimals} decimals; is it a Watlow F4?"
            )
        self._unit = self._read_optional(_Register.TEMPERATURE_UNIT)
        if self._unit == _FAHRENHEIT:
            raise self._refused("the controller works in °F; set it to °C in its setup menu")
        self.can_ramp = self._read_optional(_Register.RAMP_MODE) is not None  #: Only the model F4P does.
        # All temperatures depend on the decimals, and the first reply may be a late one to another program.
        again = self._read(_Register.INPUT_1_DECIMALS)
        if again != self._decimals:
            raise ReplyError(line.instrument, f"register 606 reads {self._decimals}, then {again} decimals")

    def identify(self) -> str:
        """Return model number, Modbus address, and whether the controller ramps to set points."""
        model = self._read(_Register.MODEL_NUMBER)
        ramps = "ramps to set points" if self.can_ramp else "ramps by profiles only"
        return f"Watlow F4, model number {model}, Modbus address {self._address}, {ramps}"

    def read(self) -> ChamberReading:
        """Read air temperature (registers 100, 101), alarms (102, 106), set point (300) and event output.

        Raises FaultError if the temperature sensor is faulty.
        """
        value, error, alarm_1 = self._modbus.read(_Register.PROCESS_VALUE_1, 3)
        alarm_2 = self._read(_Register.ALARM_2)
        alarms = tuple(
            f"alarm {register.name[-1]} (register {int(register)} reads {status})"
            for register, status in ((_Register.ALARM_1, alarm_1), (_Register.ALARM_2, alarm_2))
            if status
        )
        if error:
            problems = ", ".join((f"error {error} of input 1 (register 101)", *alarms))
            raise FaultError(self._line.instrument, f"{problems}; check the temperature sensor")
        is_on = self.is_event_on(self._chamber_event)
        return ChamberReading(from_register(value, self._decimals), self.set_point_c(), is_on, alarms=alarms)

    def clear_alarms(self) -> None:
        """Clear latched sensor errors and alarms (registers 311, 312)."""
        self._modbus.write(_Register.CLEAR_INPUT_ERROR, 1)
        self._modbus.write(_Register.CLEAR_ALARM, 1)

    def limits_c(self) -> tuple[float, float]:
        """Read the lowest and the highest set point (registers 602, 603)."""
        low, high = self._modbus.read(_Register.SET_POINT_LOW_LIMIT, 2)
        return from_register(low, self._decimals), from_register(high, self._decimals)

    def set_temperature(self, temperature_c: float, rate_c_per_min: float | None) -> None:
        """Command a set point and the ramp to it (registers 300, 1100 to 1102).

        Raises RefusedError if a value is outside the controller's limits, the controller ramps only in
        profiles or runs one, its decimals or unit were changed (the chamber is then switched off), or it
        does not hold the value that was written.
        """
        set_point = to_register(temperature_c, self._decimals)
        if set_point is None:
            raise self._refused(f"a set point of {temperature_c} °C can't be written to register 300")
        settings = self._ramp_settings(rate_c_per_min)
        self._require_unchanged_scaling()
        require_no_profile(self, self._line.instrument, self._end_profiles)
        low_c, high_c = self.limits_c()
        if not low_c <= from_register(set_point, self._decimals) <= high_c:
            raise self._refused(
                f"a set point of {temperature_c} °C is outside the controller's limits, "
                f"{low_c} to {high_c} °C (registers 602, 603)"
            )
        for register, number in (*settings, (_Register.SET_POINT_1, set_point)):
            self._write_confirmed(register, number)

    def set_point_c(self) -> float:
        """Read the set point last commanded (register 300)."""
        return from_register(self._read(_Register.SET_POINT_1), self._decimals)

    def running_profile(self) -> str:
        """Describe a profile that runs or is held (register 200)."""
        mode = self._read_optional(_Register.OPERATION_MODE) or 0
        return f"a profile (register 200 reads {mode})" if mode >= _MIN_PROFILE_MODE else ""

    def end_profile(self) -> None:
        """Terminate the profile (register 1217)."""
        self._modbus.write(_Register.TERMINATE_PROFILE, 1)

    def switch(self, on: bool) -> None:
        """Switch the chamber's event output; raises as :func:`gyrobench.drivers.chamber.switch_output`."""
        switch_output(self, self._chamber_event, on, self._end_profiles, self._line.instrument)

    def switch_event(self, number: int, on: bool) -> None:
        """Switch an event output, 1 to 8 (registers 2000, 2010, ...).

        Raises RefusedError if there is no such output, or it does not hold its state.
        """
        self._write_confirmed(self._event_register(number), int(on))

    def is_event_on(self, number: int) -> bool:
        """Whether an event output, 1 to 8, is on; raises RefusedError if there is no such output."""
        return bool(self._read(self._event_register(number)))

    def close(self) -> None:
        """Close the line; the controller continues unchanged."""
        self._line.close()

    def _require_unchanged_scaling(self) -> None:
        """Raise RefusedError, with the chamber switched off, if decimals or unit were changed."""
        decimals = self._read(_Register.INPUT_1_DECIMALS)
        unit = None if self._unit is None else self._read(_Register.TEMPERATURE_UNIT)
        if (decimals, unit) == (self._decimals, self._unit):
            return
        self.switch_event(self._chamber_event, False)
        changed = (
            f"its decimals (register 606) were changed from {self._decimals} to {decimals}"
            if decimals != self._decimals
            else "its unit (register 901) was changed from °C to °F"
        )
        raise self._refused(f"{changed}, so the chamber was switched off. Change it back at the panel.")

    def _ramp_settings(self, rate_c_per_min: float | None) -> list[tuple[_Register, int]]:
        """Values of the ramp registers, per minute or per hour, whichever represents the rate better."""
        if rate_c_per_min is None:
            return [(_Register.RAMP_MODE, _RAMP_OFF)] if self.can_ramp else []
        if not self.can_ramp:
            raise self._refused(
                f"no ramp of {rate_c_per_min} °C/min: this controller ramps by profiles only; "
                "command the set point without a rate"
            )
        candidates = []
        for scale, minutes in ((_PER_MINUTE, 1), (_PER_HOUR, 60)):
            number = to_register(rate_c_per_min * minutes, self._decimals)
            if number is not None and 1 <= number <= _MAX_RAMP * 10**self._decimals:
                error = abs(from_register(number, self._decimals) / minutes - rate_c_per_min)
                candidates.append((error, scale, number))
        if not candidates:
            raise self._refused(f"a ramp of {rate_c_per_min} °C/min can't be written to register 1101")
        _, scale, number = min(candidates)
        # The mode comes last, so that no ramp starts at an old rate.
        return [
            (_Register.RAMP_RATE, number),
            (_Register.RAMP_SCALE, scale),
            (_Register.RAMP_MODE, _RAMP_AT_EVERY_CHANGE),
        ]

    def _event_register(self, number: int) -> _Register:
        if not 1 <= number <= len(_EVENTS):
            raise self._refused(f"there is no event output {number}, only 1 to {len(_EVENTS)}")
        return _EVENTS[number - 1]

    def _read(self, register: _Register) -> int:
        (number,) = self._modbus.read(register)
        return number

    def _write_confirmed(self, register: _Register, number: int) -> None:
        self._modbus.write(register, number)
        if (present := self._read(register)) != number:
            raise self._refused(
                f"register {int(register)} holds {present} although {number} was written and accepted"
            )

    def _read_optional(self, register: _Register) -> int | None:
        """Read a register that some models lack; None for those."""
        try:
            return self._read(register)
        except UnknownRegisterError:
            return None

    def _refused(self, message: str) -> RefusedError:
        return RefusedError(self._line.instrument, message)


class WatlowF4Options(ChamberOptions):
    """Additional keys in the station file."""

    address: int = Field(1, ge=1, le=247, description="Modbus address")
    chamber_event: int = Field(
        1, ge=1, le=8, description="event output that switches the chamber's machinery"
    )


DIALECT = ChamberDialect[WatlowF4Options](
    lambda line, options: WatlowF4(
        line, options.address, options.chamber_event, end_profiles=options.running_profile == "end"
    ),
    WatlowF4Options,
)
