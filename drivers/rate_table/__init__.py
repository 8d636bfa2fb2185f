"""Rate tables: the interface that the bench uses; each other module of this folder is one dialect.

Angles are in degrees and are not wrapped: 370 deg is one turn beyond 10 deg. An axis is identified by the
number that its controller gives it, from 1. A method that starts a motion returns at once; the bench polls
:meth:`RateTable.in_position` and :meth:`RateTable.read`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

from gyrobench.bench.foundations.clock import Clock, Deadline
from gyrobench.bench.foundations.documents import StrictModel
from gyrobench.bench.foundations.errors import FaultError, NoReplyError, ReplyError
from gyrobench.drivers.serial_line import LineDefaults, SerialLine

_OptionsT = TypeVar("_OptionsT", bound=StrictModel)

#: Longest time to come to rest after a stop, s.
MAX_STOP_S = 30.0


@dataclass(frozen=True, slots=True)
class TableReading:
    """State of all axes at one moment; sequences are in ascending order of the axis numbers."""

    position_deg: tuple[float, ...]  #: Angle of each axis, not wrapped.
    rate_dps: tuple[float, ...]  #: Angular rate of each axis.
    is_servoed: bool = True  #: Whether all axes are under servo control; True if that can't be read.
    faults: tuple[str, ...] = field(kw_only=True)  #: Latched faults as text for the operator; empty if none.


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """Absolute limits of one axis, set in the controller; no command can exceed them."""

    rate_dps: float
    acceleration_dps2: float
    jerk_dps3: float
    low_deg: float  #: Lowest position.
    high_deg: float  #: Highest position.
    trip_dps: float  #: Rate at which the controller switches the motor power off.


class RateTable(Protocol):
    """A table with one or more axes; each dialect implements this protocol.

    Commands set absolute states, so the bench may repeat any of them after a failed exchange. A call ends
    within 30 s, also if the controller is silent; only :meth:`release` may take longer. Each method may raise
    these errors of :mod:`gyrobench.bench.foundations.errors`:

    * NoReplyError: no complete reply arrived in time;
    * ReplyError: a reply could not be interpreted;
    * RefusedError: the controller refused the command;
    * ConnectionFailedError: the port could not be used.
    """

    def identify(self) -> str:
        """Return maker, model, serial number and firmware as the controller reports them, in one line.

        Returns the same text at each call: the bench compares it with that of an interrupted run.
        """

    def prepare(self) -> None:
        """Clear latched faults, close the servos, and restore the limits of the last :meth:`set_limits`.

        Called before the first motion, and again after :meth:`release`. Raises FaultError if a servo does
        not close.
        """

    def set_limits(self, rate_dps: float, acceleration_dps2: float, jerk_dps3: float) -> None:
        """Limit rate, acceleration and jerk of every later motion of every axis, including stops.

        A limit that the controller can't set is ignored.
        """

    def limits(self) -> tuple[AxisLimits, ...]:
        """Read the absolute limits of each axis, in ascending order of the axis numbers.

        Raises RefusedError if the controller can't report them.
        """

    def move_to(self, angles_deg: Mapping[int, float], rate_dps: float) -> None:
        """Start to move axes to absolute angles, all at the same moment; returns at once.

        ``angles_deg`` maps axis numbers to angles. An angle 360 deg away is a full turn away, and the sign
        of the difference is the direction of the turn: axes must be set up with position limits, not as
        continuous axes. ``rate_dps`` is the highest rate of the move. Raises RefusedError or ValueError,
        before anything moves, if a value is not finite.
        """

    def in_position(self) -> bool:
        """Whether all axes of the last :meth:`move_to` have reached their angles.

        Raises FaultError if an axis will not reach its angle, such as one that is not under servo control.
        """

    def turn_at(self, axis: int, rate_dps: float) -> None:
        """Turn one axis at a constant rate until the next command; a positive rate increases the angle.

        Raises RefusedError or ValueError if the rate is not finite.
        """

    def read(self) -> TableReading:
        """Read position and rate of all axes at one moment, and the latched faults."""

    def stop(self) -> None:
        """Begin a controlled stop of all axes; returns at once, and the servos stay closed."""

    def release(self) -> None:
        """Stop, wait for rest, and open the servos: the safe state of a table.

        Opens the servos even if the axes did not come to rest, and then raises FaultError:
        :func:`await_standstill` and :func:`require_rest` implement this.
        """

    def close(self) -> None:
        """Close the line without any command; the table continues unchanged."""


class NoOptions(StrictModel):
    """Options of a dialect that has no additional keys in the station file."""


@dataclass(frozen=True)
class TableDialect(Generic[_OptionsT]):
    """One dialect; registered as an entry point of the group ``gyrobench.rate_tables``."""

    #: Returns the driver. Arguments: the open line to the controller, the numbers of the axes in use in
    #: ascending order, and the options. The driver owns the line and closes it.
    open: Callable[[SerialLine, Sequence[int], _OptionsT], RateTable]
    options: type[_OptionsT]  #: Additional keys in the station file's section ``rate_table``.
    line: LineDefaults = field(default_factory=LineDefaults)  #: Default line settings of this controller.
    max_axes: int = 9  #: Largest number of axes of this controller.


def await_standstill(
    clock: Clock, read_rates_dps: Callable[[], Sequence[float]], standstill_dps: float, poll_s: float
) -> tuple[float, ...]:
    """Wait until no axis turns faster than ``standstill_dps``, at most :data:`MAX_STOP_S`.

    ``read_rates_dps`` is called every ``poll_s``. Returns the rates at the end, for :func:`require_rest`; a
    single NaN if they could not be read.
    """
    deadline = Deadline(clock, MAX_STOP_S)
    while not _at_rest(rates_dps := _rates_or_nan(read_rates_dps), standstill_dps) and not deadline.expired():
        clock.sleep(poll_s)
    return rates_dps


def require_rest(instrument: str, rates_dps: Sequence[float], standstill_dps: float, outcome: str) -> None:
    """Raise FaultError unless the rates from :func:`await_standstill` are those of a table at rest.

    ``outcome`` is the state in which the table was left, such as "its motor was switched off".
    """
    if _at_rest(rates_dps, standstill_dps):
        return
    if any(math.isnan(rate_dps) for rate_dps in rates_dps):
        problem = f"its rate can't be read {MAX_STOP_S:g} s after the stop and it may still turn"
    else:
        problem = f"still turns at {max(rates_dps, key=abs):.3g} deg/s {MAX_STOP_S:g} s after the stop"
    raise FaultError(
        instrument, f"{problem}; {outcome}. Stay clear of it until it rests, and use its emergency stop."
    )


def _rates_or_nan(read_rates_dps: Callable[[], Sequence[float]]) -> tuple[float, ...]:
    try:
        return tuple(read_rates_dps())
    except (NoReplyError, ReplyError):
        return (math.nan,)


def _at_rest(rates_dps: Sequence[float], standstill_dps: float) -> bool:
    return all(abs(rate_dps) <= standstill_dps for rate_dps in rates_dps)
