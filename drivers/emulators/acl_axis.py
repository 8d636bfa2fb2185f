"""State machine of one axis of the Acutrol 3000: servo and interlock, mode, demands, limits, status bits.

Two assumptions: the mode numbers in the state register, and that the lower of two direction bits is the
positive direction. The rest follows the manual TM-8004.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

from gyrobench.drivers.emulators.world.table_axis import AxisState, TableAxis

#: Default ratio of the trip rate to the rate limit.
_RATE_TRIP_FACTOR = 1.2
_TRACKING_ERROR_LIMIT_DEG = 1.0
_MAX_DELTA_DEG = 180.0
_LIMIT_TOLERANCE_DEG = 1e-6


class ErrorCode(IntEnum):
    """Reasons to refuse a message.

    The public manual lists no error codes, so the numbers are assumptions; any code is not zero.
    """

    NONE = 0
    SYNTAX = 100
    UNKNOWN_COMMAND = 101
    WRONG_PARAMETER_COUNT = 102
    WRONG_PARAMETER_TYPE = 103
    MESSAGE_TOO_LONG = 104
    PARAMETER_OUT_OF_RANGE = 200
    NOT_SERVOED = 201
    CANNOT_SERVO = 202
    NOT_AVAILABLE = 203

    @property
    def text(self) -> str:
        """Text of the error."""
        return "No error" if self is ErrorCode.NONE else self.name.replace("_", " ").capitalize()


class AclError(Exception):
    """A refused message; never leaves the emulator."""

    def __init__(self, code: ErrorCode) -> None:
        super().__init__(code.text)
        self.code = code


def refuse_if(condition: bool, code: ErrorCode = ErrorCode.PARAMETER_OUT_OF_RANGE) -> None:
    """Raise AclError with this code if the condition is true."""
    if condition:
        raise AclError(code)


class ServoMode(IntEnum):
    """Mode of the servo: the kind of demand that it follows."""

    OFF = 0
    POSITION = 1
    RATE = 2
    ARATE = 3
    SYNTHESIS = 4
    TRACK = 5


_RATE_MODES = (ServoMode.RATE, ServoMode.ARATE)
_MODES_NOT_EMULATED = (ServoMode.SYNTHESIS, ServoMode.TRACK)


class SoftwareFault(IntEnum):
    """Bits of the register ``AnSWFLT``."""

    SOFTWARE_ABORT = 0
    RATE_TRIP = 1
    TRACKING_ERROR = 2
    FRAME_TIME = 3
    MISCORRELATION = 5
    CRC = 6
    FINE_FEEDBACK_LOSS = 7
    COARSE_FEEDBACK_LOSS = 8
    SELF_TEST = 9


@dataclass
class Demands:
    """The last demands of an axis, and which of them take effect when their mode is entered."""

    position_deg: float
    rate_dps: float = 0.0
    acceleration_dps2: float = 0.0
    position_is_pending: bool = False
    rate_is_pending: bool = False


class AclAxis:
    """Controller state of one axis.

    The controller works in servo frames: a message is executed at the time of its frame, which
    :meth:`begin_frame` starts. ``limits`` and ``trip_rates_dps`` have the limits, and the rate at which the
    axis trips, of each mode.
    """

    def __init__(self, physics: TableAxis) -> None:
        self.physics = physics
        self.absolute_limits = physics.parameters.limits
        self.open_interlocks = 0
        self._now_s = 0.0
        self.state: AxisState = physics.encoder(0.0)  #: Encoder reading of this frame.
        self._set_defaults()

    def _set_defaults(self) -> None:
        self.limits = dict.fromkeys(ServoMode, self.absolute_limits)
        self.trip_rates_dps = dict.fromkeys(ServoMode, _RATE_TRIP_FACTOR * self.absolute_limits.rate_dps)
        self.tracking_error_limit_deg = _TRACKING_ERROR_LIMIT_DEG
        self.mode = ServoMode.OFF
        self.closed = False
        self.software_faults = 0
        self.latched_interlocks = self.open_interlocks
        self.demands = Demands(self.state.position_deg)

    def begin_frame(self, now_s: float) -> None:
        """Read the encoder; trips the axis if its rate or following error exceeds the limit."""
        self._now_s = now_s
        self.state = self.physics.encoder(now_s)
        if self.closed:
            is_moving = self.physics.is_moving(now_s)
            if is_moving and abs(self.state.rate_dps) > self.trip_rates_dps[self.mode]:
                self.trip(SoftwareFault.RATE_TRIP)
            elif abs(self.following_error_deg) > self.tracking_error_limit_deg:
                self.trip(SoftwareFault.TRACKING_ERROR)

    @property
    def following_error_deg(self) -> float:
        """Encoder minus commanded profile in this frame."""
        return self.physics.following_error_deg(self._now_s)

    @property
    def faulted(self) -> bool:
        """Whether a fault is latched or an interlock open."""
        return bool(self.software_faults or self.latched_interlocks)

    @property
    def interlock(self) -> str:
        """Answer to the interlock query."""
        return "Close" if self.closed else "Fault" if self.faulted else "Open"

    def close(self) -> None:
        """Close the servo; the axis holds its position in mode Off."""
        refuse_if(self.faulted, ErrorCode.CANNOT_SERVO)
        if not self.closed:
            self.closed = True
            self.mode = ServoMode.OFF
            self.demands = Demands(self.physics.rest_position_deg)

    def open(self) -> None:
        """Open the servo; the brake stops the axis."""
        if self.closed:
            self._apply_limits(ServoMode.OFF)
            self.physics.release(self._now_s)
        self.closed = False
        self.mode = ServoMode.OFF

    def reset(self) -> None:
        """Clear latched faults, unless the servo is closed or the condition persists."""
        if not self.closed:
            self.software_faults = 0
            self.latched_interlocks = self.open_interlocks

    def trip(self, fault: SoftwareFault) -> None:
        """Latch a fault and open the servo."""
        self.software_faults |= 1 << fault
        self.open()

    def open_interlock(self, bit: int) -> None:
        """Open one of the hardware interlocks: latch it and open the servo."""
        self.open_interlocks |= 1 << bit
        self.latched_interlocks |= 1 << bit
        self.open()

    def close_interlock(self, bit: int) -> None:
        """Close the hardware interlock again; it stays latched until a reset."""
        self.open_interlocks &= ~(1 << bit)

    def power_cycle(self) -> None:
        """Open the servo, and restart with nothing latched and default settings."""
        self.open()
        self._set_defaults()

    def set_mode(self, mode: ServoMode) -> None:
        """Change the mode and execute its pending demand; without one, stop."""
        refuse_if(mode in _MODES_NOT_EMULATED, ErrorCode.NOT_AVAILABLE)
        if not self.closed:
            refuse_if(mode is not ServoMode.OFF, ErrorCode.NOT_SERVOED)
            return
        if mode is self.mode and mode is not ServoMode.OFF:
            return
        self.mode = mode
        if mode is ServoMode.POSITION and self.demands.position_is_pending:
            self._move()
        elif mode in _RATE_MODES and self.demands.rate_is_pending:
            self._turn()
        else:
            self._stop()

    def home(self) -> None:
        """Move to zero in position mode."""
        refuse_if(not self.closed, ErrorCode.NOT_SERVOED)
        self.demand_position(0.0)
        self.set_mode(ServoMode.POSITION)

    def demand_position(self, position_deg: float) -> None:
        """Demand a position: move there in position mode; in another mode, store the demand."""
        limits = self.limits[ServoMode.POSITION]
        refuse_if(not limits.low_deg <= position_deg <= limits.high_deg)
        self.demands.position_deg = position_deg
        self.demands.position_is_pending = True
        if self.closed and self.mode is ServoMode.POSITION:
            self._move()

    def demand_delta(self, delta_deg: float) -> None:
        """Change the position demand by a delta; in a rate mode, start from the present position."""
        refuse_if(abs(delta_deg) > _MAX_DELTA_DEG)
        is_turning = self.mode in _RATE_MODES and not self.demands.position_is_pending
        base_deg = self.state.position_deg if is_turning else self.demands.position_deg
        self.demand_position(base_deg + delta_deg)

    def demand_rate(self, rate_dps: float) -> None:
        """Demand a rate: turn in a rate mode; in another mode, store the demand."""
        refuse_if(abs(rate_dps) > self.absolute_limits.rate_dps)
        self.demands.rate_dps = rate_dps
        self.demands.rate_is_pending = True
        if self.closed and self.mode in _RATE_MODES:
            self._turn()

    def demand_acceleration(self, acceleration_dps2: float) -> None:
        """Store an acceleration demand; the modes that follow one are not emulated."""
        refuse_if(abs(acceleration_dps2) > self.absolute_limits.acceleration_dps2)
        self.demands.acceleration_dps2 = acceleration_dps2

    def _move(self) -> None:
        self.demands.position_is_pending = False
        self._apply_limits(ServoMode.POSITION)
        self.physics.move_to(self.demands.position_deg, self._now_s)

    def _turn(self) -> None:
        self.demands.rate_is_pending = False
        self._apply_limits(self.mode)
        self.physics.turn_at(self.demands.rate_dps, self._now_s)

    def _stop(self) -> None:
        self.demands.rate_dps = 0.0
        self._apply_limits(self.mode)
        self.physics.stop(self._now_s)
        self.demands.position_deg = self.physics.rest_position_deg

    def _apply_limits(self, mode: ServoMode) -> None:
        self.physics.limits = self.limits[mode]

    def set_limits(self, mode: ServoMode, **bounds: float) -> None:
        """Change limits of one mode, within the absolute ones; ``bounds`` are fields of AxisLimits."""
        limits, absolute = replace(self.limits[mode], **bounds), self.absolute_limits
        allowed = (
            0.0 < limits.rate_dps <= absolute.rate_dps
            and 0.0 < limits.acceleration_dps2 <= absolute.acceleration_dps2
            and 0.0 < limits.jerk_dps3 <= absolute.jerk_dps3
            and absolute.low_deg <= limits.low_deg < limits.high_deg <= absolute.high_deg
        )
        refuse_if(not allowed)
        self.limits[mode] = limits

    def set_trip_rate(self, mode: ServoMode, rate_dps: float) -> None:
        """Change the rate at which the axis trips in one mode."""
        refuse_if(rate_dps <= 0.0)
        self.trip_rates_dps[mode] = rate_dps

    def state_register(self) -> int:
        """``AnSTATE``: mode, servo, reason for an open servo, and whether that is latched."""
        faulted = self.faulted
        value = int(self.mode) | self.closed << 4 | (not self.closed and not faulted) << 5
        value |= bool(self.software_faults) << 6 | bool(self.latched_interlocks) << 7
        return value | faulted << 8 | faulted << 9

    def dynamics_register(self) -> int:
        """``AnDYN``: limits reached and profiles complete."""
        complete = self.closed and self.physics.profile_complete(self._now_s)
        position_deg = self.state.position_deg
        limits, rate_dps = self.limits[self.mode], self.demands.rate_dps
        turning = self.mode in _RATE_MODES
        value = (turning and rate_dps > limits.rate_dps) << 4 | (turning and rate_dps < -limits.rate_dps) << 5
        value |= (position_deg > limits.high_deg - _LIMIT_TOLERANCE_DEG) << 6
        value |= (position_deg < limits.low_deg + _LIMIT_TOLERANCE_DEG) << 7
        return value | (complete and self.mode is ServoMode.POSITION) << 8 | (complete and turning) << 9

    def legacy_register(self) -> int:
        """Status word of earlier controllers (``Status:ECP n,2``)."""
        faults = self.software_faults
        lost = (
            faults >> SoftwareFault.FINE_FEEDBACK_LOSS & 1 | faults >> SoftwareFault.COARSE_FEEDBACK_LOSS & 1
        )
        value = bool(self.dynamics_register() & 0x300) << 7 | lost << 10
        value |= (faults >> SoftwareFault.RATE_TRIP & 1) << 14
        return value | (faults >> SoftwareFault.TRACKING_ERROR & 1) << 15
